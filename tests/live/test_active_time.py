"""Real processes: cameras count the slots in which they looked, edges learn what these draw."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.live.processes import CAMERAS, FPS, LiveSite
from tests.waiting import eventually

from active_time import ACTIVE_W, IDLE_W, beats_of, exact_command, learned

pytestmark = pytest.mark.nightly

LOOK_SHARE = 0.6  # of a slot, in which the meter counts what a look draws
SLOTS = 400


class Metered(LiveSite):
    """A site whose cameras have a meter that knows of every look."""

    def write(self) -> None:
        super().write()
        text = self.path.read_text().replace('"round-robin"', '"random"')
        self.path.write_text(text.replace("cameras = 2", "cameras = 1"))

    def camera_command(self, camera_id: str, *options: str) -> list[str]:
        command = super().camera_command(camera_id, *options)
        return exact_command(command, self.beats(camera_id), 1 / FPS, LOOK_SHARE)

    def beats(self, camera_id: str) -> Path:
        return self.folder / f"{camera_id}.jsonl"


def test_slots_with_a_look_are_the_active_time_and_teach_what_they_draw(
    tmp_path: Path, recording: Path
) -> None:
    (tmp_path / "recording").symlink_to(recording)
    site = Metered(tmp_path)
    with site.at_work():
        begin = {
            name: (site.camera(name).ordered, len(beats_of(site.beats(name)))) for name in CAMERAS
        }
        first = site.status().slot
        assert eventually(lambda: site.status().slot > first + SLOTS, 90.0), site.diagnostics()
        for name in CAMERAS:
            ordered, skipped = begin[name]
            beats = beats_of(site.beats(name))[skipped - 1 :]
            looks = beats[-1]["looks"] - beats[0]["looks"]
            active_s = beats[-1]["active_s"] - beats[0]["active_s"]
            assert active_s * FPS == pytest.approx(looks, rel=0.02)
            assert looks == pytest.approx(site.camera(name).ordered - ordered, rel=0.15, abs=4)
            (active_w, idle_w), measured = learned(beats, 1 / FPS)
            assert active_w == pytest.approx(ACTIVE_W, rel=0.1), f"measured: {measured}"
            assert idle_w == pytest.approx(IDLE_W, rel=0.1)
