"""`e3pose calibrate`: verbs in modules of their own, and the lab's `noise`."""

from __future__ import annotations

from cyclopts import App

from e3pose.cli.calibrating_lenses import board, intrinsics
from e3pose.cli.calibrating_places import extrinsics
from e3pose.cli.calibrating_worlds import align, check
from e3pose.cli.distributions import add_absent

calibrate_app = App(
    name="calibrate", help="Calibrate cameras, check a calibration, and measure keypoint noise."
)

# In the order in which they are called.
CALIBRATIONS = (board, intrinsics, extrinsics, align, check)
for _verb in CALIBRATIONS:
    calibrate_app.command(_verb)
add_absent(calibrate_app)
