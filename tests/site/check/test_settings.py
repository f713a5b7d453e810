"""What `e3pose check` says of settings that cannot work together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.rigs import looking
from tests.site.tables import resolved_site

from e3pose.base.errors import InputError
from e3pose.detectors.timing import DetectionTimes
from e3pose.model.camera import Rig
from e3pose.recording.calibration import save_rig
from e3pose.settings.resolved import ResolvedSite, resolve
from e3pose.settings.site_file import SiteTable
from e3pose.site.check.finding import Finding, report
from e3pose.site.check.parts import (
    budget_problems,
    event_problems,
    feedback_problems,
    rig_problems,
    skeleton_problems,
    watt_problems,
)
from e3pose.site.detector_speed import (
    SPARE,
    speed_problems,
    suggested_deadline_ms,
    suggested_fps,
)

FOUR = looking((4, 0), (0, 4), (-4, 0), (0, -4))


def live(folder: Path, more: str = "") -> ResolvedSite:
    return resolved_site(folder, FOUR, more)


def cameras(*detectors: str, **keys: str) -> str:
    more = "".join(f'{key} = "{value}"\n' for key, value in keys.items())
    return "".join(
        f'[[camera]]\nid = "c{i}"\nsource = "cam{i}.mp4"\ndetector = "{name}"\n{more}'
        for i, name in enumerate(detectors)
    )


WHOLE = """
class Whole:
    def detect(self, image): ...

class Parts(Whole):
    def detect_part(self, image, part, expected=None): ...
"""


def test_a_camera_without_a_place_is_named(tmp_path: Path) -> None:
    site = live(tmp_path)
    lost = FOUR.camera_ids[3]
    save_rig(Rig(FOUR.cameras, unplaced=(lost,)), site.file.calibration)
    with pytest.raises(InputError, match=f"no place of {lost} in "):
        resolve(site.file)
    (found,) = rig_problems(resolve(site.file, placed=False))
    assert found.level == "problem" and found.found.endswith(f"has no place of {lost}")


def test_events_that_nobody_keeps_are_named(tmp_path: Path) -> None:
    site = live(tmp_path, "[events]\n")
    (found,) = event_problems(site)
    assert (found.level, found.what, found.advice) == (
        "warning",
        "events",
        '[store] path = "poses.db"',
    )
    assert not list(event_problems(live(tmp_path, '[events]\n[store]\npath = "poses.db"\n')))
    assert not list(event_problems(live(tmp_path)))


def test_cameras_that_ignore_feedback_are_named(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(WHOLE)
    own = f"{tmp_path}/own.py"
    names = (f"{own}:Whole", f"{own}:Parts", "rtmpose")
    site = live(tmp_path, "[loop]\nfeedback = true\n" + cameras(*names))
    (found,) = feedback_problems(site)
    assert (found.level, found.what) == ("warning", "camera c0")
    why = f"{names[0]} has neither detect_part nor detect_in_boxes"
    assert found.found == f"ignores feedback: {why}"
    films = cameras("").replace("cam0.mp4", "recorded:walk")
    (found,) = feedback_problems(live(tmp_path, "[loop]\nfeedback = true\n" + films))
    assert "keypoints, no images" in found.found
    assert not list(feedback_problems(live(tmp_path, films)))


@each_case(
    ("detectors", "skeleton"),
    [
        (("openpose-thin",) * 4, "coco18"),
        (("movenet-multipose",) * 4, "coco17"),
        (("openpose-thin", "movenet-multipose"), "coco17"),
        ((), "coco17"),
    ],
)
def test_skeleton_follows_from_the_detectors(
    tmp_path: Path, detectors: tuple[str, ...], skeleton: str
) -> None:
    site = live(tmp_path, cameras(*detectors))
    assert site.skeleton.name == skeleton
    assert not list(skeleton_problems(site))


def test_detector_of_another_skeleton_is_reported_with_what_it_lacks(tmp_path: Path) -> None:
    site = live(tmp_path, 'skeleton = "body25"\n' + cameras("openpose-thin", "movenet-multipose"))
    found = {finding.what: finding for finding in skeleton_problems(site)}
    assert found["camera c0"].level == "warning"
    assert "outputs coco18, converted, without left_big_toe" in found["camera c0"].found


OWN_DETECTOR = """
from e3pose.model.skeleton import SKELETONS

class Whole:
    def __init__(self):
        self.skeleton = SKELETONS["coco133"]

    def detect(self, image):
        raise AssertionError
"""


@each_case(
    ("asked", "skeleton", "said"),
    [
        ("", "coco133", ""),
        ('skeleton = "coco17"', "coco17", "116 of 133 joints not used: left_big_toe"),
        ('skeleton = "halpe26"', "halpe26", "110 of 133 joints not used: face_0"),
    ],
)
def test_joints_of_an_own_detector_are_stored_or_said_to_be_lost(
    tmp_path: Path, asked: str, skeleton: str, said: str
) -> None:
    (tmp_path / "whole.py").write_text(OWN_DETECTOR)
    own = f"{tmp_path / 'whole.py'}:Whole"
    site = live(tmp_path, f"{asked}\n" + cameras(own, own))
    assert site.skeleton.name == skeleton
    found = " ".join(finding.found for finding in skeleton_problems(site))
    assert said in found and bool(said) == bool(found)


@each_case(
    ("budget", "level", "message"),
    [
        ("1W", "problem", "does not even pay for idling"),
        ("0.01J", "problem", "it draws 6.2 W idle and 12 W active (profile xavier-nx)"),
        ("6W", "problem", 'above 6.2 W, or idle_mode = "aggressive-power-saving"'),
        ("10W", "ok", "pays for 2.4 cameras per slot"),
        ("30%", "warning", "pays for 1.2 cameras per slot, the site asks for 2"),
    ],
)
def test_budget_is_compared_with_draws(
    tmp_path: Path, budget: str, level: str, message: str
) -> None:
    assert not list(budget_problems(live(tmp_path)))
    found = list(budget_problems(live(tmp_path, f'budget = "{budget}"\n')))
    assert {finding.level for finding in found} == {level}
    assert message in f"{found[0].found} {found[0].advice}"


def test_watts_are_compared_with_what_cameras_draw_asleep(tmp_path: Path) -> None:
    def found(watts: str, folder: str) -> list[Finding]:
        return list(watt_problems(live(tmp_path / folder, f'[loop]\nrest = "asleep"\n{watts}')))

    (least,) = found('watts = "20W"', "little")
    assert (least.level, least.what) == ("problem", "watts")
    assert least.found == "20 W, but the cameras draw 21.1 W when all of them are asleep"
    assert found('watts = "22W"', "enough") == found("cameras = 2", "count") == []


def looked(fps: float, deadline_ms: float, selected: float = 2) -> dict[str, Finding]:
    """Return what is found of a site on a machine of 100 ms per look, 200 ms for four at once."""
    return {
        finding.what: finding for finding in speed_problems(site(fps, deadline_ms), SLOW, selected)
    }


def site(fps: float, deadline_ms: float) -> SiteTable:
    return SiteTable(
        "e3pose-site", 1, name="lab", calibration=Path("rig.toml"), fps=fps, deadline_ms=deadline_ms
    )


SLOW = DetectionTimes(np.full(4, 0.1), np.full(4, 0.2))  # 20 per second: 10 slots with 2 cameras


@each_case(
    ("fps", "deadline_ms", "what", "level"),
    [
        (7.9, 150, "fps", ""),
        (9, 150, "fps", "warning"),
        (25, 150, "fps", "problem"),
        (5, 90, "deadline_ms", "problem"),
        (5, 130, "deadline_ms", "warning"),
        (5, 150, "deadline_ms", ""),
    ],
)
def test_rate_and_deadline_are_compared_with_what_looks_take(
    fps: float, deadline_ms: float, what: str, level: str
) -> None:
    found = looked(fps, deadline_ms)
    assert found["network"].found == "100 ms per detection, 200 ms with all cameras"
    assert (found[what].level if what in found else "") == level


def test_finding_says_what_the_machine_manages_and_what_to_write() -> None:
    found = looked(25, 90)
    assert "manages 20 detections per second, 10 slots with 2 cameras each" in found["fps"].found
    assert "the site asks for 25 slots per second" in found["fps"].found
    assert found["fps"].advice.startswith("fps = 8,")
    assert "a detection takes 100 ms" in found["deadline_ms"].found
    mended = looked(suggested_fps(SLOW, 2), suggested_deadline_ms(SLOW))
    slower = speed_problems(replace(site(25, 500), pace=0.3), SLOW, 2)
    assert set(mended) == {one.what for one in slower} == {"network"}


def test_site_is_refused_only_where_it_could_not_work() -> None:
    said: list[str] = []
    with pytest.raises(InputError, match=r"site.toml: deadline_ms: 90 ms, but .* deadline_ms = "):
        report(speed_problems(site(25, 90), SLOW, 2), said.append, "site.toml")
    report(speed_problems(site(11, 130), SLOW, 2), said.append, "site.toml")
    assert [line.split(":")[0] for line in said] == ["deadline_ms", "fps"]


def test_one_camera_cannot_look_faster_than_alone() -> None:
    many_cores = DetectionTimes(np.full(4, 0.1), np.full(4, 0.1))
    assert many_cores.rate == pytest.approx(40)
    assert many_cores.reach_fps(2) == pytest.approx(10)
    assert suggested_fps(many_cores, 2) == pytest.approx(10 * SPARE)
    (fps,) = (f for f in speed_problems(site(12.5, 500), many_cores, 2) if f.what == "fps")
    assert "manages 10 slots per second, as a detection takes 100 ms; the site asks for 12.5" in (
        fps.found
    )
