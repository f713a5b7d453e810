"""What `e3pose init` writes fits what was measured, and says what is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.rigs import looking, towards

from e3pose.base.errors import InputError
from e3pose.camera.probe import Probe
from e3pose.detectors.timing import DetectionTimes
from e3pose.model.camera import Rig
from e3pose.recording.calibration import save_rig
from e3pose.settings.resolved import resolve, resolve_site
from e3pose.settings.site_file import load_site
from e3pose.site.detector_speed import (
    SPARE,
    measure_detections,
    speed_problems,
    with_time_for_all,
    workloads_of,
)
from e3pose.site.edge_program import check_edge
from e3pose.site.new_site import Choice, name_sources, rates, site_name, threads_for, write_site

SLOW = DetectionTimes(np.full(4, 0.1), np.full(4, 0.4), (1.25,) * 4)  # 5 slots with 2 cameras
QUICK = DetectionTimes(np.full(4, 0.01), np.full(4, 0.01), (1.25,) * 4)


def choice(source: str, times: DetectionTimes | None, **more: object) -> Choice:
    """Return four cameras of 1000 x 800 and 30 frames per second."""
    probes = {f"c{i}": Probe(source.format(i), (1000, 800), 30.0, False) for i in range(4)}
    return Choice("lab", probes, "openpose-thin", "cpu", 1, 2, times, **more)  # type: ignore[arg-type]


@each_case(
    ("source", "times", "fps", "pace"),
    [
        ("usb:{}", SLOW, 5 * SPARE, 1.0),
        ("rtsp://cam{}/stream", SLOW, 5 * SPARE, 1.0),
        ("cam{}.mp4", SLOW, 25.0, 0.16),
        ("usb:{}", QUICK, 25.0, 1.0),
        ("cam{}.mp4", QUICK, 25.0, 1.0),
    ],
)
def test_rate_is_reached(source: str, times: DetectionTimes, fps: float, pace: float) -> None:
    assert rates(choice(source, times)) == pytest.approx((fps, pace))


@each_case("source", ["usb:{}", "cam{}.mp4"])
@each_case("times", [SLOW, QUICK])
def test_site_passes_its_own_check(tmp_path: Path, source: str, times: DetectionTimes) -> None:
    rig = looking((4, 0), (0, 4), (-4, 0), (0, -4))
    path = write_site(tmp_path / "lab", choice(source, times, rig=rig))
    site = resolve_site(path)
    check_edge(site)
    assert site.skeleton.name == "coco18" and site.loop.num_selected == 2
    found = list(speed_problems(site.file, times, 2))
    assert [finding.level for finding in found] == ["ok"], found
    kept = measure_detections(site, again=False)
    assert kept is not None and (kept.together_s == times.together_s).all()


def test_turned_camera_stays_turned_in_a_new_calibration(tmp_path: Path) -> None:
    rig = looking((4, 0), (0, 4), (-4, 0), (0, -4))
    made = choice("usb:{}", QUICK, rig=rig, rotations={"c1": 270})
    site = resolve_site(write_site(tmp_path / "lab", made))
    assert [camera.rotation for camera in site.file.camera] == [None, 270, None, None]
    sizes = [workload.image_size for workload in workloads_of(site).values()]
    assert sizes[1] == sizes[0][::-1]


def test_site_without_calibration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_site(tmp_path / "lab", choice("usb:{}", SLOW))
    site = load_site(path)
    assert f"e3pose record {tmp_path / 'lab'} walk --for 60" in path.read_text()
    with pytest.raises(InputError, match=r"calibration: found no .*e3pose record"):
        resolve(site)
    rig = resolve(site, placed=False).rig
    assert rig.camera_ids == ("c0", "c1", "c2", "c3") and not rig.placed
    monkeypatch.setattr("e3pose.site.detector_speed.time_detections", lambda _: QUICK)
    # No calibration makes the times void but one of images of another shape.
    for size, times in ((None, SLOW), ((1000, 800), SLOW), ((500, 400), SLOW), ((500, 300), QUICK)):
        if size is not None:
            rig = Rig(tuple(towards(f"c{i}", (4, i, 1), size=size) for i in range(4)))
            save_rig(rig, site.calibration)
        kept = measure_detections(resolve(site, placed=size is not None), again=False)
        assert kept is not None and (kept.together_s == times.together_s).all()
    assert all(line == line.rstrip() for line in path.read_text().split("\n"))


@pytest.mark.parametrize(("source", "fps", "pace"), [("usb:{}", 2.0, 1.0), ("c{}.mp4", 25, 0.08)])
def test_recording_takes_its_time(tmp_path: Path, source: str, fps: float, pace: float) -> None:
    site = resolve(load_site(write_site(tmp_path / "lab", choice(source, SLOW))), placed=False)
    slower = with_time_for_all(site, SLOW)
    assert (slower.file.fps, slower.file.pace) == pytest.approx((fps, pace))
    assert with_time_for_all(slower, SLOW) is slower


def test_sources_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["usb:0", "door=usb:2", "walk cam3.mp4", "rtsp://user:a=b@host/x", "left=a.mp4"]
    named = name_sources(words)
    assert named == {
        "cam1": "usb:0",
        "door": "usb:2",
        "walk_cam3": str(tmp_path / "walk cam3.mp4"),
        "cam4": "rtsp://user:a=b@host/x",
        "left": str(tmp_path / "a.mp4"),
    }


@each_case(
    ("words", "message"),
    [
        (["usb:0"], "SOURCE: found 1 source, expected two or more"),
        (["a=usb:0", "a=usb:1"], "two cameras a"),
        (["0", "1"], "found '0', expected usb:0 for /dev/video0"),
        (["/tmp/x/cam.mp4", "cam.mp4"], "two cameras cam"),
    ],
)
def test_sources_that_cannot_be_are_reported(words: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        name_sources(words)


def test_site_is_named_after_its_folder(tmp_path: Path) -> None:
    assert site_name(tmp_path / "living room") == "living-room"


@each_case(("cores", "threads"), [(2, 1), (8, 4), (1, 1)])
def test_cores_are_shared_by_the_cameras_of_a_slot(cores: int, threads: int) -> None:
    assert threads_for(4, 2, cores) == threads
