"""Differences of Linux, macOS and Windows in files, cores and addresses.

The platform is asked here and in `base.child_process`, and nowhere else; `make types` looks at the
types with the eyes of each of the three.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from e3pose.base.errors import InputError

if TYPE_CHECKING:
    import socket

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

# What a person, a terminal or a parent asks a program to end with.
END_SIGNALS: tuple[signal.Signals, ...] = (signal.SIGINT, signal.SIGTERM)
BINARY = 0  # which POSIX needs not ask for
NO_LINK = 0  # which Windows does not have
if sys.platform == "win32":
    END_SIGNALS = (*END_SIGNALS, signal.SIGBREAK)
    BINARY = os.O_BINARY
else:
    NO_LINK = os.O_NOFOLLOW
LOCKED_AT = 2**30  # Windows locks bytes, and nobody may read those: one that no file of ours has
ZEROS = bytes(2**20)


def open_new(path: Path, mode: int) -> int:
    """Create a file and return its handle, for reading and writing bytes.

    Raises:
        FileExistsError: when something is there, be it a link to nowhere.
    """
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | BINARY, mode)


def open_unlinked(path: Path, mode: int) -> int:
    """Open a file for reading and writing bytes, made if missing; never through a symbolic link."""
    if sys.platform == "win32":
        if path.is_symlink():
            raise OSError(errno.ELOOP, "is a symbolic link", str(path))
        return os.open(path, os.O_RDWR | os.O_CREAT | BINARY, mode)
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, mode)


def lock(handle: int) -> None:
    """Lock an open file for this program, until its last handle is closed.

    Raises:
        BlockingIOError: when another has it.
        OSError: when the file system has no locks.
    """
    if sys.platform == "win32":
        os.lseek(handle, LOCKED_AT, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(errno.EAGAIN, "is locked") from error
    else:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def remove_open(path: Path, handle: int) -> None:
    """Remove an open file and close its handle; on POSIX while nobody else can have its lock.

    One that cannot be removed stays: on a disk that is read-only by now, or, on Windows, because
    another program has opened it meanwhile, and removes it.
    """
    if sys.platform == "win32":
        os.close(handle)
    with suppress(OSError):
        path.unlink(missing_ok=True)
    if sys.platform != "win32":
        os.close(handle)


def read_at(handle: int, num_bytes: int, offset: int) -> bytes:
    """Read bytes at a place of a file that one thread uses."""
    if sys.platform == "win32":
        os.lseek(handle, offset, os.SEEK_SET)
        return os.read(handle, num_bytes)
    return os.pread(handle, num_bytes, offset)


def write_at(handle: int, content: bytes, offset: int) -> None:
    """Write bytes at a place of a file that one thread uses."""
    if sys.platform == "win32":
        os.lseek(handle, offset, os.SEEK_SET)
        os.write(handle, content)
    else:
        os.pwrite(handle, content, offset)


def reserve(handle: int, num_bytes: int) -> None:
    """Give a new file its space on the disk, so that a full one refuses it now and not later."""
    if sys.platform == "linux":
        os.posix_fallocate(handle, 0, num_bytes)
    else:
        for offset in range(0, num_bytes, len(ZEROS)):
            write_at(handle, ZEROS[: num_bytes - offset], offset)


def sync_content(handle: int) -> None:
    """Write the content of a file through to the disk."""
    if sys.platform == "linux":
        os.fdatasync(handle)
    else:
        os.fsync(handle)


def sync_path(path: Path) -> None:
    """Have a file's content, or a folder's names, on the disk when this returns."""
    folder = path.is_dir()
    if folder and sys.platform == "win32":
        return  # it keeps the names of a folder in a log of its own, and opens none
    # Windows syncs only what may be written.
    handle = os.open(path, os.O_RDWR if sys.platform == "win32" else os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError:
        if not folder:  # some network file systems cannot do it for folders: that is theirs
            raise
    finally:
        os.close(handle)


def set_mode(handle: int, mode: int) -> None:
    """Set the permissions of an open file, where they are the system's and not the folder's."""
    if sys.platform != "win32":
        os.fchmod(handle, mode)


def num_cores() -> int:
    """Return how many cores this program may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def claim_address(listening: socket.socket) -> None:
    """Let a socket take an address that a program has just left, and none that one listens at."""
    import socket

    # On Windows SO_REUSEADDR would share it with whoever listens there.
    name = "SO_EXCLUSIVEADDRUSE" if sys.platform == "win32" else "SO_REUSEADDR"
    listening.setsockopt(socket.SOL_SOCKET, getattr(socket, name), 1)


def stand_back() -> None:
    """Let other programs go first: what computes for a person waits for edges and cameras."""
    if sys.platform != "win32":
        with suppress(OSError):
            os.nice(10)


def bound_process(limit_s: float, most_memory: int) -> None:
    """Have the system end this process after a time, and refuse it more memory, in bytes.

    Windows does neither: there its parent waits as long, and ends it.
    """
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (most_memory, most_memory))
        signal.setitimer(signal.ITIMER_REAL, limit_s)  # by default its signal ends the process


def ended_by_deadline(returncode: int) -> bool:
    """Return whether a process ended by the deadline of `bound_process`."""
    return sys.platform != "win32" and returncode == -signal.SIGALRM


def require_linux(thing: str, instead: str) -> None:
    """Raise `InputError` on another system.

    Args:
        thing: what was asked for.
        instead: what does it elsewhere.
    """
    if sys.platform != "linux":
        raise InputError(thing, f"the system {sys.platform}", f"Linux; elsewhere {instead}")


def open_browser(url: str) -> bool:
    """Open an address in the person's browser; return whether there is a screen to open it on."""
    import webbrowser

    screen = sys.platform in ("win32", "darwin") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
    return screen and webbrowser.open(url)


def require_64_bits() -> None:
    """Raise `InputError` on a system of 32 bits, such as the smaller Raspberry Pi OS (armv7)."""
    if sys.maxsize < 2**32:
        expected = "one of 64 bits: NumPy, ONNX Runtime and Zenoh are not published for 32"
        raise InputError("system", "one of 32 bits", expected)


def video_input() -> str:
    """Return how FFmpeg calls the cameras of this system."""
    if sys.platform == "win32":
        return "dshow"
    return "avfoundation" if sys.platform == "darwin" else "video4linux2,v4l2"


def group_of(path: Path) -> str:
    """Return the group that a file belongs to; empty where none is known."""
    if sys.platform != "win32":
        with suppress(OSError, KeyError):
            return path.group()
    return ""


def since_boot_ns() -> int:
    """Return nanoseconds since the machine began, sleep included where the system counts it."""
    if sys.platform == "linux":
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    return time.monotonic_ns()
