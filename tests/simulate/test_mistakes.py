"""Mistakes of detectors, and lines of sight against bodies and things."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.recording import Recording
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose.simulate.body import Posture, draw_body, joints_of
from e3pose.simulate.detections import episodes, merge_people
from e3pose.simulate.hidden_joints import behind_things, covered_by_others, covered_by_self
from e3pose.simulate.occluders import Box, Occluder, Pillar

pytestmark = pytest.mark.slow

FAULTLESS = DetectorSettings(
    noise=0, joint_miss=0, self_occluded_miss=0, behind_head_miss=0, occluded_miss=0,
    person_miss=0, swap=0, merge=0, ghosts=0,
)  # fmt: skip
SIDES = {5: 6, 6: 5, 7: 8, 8: 7, 9: 10, 10: 9, 11: 12, 12: 11, 13: 14, 14: 13, 15: 16, 16: 15}


@cache
def record(detector: DetectorSettings, people: int = 1) -> Recording:
    return simulate(SceneSettings(people=people, seconds=60, cameras=4, detector=detector), 0)


def lone_person(recording: Recording) -> list[tuple[Floats, Floats, Floats]]:
    """Per view where exactly one person was seen: true pixels, keypoints and scores, stacked."""
    assert recording.truth is not None
    found = []
    for camera, series in zip(recording.rig.cameras, recording.views, strict=True):
        one = np.diff(series.starts) == 1
        first = series.starts[:-1][one]
        pixels = camera.project(recording.truth.joints_m[one, 0])
        found.append((pixels, series.keypoints_px[first], series.scores[first]))
    return found


def test_faultless_detector_sees_exactly_the_joints_inside_the_image() -> None:
    recording = record(FAULTLESS)
    for pixels, keypoints, scores in lone_person(recording):
        seen = scores > 0
        assert seen.mean() > 0.8
        assert np.abs(keypoints - pixels)[seen].max() < 1e-9


def test_swaps_exchange_left_and_right_as_often_as_asked() -> None:
    swapped, total = 0, 0
    for pixels, keypoints, scores in lone_person(record(replace(FAULTLESS, swap=0.1))):
        seen = (scores > 0).all(axis=1)
        off = np.linalg.norm(keypoints - pixels, axis=-1)[seen] > 1e-6
        mirrored = pixels[seen][:, [SIDES.get(j, j) for j in range(17)]]
        wrong = np.argwhere(off)
        assert keypoints[seen][off] == pytest.approx(mirrored[off])
        assert not np.isin(wrong[:, 1], range(5)).any()
        swapped, total = swapped + int(off.any(axis=1).sum()), total + int(seen.sum())
    assert swapped / total == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize("expected", [0.1, 1.0])
def test_ghosts_appear_as_often_as_asked_and_only_for_a_moment(expected: float) -> None:
    recording = record(replace(FAULTLESS, ghosts=expected), people=0)
    counts = np.array([len(series.scores) for series in recording.views]) / recording.num_slots
    assert counts.mean() == pytest.approx(expected, rel=0.15)
    assert np.ptp(counts) > 0  # every view has its own
    if expected == 0.1:
        there = np.diff(recording.views[0].starts) > 0
        edges = np.diff(np.concatenate([[0], there.astype(int), [0]]))
        spells = np.flatnonzero(edges < 0) - np.flatnonzero(edges > 0)
        assert spells.mean() / recording.fps == pytest.approx(0.25, abs=0.1)


def test_whole_people_are_missed_in_episodes_as_often_as_asked() -> None:
    recording = record(replace(FAULTLESS, person_miss=0.2))
    complete = record(FAULTLESS)
    missed = np.array([
        1 - len(got.scores) / len(all_.scores)
        for got, all_ in zip(recording.views, complete.views, strict=True)
    ])  # fmt: skip
    assert missed.mean() == pytest.approx(0.2, abs=0.04)
    latent = episodes(np.random.default_rng(0), (200_000,), 0.04, 0.2)
    assert latent.mean() == pytest.approx(0.2, abs=0.02)
    changes = np.abs(np.diff(latent.astype(int))).mean() / 2
    assert latent.mean() / changes * 0.04 > 0.08  # a spell lasts about a tenth of a second


def test_occluded_joints_are_missed_more_often_and_score_lower() -> None:
    detector = replace(DetectorSettings(), person_miss=0, merge=0, swap=0, ghosts=0, noise=0)
    settings = SceneSettings(scene="crossing", people=2, seconds=60, cameras=3, detector=detector)
    recording = simulate(settings, 5)
    assert recording.truth is not None
    joints = recording.truth.joints_m
    misses: dict[bool, list[bool]] = {True: [], False: []}
    scores: dict[bool, list[float]] = {True: [], False: []}
    for camera, series in zip(recording.rig.cameras, recording.views, strict=True):
        cover = covered_by_others(camera.center_m, joints)
        inside = camera.sees(joints)
        pixels = camera.project(joints)
        for slot in range(0, recording.num_slots, 5):
            view = series.view(slot)
            assert view is not None
            for person in range(2):
                if np.nanmax(cover[slot, person]) < 0.5:
                    continue
                with np.errstate(invalid="ignore"):
                    off = np.abs(view.keypoints_px - pixels[slot, person]).max(axis=-1)
                match = [i for i in range(len(view)) if np.nanmax(off[i]) < 1e-6]
                if not match:
                    continue
                for joint in np.flatnonzero(inside[slot, person]):
                    if 0 < cover[slot, person, joint] < 1:
                        continue
                    hidden = bool(cover[slot, person, joint] == 1)
                    score = float(view.scores[match[0], joint])
                    misses[hidden].append(score == 0)
                    scores[hidden] += [score] * (score > 0)
    assert min(len(m) for m in misses.values()) > 300
    assert np.mean(misses[True]) == pytest.approx(0.8, abs=0.12)
    assert np.mean(misses[False]) < 0.35  # among them joints behind the person's own body
    assert np.median(scores[True]) < np.median(scores[False]) - 0.25


def people_in_a_row() -> tuple[Floats, Floats, Floats]:
    """Two people who overlap in the image and one far away, for 2000 slots."""
    shape = np.stack([np.linspace(0, 60, 17) % 23, np.linspace(0, 200, 17)], axis=-1)
    keypoints = np.stack([shape + 100, shape + 104, shape + 600])
    all_keypoints = np.repeat(keypoints[None], 2000, axis=0)
    distance = np.broadcast_to([4.0, 3.0, 3.5], (2000, 3))
    return all_keypoints, np.full((2000, 3, 17), 0.8), distance


def test_overlapping_people_merge_as_often_as_asked_and_the_nearer_one_stays() -> None:
    keypoints, scores, distance = people_in_a_row()
    merged, new_scores = merge_people(
        keypoints, scores, distance, np.random.default_rng(0), 0.04, 0.3
    )
    gone = np.asarray(~new_scores.any(axis=-1))
    assert gone[:, 0].mean() == pytest.approx(0.3, abs=0.06)
    assert not gone[:, 1:].any()
    assert np.isnan(merged[gone]).all()
    taken = (merged[gone[:, 0], 1] == keypoints[gone[:, 0], 0]).all(axis=-1)
    assert 0 < taken.mean() < 0.6
    kept = (merged[gone[:, 0], 1] == keypoints[gone[:, 0], 1]).all(axis=-1)
    assert (kept | taken).all()
    assert (merged[~gone[:, 0]] == keypoints[~gone[:, 0]]).all()


def standing(x_m: float, y_m: float, yaw: float = 0.0) -> Floats:
    """One upright person with hanging arms: (17, 3)."""
    body = draw_body(np.random.default_rng(3))
    angles = np.array([[yaw, 0.0, 0.0]])
    left = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    hip = np.array([x_m, y_m, body.ankle_height + 0.99 * body.leg])
    ankles = np.stack([[x_m, y_m, body.ankle_height] + side * 0.1 * left for side in (1, -1)])
    arms = np.broadcast_to([0.0, 0.15, 0.2, 0.3], (1, 2, 4))
    joints: Floats = joints_of(
        body, Posture(hip[None], angles, angles, angles, angles[:, 0], ankles[None], arms)
    )[0]
    return joints


CAMERA = np.array([5.0, 0.0, 1.3])


def test_person_behind_another_is_covered_and_nobody_else() -> None:
    here, nobody = standing(0.0, 0.0), np.full((17, 3), np.nan)
    cover = covered_by_others(CAMERA, np.stack([here, standing(1.5, 0.0)])[None])[0]
    assert (cover[0] > 0.5).sum() >= 9
    assert cover[1].max() == 0
    for beside in (standing(1.5, 1.5), nobody):
        assert covered_by_others(CAMERA, np.stack([here, beside])[None]).max() == 0
    assert covered_by_self(CAMERA, np.stack([here, nobody])[None])[0, 1].max() == 0


def test_face_hides_from_behind_and_the_far_arm_in_profile() -> None:
    facing, away = standing(0.0, 0.0, 0.0), standing(0.0, 0.0, np.pi)
    profile = standing(0.0, 0.0, np.pi / 2)  # the right arm is towards the camera
    cover = covered_by_self(CAMERA, np.stack([facing, away, profile])[None])[0]
    assert cover[0, :3].max() == 0
    assert cover[1, :3].min() > 0.5
    assert cover[2, [5, 7]].min() > 0.5
    assert cover[2, [6, 8]].max() == 0


PILLAR = Pillar(1.0, 0.0, 0.2, 2.0)
BOX = Box(1.0, 0.0, 0.4, 2.0, 1.0)


@each_case(
    ("thing", "start", "end", "expected"),
    [
        (PILLAR, (3, 0, 1), (0, 0, 1), True),
        (PILLAR, (3, 0.21, 1), (0, 0.21, 1), False),
        (PILLAR, (3, 0.19, 1), (0, 0.19, 1), True),
        (PILLAR, (3, 0, 2.1), (0, 0, 2.1), False),  # over the top
        (PILLAR, (3, 0, 3.0), (0, 0, 0.5), True),  # down through the side
        (PILLAR, (3, 0, 1), (1.3, 0, 1), False),  # stops before it
        (PILLAR, (1, 0, 3), (1, 0, 1), True),  # straight down into it
        (BOX, (3, 0, 0.5), (0, 0, 0.5), True),
        (BOX, (3, 0.9, 0.5), (0, 0.9, 0.5), True),
        (BOX, (3, 1.1, 0.5), (0, 1.1, 0.5), False),
        (BOX, (3, 0, 1.1), (0, 0, 1.1), False),
        (BOX, (3, 0, 2.0), (0, 0, 0.0), True),  # at x = 1.2 it is 0.8 m high
        (Box(1.0, 0.0, 0.4, 2.0, 1.0, yaw=np.pi / 2), (3, 0.3, 0.5), (0, 0.3, 0.5), False),
    ],
)
def test_line_of_sight(
    thing: Occluder,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    expected: bool,
) -> None:
    assert bool(thing.blocks(np.array(start), np.array(end))) is expected


def test_nearest_point_of_a_footprint() -> None:
    assert PILLAR.nearest(np.array([3.0, 0.0])) == pytest.approx([1.2, 0.0])
    assert BOX.nearest(np.array([3.0, 0.5])) == pytest.approx([1.2, 0.5])
    assert BOX.nearest(np.array([1.0, 5.0])) == pytest.approx([1.0, 1.0])


def test_things_hide_people_behind_them_only() -> None:
    people = np.stack([standing(0.0, 0.0), standing(3.0, 0.0)])[None]
    wall = Box(1.5, 0.0, 0.1, 3.0, 2.5)
    hidden = behind_things(CAMERA, people, [wall])[0]
    assert hidden[0].all() and not hidden[1].any()
    assert not behind_things(CAMERA, people, []).any()
