"""Write files and folders atomically."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from e3pose.base.errors import InputError, reason_of
from e3pose.base.lock import hold
from e3pose.base.private import file_mode, folder_mode, make_folder
from e3pose.base.system import sync_path


@contextmanager
def atomic_file(path: Path, private: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside `path` that becomes `path` if the block ends without error.

    It is on the disk before it has its name: a power cut leaves the old file or the new one.

    Args:
        path: the file to write; its folder is made if need be.
        private: whether it is for its owner alone, as `private.file_mode` says.

    Raises:
        InputError: when something other than a file stands at `path`, or none can be made there.
    """
    check_file_free(path)
    try:
        _make_above(path, private)
        handle, name = tempfile.mkstemp(
            prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent
        )
    except OSError as error:
        raise _unwritable(path, error) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(file_mode(path.parent) if private else 0o666 & ~_umask())
        sync_path(temporary)
        os.replace(temporary, path)
        sync_path(path.parent)
    except OSError as error:
        raise _with_advice(path, error) from None
    finally:
        temporary.unlink(missing_ok=True)


def write_file(path: Path, content: str | bytes, private: bool = False) -> None:
    """Write a whole file, text as UTF-8; otherwise as `atomic_file` does, with its errors."""
    with atomic_file(path, private) as temporary:
        if isinstance(content, bytes):
            temporary.write_bytes(content)
        else:
            temporary.write_text(content, encoding="utf-8")


@contextmanager
def atomic_folder(
    path: Path,
    overwrite: bool = False,
    ours: tuple[str, ...] = ("recording.toml",),
    private: bool = False,
    held: bool = False,
) -> Iterator[Path]:
    """Yield a temporary folder beside `path` that becomes `path` if the block ends without error.

    What stood at `path` is moved aside, and deleted only once the new folder is in its place; if
    that fails it is moved back. All of it is on the disk before the folder has its name.

    Args:
        path: the folder to make.
        overwrite: whether a folder of ours may be replaced, with all that is in it.
        ours: file names, any of which marks a folder as one that this program wrote.
        private: whether it is for its owner alone, as `private.folder_mode` says.
        held: whether the caller holds the lock of `path`.

    Raises:
        InputError: when `path` is neither free nor an empty folder, unless `overwrite` and the
            folder is ours, or another program writes it; a symbolic link is never replaced.
    """
    check_free(path, overwrite, ours)
    try:
        _make_above(path, private)
    except OSError as error:
        raise _unwritable(path, error) from None
    with nullcontext() if held else hold(path):
        try:
            temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
        except OSError as error:
            raise _unwritable(path, error) from None
        try:
            yield temporary
            temporary.chmod(folder_mode(path.parent) if private else 0o777 & ~_umask())
            check_free(path, overwrite, ours)  # hours may have passed since the first look
            for above, _, names in os.walk(temporary):
                for name in names:
                    if not (part := Path(above, name)).is_symlink():
                        sync_path(part)
                sync_path(Path(above))
            _replace(temporary, path)
            sync_path(path.parent)
        except OSError as error:
            raise _with_advice(path, error) from None
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def check_file_free(path: Path) -> None:
    """Raise `InputError` if `atomic_file` cannot write at `path`, as far as a look can tell."""
    # A device or pipe would be replaced by a file: as root, `/dev/null` for all who need it.
    if path.is_dir() or (path.exists() and not path.is_file()):
        found = "a folder" if path.is_dir() else "a pipe, socket or device"
        raise InputError(f"{path}: found {found}, expected a file to write")
    _check_above(path)


def check_output(path: Path) -> None:
    """Raise `InputError` if a file that a person named cannot be written at `path`.

    Its folder must be there: one that is made for a slip of the pen is found by nobody.
    """
    check_file_free(path)
    if not path.parent.is_dir():
        raise InputError(
            f"{path}: found no folder {path.parent}, expected one (mkdir -p {path.parent})"
        )


def check_free(
    path: Path, overwrite: bool | None = False, ours: tuple[str, ...] = ("recording.toml",)
) -> None:
    """Raise `InputError` unless `atomic_folder` with these arguments may write at `path`.

    Args:
        path: the folder to write.
        overwrite: as of `atomic_folder`; None where the command has no such option.
        ours: as of `atomic_folder`.
    """
    if path.is_symlink():
        raise InputError(f"{path}: found a symbolic link, expected the name of a folder to create")
    if path.is_dir():
        if not any(path.iterdir()):
            return
        if not overwrite:
            what = "expected a new name" if overwrite is None else "pass --overwrite to replace it"
            raise InputError(f"{path}: folder exists and is not empty, {what}")
        if not any((path / name).is_file() for name in ours):
            raise InputError(
                f"{path}: folder holds no {' or '.join(ours)}, so it will not be replaced; "
                "remove it yourself or choose another name"
            )
    elif path.exists():
        raise InputError(f"{path}: found a file, expected the name of a folder to create")
    _check_above(path)


def _make_above(path: Path, private: bool) -> None:
    if private:
        make_folder(path.parent)
    else:
        path.parent.mkdir(parents=True, exist_ok=True)


def _check_above(path: Path) -> None:
    above = path.parent
    while not above.exists() and above != above.parent:
        above = above.parent
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        found = "a folder that may not be written" if above.is_dir() else "a file"
        raise InputError(f"{path}: cannot be written: {above} is {found}")


def _replace(temporary: Path, path: Path) -> None:
    if not path.is_dir():
        os.replace(temporary, path)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{path.name}.old.", dir=path.parent))
    old = aside / "old"
    try:
        os.replace(path, old)
        try:
            os.replace(temporary, path)
        except OSError:
            os.replace(old, path)
            raise
    finally:
        if path.exists():  # otherwise the old folder could not be put back: keep it
            shutil.rmtree(aside, ignore_errors=True)


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot be written: {reason_of(error).lower()}")


def _with_advice(path: Path, error: OSError) -> OSError | InputError:
    """Name the destination in an error that names no file, such as that of a full disk."""
    return _unwritable(path, error) if error.filename is None else error


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
