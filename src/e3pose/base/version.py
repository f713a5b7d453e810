"""Files that other programs replace while this one runs: their version, what reads them again."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from e3pose.base.errors import InputError

Version = tuple[int, ...]


def version_of(paths: Iterable[Path]) -> Version | None:
    """Return a value that changes whenever a file is replaced; None while one is missing."""
    try:
        found = [path.stat() for path in paths]
    except OSError:
        return None
    return tuple(number for status in found for number in (status.st_mtime_ns, status.st_ino))


@dataclass(slots=True, eq=False)
class Watched:
    """Files that are read again when they were replaced.

    Attributes:
        files: all of them, as they are when this is made.
        load: reads them; tried again at each update while it raises `InputError`.
        refuse: called once with each reason why they cannot be used.
    """

    files: tuple[Path, ...]
    load: Callable[[], object]
    refuse: Callable[[str], object]
    _seen: Version | None = field(init=False)
    _refused: str = ""

    def __post_init__(self) -> None:
        self._seen = version_of(self.files)

    def update(self) -> None:
        """Load the files if they changed since they were loaded."""
        seen = version_of(self.files)
        if seen is None or seen == self._seen:  # None: being replaced
            return
        try:
            self.load()
        except InputError as error:
            if str(error) != self._refused:
                self.refuse(str(error))
            self._refused = str(error)
            return
        self._seen, self._refused = seen, ""
