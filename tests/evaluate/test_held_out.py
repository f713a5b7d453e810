"""Judging by held-out cameras: known distances, pairs, what counts and what is refused."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case
from tests.cli.commands import run
from tests.cli.one_person import one_person

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.cli import replaying
from e3pose.evaluate.figures import HeldOut, HeldOutCamera
from e3pose.evaluate.held_out import SURE_SCORE, doubts_of, joined, judge, turns
from e3pose.model.people import People
from e3pose.recording import Recording, save_recording
from e3pose.recording.record import of_cameras

NUM_SLOTS = 25
SCENE = one_person([0.2, 1.7, 3.4, 4.9], NUM_SLOTS)
LIMBS = [5, 6, 7, 8, 9, 10, 11, 12, 13, 14]  # COCO-17: shoulders, elbows, wrists, hips, knees
UP = np.array([0, 0, 0.05])


def truth() -> Floats:
    assert SCENE.truth is not None
    return SCENE.truth.joints_m


def records(people: Iterable[Floats]) -> list[Any]:
    """Records of slots 0, 1 and so on, with `(num_poses, 17, 3)` metres each."""
    return [
        SimpleNamespace(slot=slot, people=People(np.arange(len(each)), each))
        for slot, each in enumerate(people)
    ]


def only(camera: str, scene: Recording = SCENE) -> Recording:
    return of_cameras(scene, [camera])


def with_series(camera: int, **changed: Any) -> Recording:
    views = list(SCENE.views)
    views[camera] = replace(views[camera], **changed)
    return replace(SCENE, views=tuple(views))


def test_distance_in_the_image_and_across_the_ray() -> None:
    found = judge(only("c1"), records([people + UP for people in truth()])).cameras["c1"]
    camera = SCENE.rig.cameras[1]
    moved, still = truth()[:, 0] + UP, truth()[:, 0]
    off_px = np.linalg.norm(camera.project(moved) - camera.project(still), axis=-1)
    off_mm = 1000 * off_px * (moved @ camera.R[2] + camera.t[2]) / 900
    assert found.mean_px == pytest.approx(off_px[:, LIMBS].mean())
    assert found.median_px == pytest.approx(np.median(off_px[:, LIMBS]))
    assert found.mean_mm == pytest.approx(off_mm[:, LIMBS].mean())
    assert found.median_mm == pytest.approx(np.median(off_mm[:, LIMBS]))
    assert 47 < off_mm.mean() <= 50  # seen nearly from the side
    assert found.joints["nose"].mean_px == pytest.approx(off_px[:, 0].mean())
    assert (found.keypoints, found.people, found.poses) == (NUM_SLOTS * 10, NUM_SLOTS, NUM_SLOTS)
    assert (found.missed_percent, found.unseen_percent) == (0, 0)


@each_case(
    ("turned_by", "moved_m", "wrong"),
    [(0, 0, 0), (25, 0, 0), (35, 0, 100), (0, 0.14, 0), (0, 0.16, 100)],
)
def test_wrong_limbs_in_an_image(turned_by: float, moved_m: float, wrong: float) -> None:
    """A forearm that is turned in the plane of the image, or moved along it."""
    camera, people = SCENE.rig.cameras[1], truth()[:1].copy()
    elbow, wrist = (SCENE.skeleton.index(f"left_{name}") for name in ("elbow", "wrist"))
    up, aside = -camera.R[1], camera.R[0]
    people[0, 0, wrist] = people[0, 0, elbow] + 0.25 * up
    seen_px = camera.project(people[0, 0])
    series = replace(
        SCENE.views[1],
        slots=SCENE.views[1].slots[:1],
        times_s=SCENE.views[1].times_s[:1],
        starts=np.array([0, 1]),
        keypoints_px=seen_px[None],
        scores=np.ones((1, 17)),
    )
    angle = np.radians(turned_by)
    people[0, 0, wrist] = people[0, 0, elbow] + 0.25 * (np.cos(angle) * up + np.sin(angle) * aside)
    people[0, 0, [elbow, wrist]] += moved_m * aside
    views = (SCENE.views[0], series, *SCENE.views[2:])
    found = judge(only("c1", replace(SCENE, views=views)), records([people[0]])).mean
    assert found.joints["left_wrist"].wrong_limbs_percent == wrong
    assert found.joints["right_wrist"].wrong_limbs_percent == 0
    assert found.joints["left_shoulder"].wrong_limbs_percent is None
    assert (found.limbs, found.joints["left_ankle"].limbs) == (6, 1)


def test_people_without_a_partner_are_counted() -> None:
    aside, nobody = truth()[0] + [0, 0, 0.9], np.zeros((0, 17, 3))
    slots = [truth()[0], nobody, aside, np.concatenate([truth()[3], aside])]
    found = judge(only("c0"), records(slots)).mean
    assert (found.people, found.missed_percent, found.poses, found.unseen_percent) == (4, 50, 4, 50)
    assert found.mean_mm == pytest.approx(0, abs=1e-9)
    # Pairs are one to one, with the least total.
    two = np.concatenate([truth()[0] + [0, 0, 0.1], truth()[0]])
    found = judge(only("c0"), records([two])).mean
    assert found.mean_mm == pytest.approx(0, abs=1e-9) and found.unseen_percent == 50
    # Behind the camera or beside the image nobody is unseen.
    away = [truth()[0] + shift for shift in ([0, 0, 30.0], [60.0, 20, 0])]
    found = judge(only("c0"), records(away)).mean
    assert (found.poses, found.unseen_percent, found.missed_percent) == (0, None, 100)


def test_keypoints_with_low_scores_do_not_count() -> None:
    scores = SCENE.views[0].scores.copy()
    scores[:, [9, 10]] = SURE_SCORE
    wild = SCENE.views[0].keypoints_px.copy()
    wild[:, [9, 10]] += 300
    found = judge(
        only("c0", with_series(0, scores=scores, keypoints_px=wild)), records(truth())
    ).mean
    assert found.keypoints == NUM_SLOTS * 8
    assert found.mean_px == pytest.approx(0, abs=1e-9)
    assert found.joints["left_wrist"].mean_px is None


def test_a_lost_view_and_slots_that_are_not_scored_judge_nobody() -> None:
    series, names = SCENE.views[0], ("slots", "times_s", "keypoints_px", "scores")
    first = {name: getattr(series, name)[:3] for name in names}
    lost = only("c0", with_series(0, starts=series.starts[:4], **first))
    assert judge(lost, records(truth())).mean.poses == 3
    scored = only("c0", replace(SCENE, scored_slots=(5, 9)))
    assert judge(scored, records(truth())).mean.people == 4


def test_mean_of_cameras_sums_counts() -> None:
    off = [people + UP for people in truth()]
    found = joined([judge(only(c), records(off)) for c in ("c0", "c1")] + [None])
    assert found is not None
    assert list(found.cameras) == ["c0", "c1"]
    each: Any = [found.cameras[c].mean_mm for c in ("c0", "c1")]
    assert found.mean.mean_mm == pytest.approx(np.mean(each))
    nose: Any = [found.cameras[c].joints["nose"].mean_mm for c in ("c0", "c1")]
    assert found.mean.joints["nose"].mean_mm == pytest.approx(np.mean(nose))
    assert found.mean.keypoints == 2 * NUM_SLOTS * 10
    assert joined([None]) is None


@each_case(
    ("scene", "cameras", "expected"),
    [
        (SCENE, ["c9"], "one of c0, c1, c2, c3, or each"),
        (SCENE, ["each", "c1"], "each alone"),
        (SCENE, ["c0", "c1", "c2"], "at least 2 cameras that are left"),
        (of_cameras(SCENE, ["c0", "c1"]), ["each"], "2 cameras that are left"),
        (with_series(2, scores=np.zeros_like(SCENE.views[2].scores)), ["c2"], "c2"),
    ],
)
def test_what_cannot_be_held_out_is_refused(
    scene: Recording, cameras: list[str], expected: str
) -> None:
    with pytest.raises(InputError, match=expected):
        turns(scene, cameras)


def test_each_takes_cameras_in_turn() -> None:
    (whole, nobody), *others = turns(SCENE, ["each"])
    assert whole is SCENE and nobody is None
    assert others[1][0].rig.camera_ids == ("c0", "c2", "c3")
    judges = [by.rig.camera_ids for _, by in others if by is not None]
    assert judges == [(f"c{n}",) for n in range(4)]


def replayed(
    scene: Recording, folder: Path, *options: object, verb: str = "replay"
) -> dict[str, Any]:
    if not (folder / "recording").exists():
        save_recording(scene, folder / "recording")
    figures = folder / "figures.json"
    words = ("-C", 2, "--pipeline", "paper", "--json", figures, *options)
    assert run(verb, folder / "recording", *words) == 0
    return dict(json.loads(figures.read_text()))


def test_a_held_out_camera_gives_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its keypoints may say anything: the poses stay, to the last digit; its judgement follows."""
    found = []
    for name, shift_px in (("as it is", 0), ("lying", 40)):
        folder = tmp_path / name
        folder.mkdir()
        scene = with_series(1, keypoints_px=SCENE.views[1].keypoints_px + shift_px)
        poses = folder / "poses.csv"
        figures = replayed(scene, folder, "--hold-out", "c1", "--poses", poses)
        assert list(figures["selection"]["duty"]) == ["c0", "c2", "c3"]
        found.append((figures["held_out"]["cameras"]["c1"], poses.read_text()))
    (honest, first), (lying, second) = found
    assert first == second
    assert honest["mean_px"] < 1
    assert lying["mean_px"] == pytest.approx(40 * 2**0.5, abs=1)
    assert "cameras that took no part" in capsys.readouterr().out


def test_each_of_replay_and_evaluate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The figures of the rig are those without a judge; each camera judges the others."""
    single = replayed(SCENE, tmp_path, "--hold-out", "c2", "--phase", 1, "--seed", 1)
    each = replayed(SCENE, tmp_path, "--hold-out", "each", "--phase", 1, "--seed", 1)
    plain = replayed(SCENE, tmp_path, "--phase", 1, "--seed", 1)
    assert list(each["held_out"]["cameras"]) == ["c0", "c1", "c2", "c3"]
    assert each["held_out"]["cameras"]["c2"] == single["held_out"]["cameras"]["c2"]
    assert "held_out" not in plain
    assert each["metrics"] == plain["metrics"]
    options = ("--policies", "e3pose", "--hold-out", "each", "--seeds", 1, "--jobs", 1)
    one = ("--phase", 1, "--seed", 1)
    (row,) = replayed(SCENE, tmp_path, *options, *one, verb="evaluate")["rows"]
    assert row["held_out"]["mean"]["median_mm"]["mean"] == pytest.approx(
        each["held_out"]["mean"]["median_mm"]
    )
    assert "held-out mm" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("mm", "missed", "cameras", "doubts"),
    [
        ((30.0, 40.0, 50.0), 5.0, 3, []),
        ((90.0, 95.0, 100.0), 5.0, 3, ["Joints are 95 mm off"]),
        ((30.0, 30.0, 90.0), 5.0, 3, ["Camera c2 disagrees with the others (90 mm"]),
        ((10.0, 10.0, 30.0), 5.0, 3, []),
        ((30.0, 40.0, 50.0), 45.0, 3, ["45 % of the people"]),
        ((None, None), 5.0, 3, ["No camera that took no part sees the people"]),
        ((), 5.0, 2, ["Two cameras: none is left to judge"]),
        ((), 5.0, 4, []),
    ],
)
def test_what_nobody_should_trust_is_said(
    mm: tuple[float | None, ...], missed: float, cameras: int, doubts: list[str]
) -> None:
    each = {
        f"c{n}": HeldOutCamera(median_mm=one, missed_percent=missed) for n, one in enumerate(mm)
    }
    known = [one for one in mm if one is not None]
    mean = HeldOutCamera(median_mm=fmean(known) if known else None, missed_percent=missed)
    own = HeldOut(each or {f"c{n}": HeldOutCamera() for n in range(cameras)}, HeldOutCamera())
    said = doubts_of(HeldOut(each, mean) if mm else None, own)
    assert len(said) == len(doubts)
    assert all(one.startswith(begin) for one, begin in zip(said, doubts, strict=True))


def test_a_replay_that_fails_ends_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, ended = threading.Event(), list[object]()

    class Long:
        source, read_view, slots = SCENE, None, records(truth())[:1] * 500_000
        smoother = SimpleNamespace(words=None)

        def records(self, slots: Iterable[Any], step: Any) -> list[Any]:
            begun.set()
            for record in slots:
                step(record)
            ended.append(self)
            return []

    class Broken(Long):
        def records(self, slots: Iterable[Any], step: Any) -> list[Any]:
            begun.wait()
            raise InputError("slot", "nothing", "a view")

    monkeypatch.setattr(replaying, "num_cores", lambda: 2)
    for first, second in ((Broken(), Long()), (Long(), Broken())):
        begun.clear()
        with pytest.raises(InputError, match="slot: found nothing"):
            replaying._judged([(first, only("c0")), (second, only("c1"))])  # type: ignore[list-item]
        assert not ended


def test_only_the_camera_that_was_moved_is_named() -> None:
    """It pulls the poses that judge the others; where all make the poses, it alone does not fit."""
    series = SCENE.views[1]
    moved = with_series(1, keypoints_px=series.keypoints_px + [30.0, -4.0])
    c1 = judge(only("c1", moved), records(truth())).cameras["c1"]
    assert c1.shift_px == pytest.approx((30.0, -4.0), abs=0.01)
    late = with_series(1, keypoints_px=series.keypoints_px * [-1, 1] + [1280.0, 0.0])
    unlike = judge(only("c1", late), records(truth())).cameras["c1"]

    def said(c1: HeldOutCamera, *mm: float) -> list[str]:
        each = {"c1": c1} | {f"d{n}": HeldOutCamera(median_mm=one) for n, one in enumerate(mm)}
        own = {"c1": c1} | {f"d{n}": HeldOutCamera(median_mm=20.0) for n in range(len(mm))}
        return doubts_of(HeldOut(each, HeldOutCamera(median_mm=60.0)), HeldOut(own, c1))

    pulled = replace(c1, median_mm=87.0)
    (one,) = said(pulled, 33.0, 73.0, 29.0)
    assert one.startswith("Camera c1 disagrees with the others (87 mm, the others 33): all its")
    assert "off by (+30, -4) px" in one and "--only c1" in one
    (one,) = said(replace(unlike, median_mm=87.0), 33.0, 73.0, 29.0)
    assert "check when its film began" in one
    (one,) = said(replace(pulled, median_mm=30.0), 29.0, 90.0, 31.0)
    assert one.startswith("One of the cameras disagrees with the others (90 mm, the others 30)")
    assert "c1" not in one and "d1" not in one, "d1 fits the others"
