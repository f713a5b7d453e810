"""The verbs of `e3pose`: each lives in a module that is imported only when it is called."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from cyclopts import App

from e3pose import __version__
from e3pose.errors import InputError

EXIT_INPUT = 2  # the input or the options are wrong
EXIT_INTERRUPTED = 130

app = App(
    name="e3pose",
    version=__version__,
    help="Multi-camera 3D human pose that wakes only the cameras worth waking.",
)
VERBS = {
    "import": "importing:import_app",
    "info": "information:info",
    "simulate": "simulating:simulate",
    "models": "models:models_app",
    "detect": "detecting:detect",
    "replay": "replaying:replay",
    "evaluate": "evaluating:evaluate",
    "demo": "demonstrating:demo",
}
for _verb, _target in VERBS.items():
    app.command(f"e3pose.cli.{_target}", name=_verb)


def main(tokens: Sequence[str] | None = None) -> None:
    """Run one verb; print a wrong input as one line on standard error and exit with code 2."""
    try:
        app(tokens, exit_on_error=False, print_error=True)
    except (InputError, OSError) as error:
        if isinstance(error, BrokenPipeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(EXIT_INPUT)
        print(f"e3pose: {_one_line(error)}", file=sys.stderr)
        sys.exit(EXIT_INPUT)
    except ImportError as error:
        _explain_missing(error)
    except KeyboardInterrupt:
        print("e3pose: interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _explain_missing(error: ImportError) -> None:
    raise error
