"""The verbs of `e3pose`: modules of their own that import little until called."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any, NoReturn

from cyclopts import App, CycloptsError, Group, MissingArgumentError

from e3pose import __version__
from e3pose.base.errors import InputError
from e3pose.base.system import END_SIGNALS
from e3pose.cli.archiving import archive_app
from e3pose.cli.attaching import attach
from e3pose.cli.calibrating import calibrate_app
from e3pose.cli.calibrating_lenses import board, intrinsics
from e3pose.cli.calibrating_places import extrinsics
from e3pose.cli.calibrating_worlds import align
from e3pose.cli.calibrating_worlds import check as check_calibration
from e3pose.cli.checking import check
from e3pose.cli.copying import store_app
from e3pose.cli.demonstrating import demo
from e3pose.cli.detecting import detect
from e3pose.cli.evaluating import evaluate
from e3pose.cli.eventing import events_app
from e3pose.cli.exporting import export
from e3pose.cli.hubbing import hub_app
from e3pose.cli.importing import import_app
from e3pose.cli.information import info
from e3pose.cli.keys import keys_app
from e3pose.cli.lab import LAB, lab_verbs
from e3pose.cli.learning import learn_app
from e3pose.cli.metering import power_app
from e3pose.cli.models import models_app
from e3pose.cli.naming import people_app
from e3pose.cli.phoning import phone
from e3pose.cli.querying import query
from e3pose.cli.recording import record
from e3pose.cli.replaying import replay
from e3pose.cli.reporting import report
from e3pose.cli.routing import router
from e3pose.cli.running import camera, edge, up
from e3pose.cli.setting_up import setup
from e3pose.cli.simulating import simulate
from e3pose.cli.starting import init
from e3pose.cli.streaming import stream
from e3pose.cli.synchronising import sync
from e3pose.cli.viewing import view
from e3pose.cli.watching import top

EXIT_INPUT = 2  # the input or the options are wrong
EXIT_INTERRUPTED = 130
MAX_MESSAGE = 1000

app = App(
    name="e3pose",
    version=__version__,
    version_flags=["--version", "-V"],
    suppress_keyboard_interrupt=False,  # `main` says that it was interrupted
    help="Multi-camera 3D human pose on a camera energy budget: each time slot wakes the most "
    "informative cameras that still have energy budget.\n\n"
    "New here? `e3pose setup` leads from your cameras, or films, to live 3D in the browser. "
    "`e3pose demo` shows what comes of it.",
)
_options = Group("Options", sort_key=99)
app.register_install_completion_command(
    group=_options, help="Install tab completion for bash, zsh or fish."
)
app["--help"].group = app["--version"].group = _options
# Verbs by group, in the order of `e3pose --help`.
GROUPS: dict[str, tuple[str, ...]] = {
    "Start here": ("setup", "demo", "init", "up"),
    "Recordings": ("detect", "import", "attach", "simulate", "info", "sync", "replay", "export"),
    "Calibrate": ("calibrate",),
    "Live site": (
        "keys",
        "phone",
        "check",
        "record",
        "edge",
        "camera",
        "router",
        "top",
        "view",
        "stream",
        "query",
        "store",
        "events",
        "people",
        "archive",
        "hub",
        "report",
    ),
    "Evaluate": ("evaluate", "each", "evaluate-predictor", "reproduce"),
    "Learn": ("train", "learn"),
    "Maintenance": ("models", "power"),
}
VERBS: dict[str, Callable[..., Any]] = {
    "demo": demo,
    "init": init,
    "setup": setup,
    "phone": phone,
    "detect": detect,
    "import": import_app,
    "attach": attach,
    "simulate": simulate,
    "info": info,
    "replay": replay,
    "query": query,
    "store": store_app,
    "archive": archive_app,
    "hub": hub_app,
    "events": events_app,
    "people": people_app,
    "report": report,
    "export": export,
    "power": power_app,
    "evaluate": evaluate,
    "calibrate": calibrate_app,
    "sync": sync,
    "models": models_app,
    "edge": edge,
    "router": router,
    "up": up,
    "camera": camera,
    "record": record,
    "keys": keys_app,
    "top": top,
    "view": view,
    "stream": stream,
    "check": check,
    "learn": learn_app,
    **lab_verbs(),
}
# Usage of the verbs that take several paths or names, which the parser calls ARGS.
USAGE = {
    "detect": "[OPTIONS] VIDEO... DEST",
    "each": "[OPTIONS] DEST RECORDING...",
    "edge": "[OPTIONS] SITE...",
    "evaluate-predictor": "[OPTIONS] RECORDING...",
    "init": "[OPTIONS] FOLDER [SOURCE...]",
    "stream": "[OPTIONS] SITE TARGET...",
    "sync": "[OPTIONS] VIDEO... | RECORDING [DEST]",
    "train": "[OPTIONS] RECORDING...",
}
for _rank, (_title, _verbs) in enumerate(GROUPS.items()):
    _group = Group(_title, sort_key=_rank)
    for _place, _verb in enumerate(_verbs):
        _target = VERBS[_verb]
        if isinstance(_target, App):  # a verb with verbs of its own
            _target.group, _target.sort_key = (_group,), _place
            app.command(_target, name=_verb)
        else:
            usage = f"Usage: e3pose {_verb} {USAGE[_verb]}" if _verb in USAGE else None
            app.command(
                _target,
                name=_verb,
                group=_group,
                sort_key=_place,
                usage=usage,
                version_flags="--version",  # -V is a weight in some
            )
CALIBRATE_VERBS: dict[str, Callable[..., Any]] = {
    "board": board,
    "intrinsics": intrinsics,
    "extrinsics": extrinsics,
    "align": align,
    "check": check_calibration,
}
for _verb, _function in CALIBRATE_VERBS.items():
    calibrate_app.command(_function, name=_verb)

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
    "sqlalchemy": "edge",
    "yaml": "edge",
    "prometheus_client": "edge",
    "structlog": "edge",
    "cryptography": "edge",
    "zenoh": "edge",
    "ezc3d": "export",
    "pythonosc": "osc",
    "pylsl": "lsl",
    "foxglove": "foxglove",
    "paho": "mqtt",
    "fastapi": "view",
    "orjson": "view",
    "starlette": "view",
    "tomlkit": "view",
    "uvicorn": "view",
    "websockets": "view",
    "pandas": "notebook",
    "rerun": "rerun",
    "plotly": "report",
    "matplotlib": "report",
    "distributed": "lab",
    "fsspec": "archive",
    "duckdb": "hub",
    LAB: "lab",
    "motmetrics": "lab",
    "torch": "train",
}


def main(tokens: Sequence[str] | None = None) -> None:
    """Run one verb; print a wrong input as one line on standard error and exit with code 2."""
    # A polite kill unwinds like any error, so that temporary files go away with us.
    if threading.current_thread() is threading.main_thread():
        for number in END_SIGNALS[1:]:  # Ctrl-C is an exception
            signal.signal(number, lambda number, _frame: sys.exit(128 + number))
    sys.stdout = sys.stdout or io.StringIO()  # None where the caller closed it
    if isinstance(sys.stdout, io.TextIOWrapper):  # a name that it cannot show is no reason to stop
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        if tokens is None and len(sys.argv) == 1:
            tokens = _without_words()
        try:
            app(tokens, exit_on_error=False, print_error=False)
        finally:
            sys.stdout.flush()  # here, where a full disk or a closed pipe can still be reported
    except CycloptsError as error:
        _fail(f"{_one_line(error)} (try --help)")
    except BrokenPipeError:  # the reader of our output went away: nothing is left to tell it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except (InputError, OSError) as error:
        _fail(_one_line(error))
    except MemoryError:
        _fail("out of memory, expected a smaller or shorter input")
    except ModuleNotFoundError as error:
        extra = EXTRAS.get((error.name or "").split(".")[0])
        if extra is None:
            raise
        _fail(f"{error.name} is not installed: pip install 'e3pose[{extra}]'")
    except KeyboardInterrupt:
        print("e3pose: interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)


def _without_words() -> list[str]:
    """Return what to do where only `e3pose` was typed: set up, if there is a person to do it."""
    ready = all(find_spec(name) is not None for name in ("fastapi", "uvicorn", "cv2"))
    if not (sys.stdin and sys.stdin.isatty() and sys.stdout.isatty() and ready):
        return ["--help"]
    print("No command given: this is `e3pose setup`. `e3pose --help` lists the commands.")
    return ["setup"]


def _fail(message: str) -> NoReturn:
    print(f"e3pose: {message}", file=sys.stderr)
    sys.exit(EXIT_INPUT)


def _one_line(error: Exception) -> str:
    if isinstance(error, MissingArgumentError) and error.argument is not None:
        what = (
            f"{error.keyword} needs a value" if error.keyword else f"missing {error.argument.name}"
        )
        text = f"{' '.join(error.command_chain or ())}: {what}"
    elif isinstance(error, OSError) and error.strerror and error.filename is not None:
        text = f"{os.fsdecode(error.filename)}: {error.strerror.lower()}"
    else:
        text = (isinstance(error, OSError) and error.strerror) or str(error)
    # Names from files may hold control characters, which could rewrite the terminal.
    line = "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode()
        for char in " ".join((text or type(error).__name__).split())
    )
    half = MAX_MESSAGE // 2
    return line if len(line) <= MAX_MESSAGE else f"{line[:half]} ... {line[-half:]}"
