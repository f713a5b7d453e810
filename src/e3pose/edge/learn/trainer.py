"""The trainer beside a running edge, `python -m e3pose.edge.learn.trainer`; runs the lab's."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from e3pose.base.errors import Exit
from e3pose.base.installing import not_installed

LAB = "e3pose_lab.train.online"  # with torch; an edge that does not learn is installed without it


def main(arguments: Sequence[str], lab: str = LAB) -> int:
    """Do the job in a folder; return the exit code."""
    try:
        trainer = importlib.import_module(lab)
    except ModuleNotFoundError as error:
        print(not_installed(error.name, "train"), file=sys.stderr)
        return Exit.REFUSED
    return int(trainer.main(arguments))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
