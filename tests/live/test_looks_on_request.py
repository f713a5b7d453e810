"""A running edge whose cameras sleep gives who may fall more looks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.live.processes import CAMERAS, FPS, LiveSite
from tests.waiting import eventually

from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.store import Store

pytestmark = [pytest.mark.timed, pytest.mark.nightly]

# One person walks for four seconds, staggers, is down at seven, and stays there. Where the film
# begins again, edges look for who lay there for four seconds.
FALLS = SceneSettings("home-fall", seconds=16.0, fps=FPS, cameras=len(CAMERAS))
SEED = 12
BEFORE_S, UNSURE_S, AFTER_S = (-2.6, -1.2), (0.3, 2.0), (4.2, 6.5)  # since the fall


class AskingSite(LiveSite):
    """A site that tells falls, chooses cameras itself, and lets them sleep."""

    def write(self) -> None:
        super().write()
        usual = 'policy = "round-robin"\ncameras = 2\n'
        wanted = 'policy = "information"\nrest = "asleep"\nwatts = "19W"\n'
        self.path.write_text(self.path.read_text().replace(usual, wanted))

    def looks(self) -> list[tuple[float, float, float]]:
        """Return cameras per slot before each fall that is stored, when it is unsure, and after."""
        store = Store(self.folder / "poses.db")
        slots = list(store.rows("slots"))
        times_s = np.array([row["time_ns"] for row in slots]) / 1e9
        count = np.array([row["selected"].count("1") for row in slots])

        def mean(fall_s: float, window_s: tuple[float, float]) -> float:
            within = (times_s >= fall_s + window_s[0]) & (times_s < fall_s + window_s[1])
            return float(count[within].mean()) if within.any() else float("nan")

        falls_s = [r["start_ns"] / 1e9 for r in store.rows("events") if r["kind"] == "fall"]
        whole = [fall_s for fall_s in falls_s if fall_s + AFTER_S[1] < times_s[-1]]
        return [
            (mean(fall_s, BEFORE_S), mean(fall_s, UNSURE_S), mean(fall_s, AFTER_S))
            for fall_s in whole
        ]


def test_who_falls_gets_more_looks_where_cameras_sleep(tmp_path: Path) -> None:
    save_recording(simulate(FALLS, SEED), tmp_path / "recording")
    site = AskingSite(tmp_path, tables=("[store]", 'path = "poses.db"', "[events]"))
    with site.at_work():
        assert eventually(
            lambda: any(
                unsure > 1.8 * max(before, after) for before, unsure, after in site.looks()
            ),
            90.0,
        ), (site.looks(), site.diagnostics())
        assert any(camera.mode == "asleep" for camera in site.cameras_since(0))
