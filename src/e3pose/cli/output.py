"""Output of verbs: JSON to a file or to standard output, and a line for each file written."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from e3pose.base.atomic import write_file

STDOUT = Path("-")
JsonFile = Annotated[Path | None, Parameter(name="--json", allow_leading_hyphen=True)]


def is_stdout(path: Path | None) -> bool:
    """Return whether an output option names standard output, which then holds nothing else."""
    return path == STDOUT


def write_json(path: Path | None, value: Any) -> None:
    """Write a value as JSON to a file or, for `-`, to standard output; nothing if there is no path.

    Args:
        path: the option's value.
        value: of dicts, lists, strings, numbers.
    """
    if path is None:
        return
    text = json.dumps(value, indent=2) + "\n"
    if is_stdout(path):
        sys.stdout.write(text)
        return

    write_file(path, text)
    wrote(path)


def wrote(path: Path | None, what: str = "") -> None:
    """Print which file or folder was written; nothing for no path."""
    if path is not None:
        print(f"Wrote {path}{f': {what}' if what else ''}")


def number_or_null(value: float) -> float | None:
    """Return a number for JSON, which has no NaN."""
    return float(value) if math.isfinite(value) else None
