"""What a store keeps of a run is enough to smooth it later."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from e3pose.estimate.smooth import SmoothSettings, smoothed
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.take import Take
from e3pose.output.exports.source import Asked, take_from_store
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.store import Run, StoreWriter

pytestmark = pytest.mark.slow

NEAR_M = 0.5


def error_mm(take: Take, recording: Recording) -> float:
    """Return the mean distance of joints from those of the nearest person of the truth."""
    assert recording.truth is not None
    found = []
    for motion in take.motions:
        truth = recording.truth.joints_m[motion.first : motion.first + len(motion)]
        apart = np.linalg.norm(truth - motion.joints_m[:, None], axis=-1)
        with np.errstate(invalid="ignore"):
            whole = np.nanmean(np.where(motion.known[:, None], apart, np.nan), axis=-1)
        nearest = np.nanargmin(whole, axis=1)
        own = apart[np.arange(len(motion)), nearest]
        found.append(own[motion.known & (own < NEAR_M)])
    return 1000 * float(np.concatenate(found).mean())


@pytest.mark.parametrize(("cameras", "gain"), [(1, 0.15), (5, 0.0)])
def test_a_store_is_smoothed_nearly_as_well_as_a_replay(
    tmp_path: Path, cameras: int, gain: float
) -> None:
    recording = simulate(SceneSettings(scene="ring", people=2, seconds=12, fps=12.5), 1003)
    started_ns, interval_s = 1_700_000_000_000_000_000, recording.interval_s
    names = tuple(camera.camera_id for camera in recording.rig.cameras)
    skeleton = recording.skeleton
    run = Run("lab", "r", started_ns, interval_s, skeleton.name, skeleton.joints, names)
    with StoreWriter(str(tmp_path / "live.db"), run) as writer:
        settings = ReplaySettings(num_selected=cameras, seed=1, phase=1)
        for record in replay(recording, settings):
            writer.append(record, wait=True)
    take = take_from_store(str(tmp_path / "live.db"), Asked())
    before, after = (
        error_mm(each, recording) for each in (take, smoothed(take, SmoothSettings("rts")))
    )
    assert after < (1 - gain) * before, (before, after)
