"""The verbs of `e3pose`: functions in modules that are loaded when a verb is typed."""

from __future__ import annotations

import ast
import gc
import io
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.util import find_spec, resolve_name
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from cyclopts import App, CycloptsError, Group, MissingArgumentError
from cyclopts.help import DefaultFormatter, HelpPanel

from e3pose import __version__
from e3pose.base.errors import Exit, Fault, InputError, exit_code, reason_of
from e3pose.base.installing import not_installed
from e3pose.base.masking import masked
from e3pose.base.quantities import plural
from e3pose.base.system import END_SIGNALS
from e3pose.cli.distributions import EXTRAS as DISTRIBUTIONS
from e3pose.cli.distributions import other_verb, with_lab

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions

VERSION = ["--version", "-V"]
SIGPIPE = 13  # which Windows has not
MAX_MESSAGE = 1000

# Verbs by group, in the order of `e3pose --help-all`. Each is the `module:name` of its function, or
# of an app of more verbs; the module is loaded when its verb is typed.
GROUPS: dict[str, dict[str, str | Callable[..., Any]]] = {
    "Start here": {
        "setup": ".setting_up:setup",
        "demo": ".demonstrating:demo",
        "init": ".starting:init",
        "up": ".running_site:up",
    },
    "Films to 3D": {
        "reconstruct": ".reconstructing:reconstruct_films",
        "calibrate": ".calibrating:calibrate_app",
        "replay": ".replaying:replay",
        "export": ".exporting:export",
    },
    "Live site": {
        "check": ".checking:check",
        "record": ".recording:record",
        "view": ".viewing:view",
        "stream": ".streaming:stream",
    },
    "Recordings": {
        "detect": ".detecting:detect",
        "import": ".importing:import_app",
        "attach": ".attaching:attach",
        "simulate": ".simulating:simulate",
        "info": ".information:info",
        "sync": ".synchronising:sync",
    },
    "Run a site": {
        "keys": ".keys:keys_app",
        "phone": ".phoning:phone",
        "edge": ".running_edge:edge",
        "camera": ".running_camera:camera",
        "cameras": ".running_cameras:cameras",
        "router": ".routing:router",
        "top": ".watching:top",
        "query": ".querying:query",
        "store": ".copying:store_app",
        "events": ".eventing:events_app",
        "people": ".naming:people_app",
        "archive": ".archiving:archive_app",
        "hub": other_verb("hub"),
    },
    "Evaluate": {
        "evaluate": other_verb("evaluate"),
        "each": other_verb("each"),
        "evaluate-predictor": other_verb("evaluate-predictor"),
        "reproduce": other_verb("reproduce"),
    },
    "Learn": {"train": other_verb("train"), "learn": other_verb("learn")},
    "Maintenance": {"models": ".models:models_app", "power": ".metering:power_app"},
}
HELP_ALL, HELP_PAPER = "--help-all", "--help-paper"
# Panels that `--help` leaves out: commands after the third group, and options that few people need.
LATER = {title: HELP_ALL for title in (*GROUPS,)[3:]}
POWER, STORE = "Power profiles and batteries", "Store"
EXPERIMENTS, FAULTS, PAPER = "Experiments", "Faults to inject", "The paper's pipeline and policies"
EXPERT = {**dict.fromkeys((POWER, STORE, EXPERIMENTS, FAULTS), HELP_ALL), PAPER: HELP_PAPER}
APP = "_app"  # the end of the name of what has verbs of its own
# Of all parsers of a process: verbs with verbs of their own are apps that these share.
TITLES = {title: Group(title, sort_key=rank) for rank, title in enumerate(GROUPS)}
OPTIONS = Group("Options", sort_key=99)
VERBS = tuple(verb for verbs in GROUPS.values() for verb in verbs)
# Usage of the verbs that take several paths or names, which the parser calls ARGS.
USAGE = {
    "cameras": "[OPTIONS] SITE | CAMERA_FILE...",
    "detect": "[OPTIONS] VIDEO... DEST",
    "each": "[OPTIONS] DEST RECORDING...",
    "edge": "[OPTIONS] SITE...",
    "evaluate-predictor": "[OPTIONS] RECORDING...",
    "init": "[OPTIONS] FOLDER [SOURCE...]",
    "reconstruct": "[OPTIONS] FILM... | TRIALS",
    "stream": "[OPTIONS] SITE TARGET...",
    "sync": "[OPTIONS] VIDEO... | RECORDING [DEST]",
    "train": "[OPTIONS] RECORDING...",
}
# The modules that extras bring, and a smaller install may lack.
MODULES = {
    "camera": ("av", "cv2", "onnxruntime"),
    "models": ("unearth",),
    "edge": (
        *("cryptography", "numba", "prometheus_client", "pyarrow", "scipy", "sqlalchemy"),
        *("structlog", "yaml", "zenoh"),
    ),
    "report": ("matplotlib", "plotly"),
    "view": ("fastapi", "orjson", "starlette", "tomlkit", "uvicorn", "websockets"),
    "osc": ("pythonosc",),
    "lsl": ("pylsl",),
    "foxglove": ("foxglove",),
    "mqtt": ("paho",),
    "notebook": ("pandas",),
    "rerun": ("rerun",),
    "archive": ("fsspec",),
    "join": ("spake2", "zeroconf"),
    "lab": ("distributed", "joblib", "motmetrics"),
    "train": ("torch",),
}
EXTRAS = {name: extra for extra, names in MODULES.items() for name in names} | DISTRIBUTIONS


def make_app(summary: Callable[[str], str | None] = lambda place: None) -> App:
    """Return the parser of all verbs; none of their modules is loaded.

    Args:
        summary: returns a line on the verb at a place, for the list of verbs.
    """
    made = App(
        name="e3pose",
        version=__version__,
        version_flags=VERSION,
        suppress_keyboard_interrupt=False,  # `main` says that it was interrupted
        help="3D poses of several people from a few ordinary cameras: from films, live, or on an "
        "energy budget.\n\n"
        "New here? `e3pose setup` leads from your cameras, or films, to live 3D in the browser. "
        "`e3pose demo` shows an example result.",
    )
    made.command(
        App(HELP_ALL, group=OPTIONS, help="List all commands; after a command, all its options.")
    )
    made.register_install_completion_command(
        group=OPTIONS, help="Install tab completion for bash, zsh or fish."
    )
    made["--help"].group = made["--version"].group = OPTIONS
    for title, verbs in GROUPS.items():
        for sort_key, (verb, target) in enumerate(verbs.items()):
            own: dict[str, Any] = {"group": TITLES[title], "sort_key": sort_key}
            if verb in USAGE:
                own["usage"] = f"Usage: e3pose {verb} {USAGE[verb]}"
            if not str(target).endswith(APP):
                own["version_flags"] = "--version"  # -V is a weight in some
            if isinstance(target, str):
                own["help"] = summary(target)
                target = with_lab(verb, resolve_name(target, "e3pose.cli"))
            made.command(target, name=verb, **own)
    return made


def summary_of(place: str) -> str:
    """Return the first line of help at a place, `module:name`, without loading its module."""
    module, name = resolve_name(place, "e3pose.cli").split(":")
    spec = find_spec(module)
    assert spec is not None and spec.origin is not None, module
    for node in ast.parse(Path(spec.origin).read_bytes()).body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            helps = (word.value for word in node.value.keywords if word.arg == "help")
            if ast.unparse(node.targets[0]) == name and (text := next(helps, None)):
                return str(ast.literal_eval(text))
        elif isinstance(node, ast.FunctionDef) and node.name == name.removesuffix(APP):
            return str(ast.get_docstring(node)).partition("\n")[0]
    raise AttributeError(place)


app = make_app()


def main(tokens: Sequence[str] | None = None) -> None:
    """Run one verb; print its error in one line on standard error, and exit as `Exit` says."""
    # Most of what a program loads stays: to look it through for garbage after each 700 new objects
    # takes a tenth of its start.
    gc.set_threshold(20_000)
    # A polite kill unwinds as Ctrl-C does, so that temporary files go away with us.
    if threading.current_thread() is threading.main_thread():
        for number in END_SIGNALS[1:]:
            signal.signal(number, _interrupt)
    # What the caller closed is opened: the next file or connection would become our output.
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))
    if isinstance(sys.stdout, io.TextIOWrapper):  # a name that it cannot show is no reason to stop
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        if tokens is None and len(sys.argv) == 1:
            tokens = _without_words()
        words = sys.argv[1:] if tokens is None else tokens
        # The list of all verbs has a line on each.
        program = app if {*words} & {*VERBS, *VERSION} else make_app(summary_of)
        asked = next((word for word in words if word in (HELP_ALL, HELP_PAPER)), "--help")
        program.help_formatter = _Help(asked)
        words = ["--help" if word == asked else word for word in words]
        try:
            program(words, exit_on_error=False, print_error=False)
        finally:
            sys.stdout.flush()  # here, where a full disk or a closed pipe can still be reported
    except BrokenPipeError:  # the reader of our output went away: nothing is left to tell it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(Exit.SIGNAL + SIGPIPE)
    except (Exception, KeyboardInterrupt) as error:
        message, code = _ending(error)
        with suppress(OSError):  # a full disk or a closed pipe changes no code
            print(f"e3pose: {masked(message)}", file=sys.stderr, flush=True)
        sys.exit(code)


class _Help(DefaultFormatter):
    """Shows the panels of help that are asked for, and counts the options of the others."""

    def __init__(self, asked: str) -> None:
        super().__init__()
        self._asked = asked

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        """Print a panel, a line on it, or nothing."""
        title = str(panel.title)
        wanted = (LATER | EXPERT).get(title, "--help")
        if self._asked in (wanted, HELP_ALL):
            super().__call__(console, options, panel)
        elif title in EXPERT and self._asked == "--help":
            console.print(f" {title}: {plural(len(panel.entries), 'option')}, see {wanted}")


def _interrupt(number: int, _frame: object) -> NoReturn:
    raise KeyboardInterrupt(number)


def _ending(error: BaseException) -> tuple[str, int]:
    """Return the message and the exit code of an error that ends a verb."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted", exit_code(error)
    if isinstance(error, CycloptsError):
        return f"{_one_line(error)} (try --help)", Exit.REFUSED
    if isinstance(error, MemoryError):
        return "out of memory, expected a smaller or shorter input", Exit.REFUSED
    if isinstance(error, ImportError):
        missing = error.__cause__ or error  # the parser's, which loads a verb's module
        name = missing.name if isinstance(missing, ModuleNotFoundError) else None
        if (extra := EXTRAS.get((name or "").split(".")[0])) is not None:
            return not_installed(name, extra), Exit.REFUSED
    cause = (error.__cause__ if isinstance(error, Fault) else None) or error
    if not isinstance(cause, (InputError, OSError, Fault)):  # a fault of ours
        with suppress(OSError):
            print(masked("".join(traceback.format_exception(cause))), file=sys.stderr)
    return _one_line(cause), exit_code(error)


def _without_words() -> list[str]:
    """Return the verb for a bare `e3pose`: set up, if there is a person to do it."""
    ready = all(find_spec(name) is not None for name in ("fastapi", "uvicorn", "cv2"))
    if not (sys.stdin and sys.stdin.isatty() and sys.stdout.isatty() and ready):
        return ["--help"]
    print("No command given: this is `e3pose setup`. `e3pose --help` lists the commands.")
    return ["setup"]


def _one_line(error: BaseException) -> str:
    if isinstance(error, MissingArgumentError) and error.argument is not None:
        what = (
            f"{error.keyword} needs a value" if error.keyword else f"missing {error.argument.name}"
        )
        text = f"{' '.join(error.command_chain or ())}: {what}"
    elif isinstance(error, OSError) and error.strerror and error.filename is not None:
        text = f"{os.fsdecode(error.filename)}: {error.strerror.lower()}"
    else:
        text = reason_of(error)
    # Names from files may hold control characters, which could rewrite the terminal.
    line = "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode()
        for char in " ".join(text.split())
    )
    half = MAX_MESSAGE // 2
    return line if len(line) <= MAX_MESSAGE else f"{line[:half]} ... {line[-half:]}"
