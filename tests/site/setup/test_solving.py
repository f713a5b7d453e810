"""Clicks on the floor, words for errors, and pictures that no honest camera sends."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.rigs import looking

from e3pose.base.errors import InputError
from e3pose.calibrate.expected_error import ErrorMap
from e3pose.calibrate.judge import Judgement
from e3pose.calibrate.uncertainty import CameraErrors
from e3pose.detectors.timing import DetectionTimes
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.site.setup import networks
from e3pose.site.setup.session import SetupSession
from e3pose.site.setup.solving import floor_at, grade, move_world, result, verdict
from e3pose.site.setup.walking import Snapshots, newest_view
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import Picture

RIG = looking((4, 0), (0, 4), (-4, 0))
WAIT_S = 30.0


def test_a_click_finds_the_place_on_the_floor_that_it_shows() -> None:
    for place in ((0.5, -0.3), (-1.0, 1.2)):
        for camera in RIG.cameras:
            x, y = camera.project(np.array([[*place, 0.0]]))[0].tolist()
            assert floor_at(RIG, camera.camera_id, (x, y)) == pytest.approx(place, abs=1e-6)
    for name, click, said in (
        ("c0", (500, 5), "one on the floor"),
        ("c0", (5000, 5), "a place in the picture"),
        ("c9", (500, 700), "c9"),
    ):
        with pytest.raises(InputError, match=said):
            floor_at(RIG, name, click)


def test_clicks_set_the_origin_and_the_axis(tmp_path: Path) -> None:
    (tmp_path / "lab").mkdir()
    setup = SetupSession(tmp_path, "lab")
    save_rig(RIG, setup.folder / "rig.toml")
    seen = RIG.cameras[0].project(np.array([[1.0, 1.0, 0.0]]))[0].tolist()
    command = move_world(setup, "c0", seen[0], seen[1], "origin")
    assert command == "e3pose calibrate align lab/rig.toml lab/rig.toml --origin=1.000,1.000"
    moved = load_rig(setup.folder / "rig.toml")
    assert moved.centers_m == pytest.approx(RIG.centers_m - [1, 1, 0], abs=2e-3)
    seen = moved.cameras[0].project(np.array([[-1.0, -1.0, 0.0]]))[0].tolist()
    assert "--x-axis=-1.000,-1.000" in move_world(setup, "c0", seen[0], seen[1], "x-axis")
    turned = load_rig(setup.folder / "rig.toml")
    middle = turned.cameras[0].project(np.array([[np.sqrt(2), 0.0, 0.0]]))[0]
    assert middle == pytest.approx(seen, abs=1.0), "it lies on the x axis now"


def test_grades_and_verdicts_are_words() -> None:
    assert [grade(mm) for mm in (10.0, 60.0, 200.0, np.nan)] == ["good", "fair", "poor", "unknown"]
    assert verdict(np.nan, np.nan, []) == "No place of the floor was seen by two cameras at once."
    assert verdict(18.0, 90.0, [0.8, 0.1, 0.1]).startswith(
        "Good: a joint is expected to be 18 mm off in the median over the floor, 90 mm at the worst"
    )
    times = DetectionTimes(np.full(4, 0.25), np.full(4, 1 / 3))
    assert networks.speed_words(times, 4) == (
        "12 poses a second here with four cameras: 4 moments a second, two cameras each"
    )


def test_a_judgement_has_a_map_with_what_is_unknown_as_nothing() -> None:
    nothing = CameraErrors(*(np.full(3, np.nan) for _ in range(7)))
    room = ErrorMap(
        np.array([0.0, 0.2]), np.array([0.0, 0.2]),
        np.array([[30.0, np.nan], [60.0, 100.0]]), np.zeros((2, 2)), np.full((2, 2), 3),
    )  # fmt: skip
    judged = Judgement(
        np.array([1.0, 2.0, np.nan]), np.zeros((3, 2)), np.ones(3), np.ones(3, dtype=np.int64),
        nothing, np.full((3, 3), 1.5), np.ones((3, 3)), room, ["walk more"],
    )  # fmt: skip
    found = result(RIG, judged)
    assert found["map_mm"] == [[30.0, None], [60.0, 100.0]] and found["grade"] == "fair"
    assert "33 % of the floor is green" in found["verdict"] and found["next"] == ["walk more"]
    assert found["cameras"][2]["words"] == "saw no person that others saw"


def test_a_download_tells_how_far_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = list[tuple[str, int, int]]()

    def pull(name: str, progress: object) -> None:
        assert callable(progress)
        progress(1000, None)
        told.append((task.stage, task.done, task.total))
        progress(2000, 4000)
        told.append((task.stage, task.done, task.total))

    setup = SetupSession(tmp_path)
    monkeypatch.setattr(networks, "pull_weights", pull)
    start = setup.start
    monkeypatch.setattr(setup, "start", lambda made, work: start(made, lambda _: work(task)))
    from e3pose.site.setup.tasks import Task

    task = Task("pull", "")
    networks.start_pulling(setup, "openpose-thin")
    setup.tasks.wait(WAIT_S)
    words = "downloading openpose-thin"
    assert told == [(words, 1000, 0), (words, 2000, 4000)]
    assert setup.tasks.newest is not None
    assert setup.tasks.newest.command == "e3pose models pull openpose-thin"
    with pytest.raises(InputError, match="one that can be downloaded"):
        networks.start_pulling(setup, "../../etc")


def test_pictures_that_no_honest_camera_sends_are_left_out() -> None:
    coded = cv2.imencode(".jpg", np.zeros((24, 32, 3), dtype=np.uint8))[1].tobytes()
    taken = Snapshots()
    for answer in (b"nonsense", encode(Picture("c1", 1, (32, 24), coded)),
                   encode(Picture("c0", 1, (32, 24), b"no jpeg"))):  # fmt: skip
        taken._keep("c0", answer)
    assert taken.newest("c0") is None
    assert newest_view(None, taken, "c0")["why"] == "no picture yet"
    taken._keep("c0", encode(Picture("c0", 7, (32, 24), coded)))
    found = taken.newest("c0")
    assert found is not None and found.slot == 7
    assert newest_view(None, taken, "c0")["size"] == (32, 24)
