"""Shared parts of the verbs of the live programs."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from e3pose.base.log_stream import outlast
from e3pose.base.quantities import duration_s
from e3pose.cli.options import as_typed
from e3pose.site.run import bound_heaps
from e3pose.site.run import end_with_parent as look_after_parent

DELAY = {"smooth_delay_ms": "--delay"}
# For programs that start others: `site.up`.
Child = Annotated[bool, Parameter(negative="", show=False)]


def delay_ms(delay: str | None) -> float | None:
    """Return the milliseconds of `--delay`."""
    if delay is None:
        return None
    with as_typed({"": "--delay"}):
        return 1e3 * duration_s(delay)


def begin(end_with_parent: bool = False) -> None:
    """Prepare a program that runs for months."""
    bound_heaps()
    outlast()
    if end_with_parent:
        look_after_parent()
