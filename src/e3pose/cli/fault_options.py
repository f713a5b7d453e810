"""Options that inject faults into a replay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from e3pose.cli.options import FAULTS
from e3pose.evaluate.faults import arriving, deaths_s, downsampled, parse_kill
from e3pose.settings.faults import Faults

if TYPE_CHECKING:
    from e3pose.recording import Recording


@Parameter(name="*", group=FAULTS)
@dataclass(frozen=True, kw_only=True)
class FaultOptions:
    """Injected faults, for every verb that runs the loop."""

    kill_camera: Annotated[tuple[str, ...], Parameter(negative="", show_default=False)] = ()
    """Fail a camera: CAMERA@SLOT or CAMERA@12.5s; repeatable. `each@SLOT` fails a different
    camera in each repetition."""
    loss: float = 0.0
    """Share of selected views lost in the network; their energy is still spent."""
    fps: float | None = None
    """Resample the recording to this frame rate."""

    def day(
        self, recording: Recording, watts: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    ) -> Faults:
        """Return the injected faults; raise `InputError` for impossible ones.

        Args:
            recording: as `downsampled` returns it.
            watts: what each camera draws when active, and when not.
        """
        day = Faults(tuple(parse_kill(text) for text in self.kill_camera), self.loss, watts)
        deaths_s(recording, day.kills)
        arriving(len(recording.rig), day.loss, 0, 0)
        return day

    def downsampled(self, recording: Recording) -> Recording:
        """Return the recording at the frame rate that is asked for."""
        return recording if self.fps is None else downsampled(recording, self.fps)
