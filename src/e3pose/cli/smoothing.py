"""Smoothing as an option: which method, and its cut-off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cyclopts import Parameter

from e3pose.base.quantities import frequency_hz
from e3pose.cli.options import EXPERIMENT, SMOOTHING, as_typed
from e3pose.estimate.smooth import SmoothSettings, check_smoothing


@Parameter(name="*", group=SMOOTHING)
@dataclass(frozen=True, kw_only=True)
class SmoothOptions:
    """Smoothing of poses afterwards, for every verb that can wait for it."""

    smooth: Literal["rts", "butterworth", "one-euro"] | None = None
    """Smooth the poses: `rts` uses all later slots, the others are low-pass filters."""
    cutoff: Annotated[str | None, Parameter(group=EXPERIMENT)] = None
    """Cut-off frequency of `butterworth` (default: 6Hz, or a quarter of the slot rate), and the
    minimum one of `one-euro` (default: 1Hz)."""

    def settings(self) -> SmoothSettings:
        """Return the settings of these options; raise `InputError` for contradictory ones."""
        with as_typed({"": "--cutoff"}):
            cutoff_hz = None if self.cutoff is None else frequency_hz(self.cutoff)
        settings = SmoothSettings(self.smooth, cutoff_hz)
        check_smoothing(settings)
        return settings
