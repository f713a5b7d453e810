"""Hide from e3pose in this process what macOS or Windows lacks.

`OTHER_SYSTEM=win32 pytest -p tests.other_system TESTS`, or `darwin`.

Libraries are loaded before, for they ask where they really are. Windows refuses to remove or move a
file that is open, and to move a folder onto another: here too. Its text is not UTF-8 unless asked
for: a text of ours that does not ask is an error.
"""

from __future__ import annotations

import builtins
import importlib
import importlib.util
import os
import signal
import socket
import sys
import types
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

# Those that ask for the system when they are imported.
LIBRARIES = [
    "asyncio",
    "av",
    "cryptography.x509",
    "cv2",
    "cyclopts",
    "joblib",
    "matplotlib",
    "msgspec",
    "multiprocessing.spawn",
    "numba",
    "onnx",
    "onnxruntime",
    "platformdirs",
    "prometheus_client",
    "psutil",
    "pyarrow.parquet",
    "rich.console",
    "scipy.optimize",
    "scipy.spatial",
    "sqlalchemy.dialects.sqlite",
    "structlog",
    "subprocess",
    "tempfile",
    "uvicorn",
    "yaml",
    "zenoh",
]
# What macOS lacks of Linux, and Windows of macOS.
LINUX = [
    "posix_fallocate",
    "posix_fadvise",
    "fdatasync",
    "sched_getaffinity",
    "sched_setaffinity",
    "eventfd",
    "memfd_create",
    "pipe2",
    "getresuid",
    "setresuid",
]
POSIX = [
    "chown",
    "chroot",
    "fchmod",
    "fchown",
    "fork",
    "forkpty",
    "getpgid",
    "getpriority",
    "killpg",
    "lchown",
    "mkfifo",
    "mknod",
    "nice",
    "pread",
    "preadv",
    "pwrite",
    "pwritev",
    "setpriority",
    "setpgid",
    "setsid",
    "statvfs",
    "sysconf",
    "O_NOFOLLOW",
    "O_DIRECTORY",
    "PRIO_PROCESS",
]
SIGNALS = [
    "SIGHUP",
    "SIGQUIT",
    "SIGUSR1",
    "SIGUSR2",
    "SIGALRM",
    "SIGPIPE",
    "setitimer",
    "pthread_kill",
]
MODULES = ("fcntl", "grp", "pwd", "resource", "termios", "tty", "pty", "syslog")


def pretend(system: str) -> None:
    """Let the modules of this project find themselves on another system."""
    for name in LIBRARIES:
        if importlib.util.find_spec(name.partition(".")[0]) is not None:
            importlib.import_module(name)
    real = importlib.import_module("fcntl")
    _hide(os, LINUX)
    if system == "win32":
        sys.modules["msvcrt"] = _msvcrt(real)
        _hide(os, POSIX)
        _hide(signal, SIGNALS)
        socket.SO_EXCLUSIVEADDRUSE = socket.SO_REUSEADDR  # type: ignore[attr-defined]
        os.O_BINARY = 0  # type: ignore[attr-defined]
        signal.SIGBREAK = signal.Signals.SIGUSR2  # type: ignore[attr-defined]
        builtins.__import__ = _without(MODULES, builtins.__import__)
        for name in ("unlink", "remove", "replace", "rename"):
            setattr(os, name, _refusing(name, getattr(os, name)))
    warnings.filterwarnings("error", category=EncodingWarning, module=r"e3pose")
    here, sys.platform = sys.platform, system
    for name in ("system", "child_process"):
        module = importlib.import_module(f"e3pose.base.{name}")
        module.sys = types.SimpleNamespace(platform=system)  # type: ignore[attr-defined]
    sys.platform = here


def _hide(module: Any, names: list[str]) -> None:
    for name in names:
        with suppress(AttributeError):
            delattr(module, name)


def _without(modules: Sequence[str], real: Callable[..., Any]) -> Callable[..., Any]:
    def find(name: str, globals: Any = None, *more: Any, **named: Any) -> Any:
        if name in modules and str((globals or {}).get("__name__", "")).startswith("e3pose"):
            raise ModuleNotFoundError(f"this system has no module {name}", name=name)
        return real(name, globals, *more, **named)

    return find


def _msvcrt(real: Any) -> types.ModuleType:
    """Return Windows's module, whose lock stands on a byte of the file."""
    module = types.ModuleType("msvcrt")

    def locking(handle: int, mode: int, num_bytes: int) -> None:
        assert mode == 2 and num_bytes == 1 and os.lseek(handle, 0, os.SEEK_CUR) >= 2**30
        try:
            real.flock(handle, real.LOCK_EX | real.LOCK_NB)
        except BlockingIOError as error:
            raise PermissionError(13, "Permission denied") from error

    module.locking, module.LK_NBLCK = locking, 2  # type: ignore[attr-defined]
    return module


def _refusing(name: str, real: Callable[..., None]) -> Callable[..., None]:
    def refuse(path: Any, *others: Any, **where: Any) -> None:
        if not where:
            for place in (path, *others):
                if (
                    opened := _opened_below(Path(os.path.realpath(os.fsdecode(place))))
                ) is not None:
                    raise PermissionError(13, f"open here, on Windows no {name}", str(opened))
            if others and os.path.isdir(others[0]):
                raise PermissionError(
                    13, f"a folder is there, on Windows no {name}", str(others[0])
                )
        real(path, *others, **where)

    return refuse


def _opened_below(path: Path) -> Path | None:
    for handle in os.listdir("/proc/self/fd"):
        with suppress(OSError):
            opened = Path(os.readlink(f"/proc/self/fd/{handle}"))
            if opened == path or path in opened.parents:
                return opened
    return None


if "OTHER_SYSTEM" in os.environ:
    pretend(os.environ["OTHER_SYSTEM"])
