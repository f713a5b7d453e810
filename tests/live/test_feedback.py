"""Sites whose cameras detect: at the parts that the edge names, or where something moves."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest
from tests.cli import commands
from tests.live.processes import CAMERAS, LiveSite, e3pose
from tests.waiting import eventually

pytestmark = pytest.mark.nightly

FPS = 5.0  # slots per second: three cameras detect on two cores beside other programs


class Filmed(LiveSite):
    """A site whose cameras play films."""

    def source(self, camera_id: str) -> tuple[str, ...]:
        return "--source", str(self.folder / "recording" / "videos" / f"{camera_id}.mp4")

    def start_camera(self, camera_id: str, *options: str) -> None:
        keys = self.folder / "keys" / "cameras" / camera_id
        self.start(
            camera_id, *e3pose(
                "camera", "--site", "lab", "--name", camera_id, "--endpoint", self.endpoint,
                "--keys", str(keys), *self.source(camera_id), "--detector", "drawn",
                "--meter", "model", *options,
            ),
        )  # fmt: skip

    def write(self) -> None:
        super().write()
        text = self.path.read_text().replace("fps = 20.0", f"fps = {FPS}")
        self.path.write_text(text)


class Standing(Filmed):
    """A site whose cameras show one picture again and again; two of them have a gate."""

    def source(self, camera_id: str) -> tuple[str, ...]:
        shown = "--source", str(self.folder / "pictures" / camera_id), "--fps", str(2 * FPS)
        return shown if camera_id == "cam0" else (*shown, "--gate")


def film(folder: Path, seconds: int) -> None:
    code = commands.run(
        "simulate", folder / "recording", "--people", "2", "--cameras", "3", "--seconds", seconds,
        "--fps", "5", "--resolution", "640x480", "--seed", "702", "--videos",
    )  # fmt: skip
    assert code == 0


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Filmed]:
    folder = tmp_path_factory.mktemp("filmed")
    film(folder, 6)
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


@pytest.fixture(scope="module")
def standing(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Standing]:
    folder = tmp_path_factory.mktemp("standing")
    film(folder, 2)
    for camera_id in CAMERAS:
        pictures = folder / "pictures" / camera_id
        pictures.mkdir(parents=True)
        played = cv2.VideoCapture(str(folder / "recording" / "videos" / f"{camera_id}.mp4"))
        picture = played.read()[1]
        for number in range(4):
            cv2.imwrite(str(pictures / f"{number}.png"), picture)
    made = Standing(folder)
    with made.at_work():
        yield made


def test_networks_rest_and_people_who_stand_stay(standing: Standing) -> None:
    def rest(camera_id: str) -> float:
        return standing.camera(camera_id).unchanged or 0.0

    assert eventually(lambda: rest("cam1") > 0.5 and rest("cam2") > 0.5), standing.diagnostics()
    assert standing.camera("cam0").unchanged is None  # it has no gate
    assert eventually(lambda: standing.poses[-1].track_ids.shape[0] == 2), standing.diagnostics()


def test_check_says_how_often_the_image_is_unchanged(
    standing: Standing, capsys: pytest.CaptureFixture[str]
) -> None:
    assert eventually(lambda: bool(standing.camera("cam1").unchanged)), standing.diagnostics()
    commands.run("check", Path(standing.path))
    assert "image unchanged in" in " ".join(capsys.readouterr().out.split())
