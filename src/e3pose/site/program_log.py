"""The Protocol of a program's log."""

from __future__ import annotations

from typing import Any, Protocol


class Log(Protocol):
    """The log of a program: lines for people, with fields; an adapter of `logging`."""

    def info(self, event: str, **fields: Any) -> Any:
        """Take a line."""
        ...

    def warning(self, event: str, **fields: Any) -> Any:
        """Log a line that needs action."""
        ...


class Unheard:
    """Discards log lines."""

    def info(self, event: str, **fields: Any) -> None:
        """Take a line."""

    def warning(self, event: str, **fields: Any) -> None:
        """Take a line."""


NO_LOG = Unheard()
