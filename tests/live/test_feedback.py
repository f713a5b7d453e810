"""A site of real processes whose cameras detect in films, at the parts that the edge names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.cli import commands
from tests.live.processes import CAMERAS, LiveSite, e3pose
from tests.waiting import eventually

pytestmark = [pytest.mark.live, pytest.mark.slow]

FPS = 5.0  # slots per second: three cameras detect on two cores beside other programs


class Filmed(LiveSite):
    """A site whose cameras play films."""

    def start_camera(self, camera_id: str, *options: str) -> None:
        keys = self.folder / "keys" / "cameras" / camera_id
        film = self.folder / "recording" / "videos" / f"{camera_id}.mp4"
        self.start(
            camera_id, *e3pose(
                "camera", "--site", "lab", "--name", camera_id, "--endpoint", self.endpoint,
                "--keys", str(keys), "--source", str(film), "--detector", "drawn",
                "--meter", "model", *options,
            ),
        )  # fmt: skip

    def write(self) -> None:
        super().write()
        text = self.path.read_text().replace("fps = 20.0", f"fps = {FPS}")
        self.path.write_text(text)


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Filmed]:
    folder = tmp_path_factory.mktemp("filmed")
    code = commands.run(
        "simulate", folder / "recording", "--people", "2", "--cameras", "3", "--seconds", "6",
        "--fps", "5", "--resolution", "640x480", "--seed", "702", "--videos",
    )  # fmt: skip
    assert code == 0
    made = Filmed(folder, tables=("feedback = true", "whole_every = 3"))
    with made.at_work():
        yield made


def test_cameras_look_where_the_edge_expects_people(filmed: Filmed) -> None:
    assert eventually(lambda: all(filmed.camera(name).focused > 3 for name in CAMERAS)), (
        filmed.diagnostics()
    )
    assert eventually(lambda: any(poses.track_ids.shape[0] == 2 for poses in filmed.poses))


def test_camera_that_is_started_later_is_reported_too(filmed: Filmed, tmp_path: Path) -> None:
    filmed.without("cam1")
    before = filmed.camera("cam0").focused
    filmed.whole()
    assert eventually(lambda: filmed.camera("cam1").focused > 0), filmed.diagnostics()
    assert filmed.camera("cam0").focused > before
