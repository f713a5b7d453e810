"""The verbs of `e3pose`: each lives in a module that is imported only when it is called."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import NoReturn

from cyclopts import App, CycloptsError

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
    "demo": ("demonstrating:demo", "Real videos in, 3D poses and a page to look at out."),
    "detect": ("detecting:detect", "Find people in calibrated videos and write a recording."),
    "import": ("importing:import_app", "Make a recording from another format."),
    "simulate": ("simulating:simulate", "Make a recording of simulated people, with exact truth."),
    "info": ("information:info", "Describe a recording and say what is wrong with it."),
    "replay": ("replaying:replay", "Run one policy over a recording."),
    "evaluate": ("evaluating:evaluate", "Compare policies over a recording."),
    "models": ("models:models_app", "List and fetch network weights."),
}
for _verb, (_target, _about) in VERBS.items():
    app.command(f"e3pose.cli.{_target}", name=_verb)

# Which extra brings a module that a smaller install may lack.
EXTRAS = {
    "av": "camera",
    "cv2": "camera",
    "onnxruntime": "camera",
    "unearth": "models",
    "joblib": "edge",
    "numba": "edge",
    "pyarrow": "edge",
    "scipy": "edge",
    "yaml": "edge",
    "plotly": "report",
}


def main(tokens: Sequence[str] | None = None) -> None:
    """Run one verb; print a wrong input as one line on standard error and exit with code 2."""
    try:
        app(tokens, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        _fail(f"{_one_line(error)} (try --help)")
    except BrokenPipeError:  # the reader of our output went away: nothing is left to tell it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except (InputError, OSError) as error:
        _fail(_one_line(error))
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").split(".")[0])
        if extra is None:
            raise
        _fail(f"this needs {error.name}, expected it installed: pip install 'e3pose[{extra}]'")
    except KeyboardInterrupt:
        print("e3pose: interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)


def _fail(message: str) -> NoReturn:
    print(f"e3pose: {message}", file=sys.stderr)
    sys.exit(EXIT_INPUT)


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{error.filename}: {error.strerror.lower()}"
    return " ".join(str(error).split()) or type(error).__name__
