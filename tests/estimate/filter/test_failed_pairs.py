"""Detections that never become a person stop asking for cameras; people do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.estimate.filter.room import ALL, MODEL, NUM_CAMERAS, RIG, Views, run, see, standing

from e3pose.estimate.filter import Belief, outlook
from e3pose.estimate.filter.failed_pairs import FADES_S, MOST, SEVERAL
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.overlap import overlap
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording, ViewSeries

pytestmark = pytest.mark.slow

FPS = 10.0
POSTER = see(standing((0.0, 0.0)), [2])[2].keypoints_px[0] * 0.4 + (30.0, 60.0)


def with_poster(views: Views, camera: int = 0) -> dict[int, Poses2D]:
    """Return views in which a camera sees somebody who is not there."""
    if camera not in views:
        return dict(views)
    view = views[camera]
    keypoints = np.concatenate([view.keypoints_px, POSTER[None]])
    scores = np.concatenate([view.scores, np.full((1, len(POSTER)), 0.8)])
    return {**views, camera: Poses2D(keypoints, scores)}


def waiting(belief: Belief) -> list[int]:
    return [int(count) for count in outlook(MODEL, belief, 1 / FPS).unexplained]


def slots_until_left_out(cameras: tuple[int, ...]) -> int:
    belief = Belief.empty(MODEL)
    for slot in range(100):
        belief, _ = run([with_poster(see(standing(), cameras))], FPS, belief=belief)
        if not any(waiting(belief)):
            return slot
    return 100


def test_a_poster_is_left_out_after_a_few_looks_of_cameras_that_overlap() -> None:
    met = overlap(RIG)[0, 1]
    assert slots_until_left_out((0, 1)) == pytest.approx(SEVERAL / met, abs=1.5)
    assert 1 < slots_until_left_out(ALL) < slots_until_left_out((0, 1))


def test_a_camera_alone_proves_nothing() -> None:
    assert slots_until_left_out((0,)) == 100


def test_the_place_is_tried_again_after_a_while() -> None:
    belief, _ = run([with_poster(see(standing()))] * 200, FPS)
    assert belief.failed_pairs.max() == pytest.approx(MOST, rel=0.01)
    assert waiting(belief) == [0] * NUM_CAMERAS
    for _ in range(round(FADES_S * np.log(MOST / SEVERAL)) + 1):  # nobody else looks
        belief, _ = run([with_poster(see(standing(), [0]))], 1.0, belief=belief)
    assert waiting(belief)[0] == 1
    belief, _ = run([with_poster(see(standing()))] * 2, FPS, belief=belief)
    assert waiting(belief) == [0] * NUM_CAMERAS


def test_somebody_at_another_place_counts_at_once() -> None:
    belief, _ = run([with_poster(see(standing()))] * 30, FPS)
    assert waiting(belief)[0] == 0
    belief, _ = run([with_poster(see(standing((0.0, 0.0)), [0]))], FPS, belief=belief)
    assert waiting(belief)[0] == 1


def test_somebody_at_the_place_is_started_at_once_and_empties_it() -> None:
    body = see(standing((0.0, 0.0)), [0, 1])
    empty = Belief.empty(MODEL)
    full = replace(empty, failed_pairs=np.full_like(empty.failed_pairs, MOST))
    after, _ = run([body], FPS, belief=full)
    assert len(after) == 1
    assert (after.failed_pairs[[0, 1]] == 0).sum() == 2
    assert (after.failed_pairs[2:] > 0).all()


PUT_UP, COMES_IN, END = 30, 120, 160  # slots


def recording(poster: bool) -> Recording:
    """Return somebody who stands about, and another one who comes in; a poster is put up before."""
    rng = np.random.default_rng(4)
    series: list[list[Poses2D]] = [[] for _ in ALL]
    for slot in range(END):
        people = standing(*[(0.5, 0.3), (-0.8, 0.6)][: 1 + (slot >= COMES_IN)])
        views: Views = see(people, noise_px=2.0, rng=rng)
        views = with_poster(views) if poster and slot >= PUT_UP else views
        for camera, view in views.items():
            series[camera].append(view)
    times = (np.arange(END) / FPS).tolist()
    return Recording(
        name="room", rig=RIG, skeleton=COCO17, fps=FPS, num_slots=END, detector="simulated",
        views=tuple(
            ViewSeries.from_views(views, range(END), times, len(COCO17)) for views in series
        ),
    )  # fmt: skip


def replayed(poster: bool) -> list[SlotRecord]:
    settings = ReplaySettings(target_error_m=0.06, lead_slots=1, warmup_slots=5)
    return list(replay(recording(poster), settings))


def cameras(records: list[SlotRecord], first: int, stop: int) -> float:
    return float(np.mean([record.selected.sum() for record in records[first:stop]]))


def met(records: list[SlotRecord]) -> int:
    return next(record.slot for record in records[COMES_IN:] if len(record.people.track_ids) == 2)


def test_with_a_target_a_poster_forces_two_cameras_for_a_few_tries_only() -> None:
    plain, posters = replayed(False), replayed(True)
    seen = next(slot for slot in range(PUT_UP, END) if posters[slot].selected[0])
    assert cameras(posters, seen + 2, seen + 5) >= 2
    assert cameras(plain, seen, COMES_IN) < 1
    assert cameras(posters, seen + 20, COMES_IN) < cameras(plain, seen + 20, COMES_IN) + 0.15
    assert met(posters) <= met(plain) + 2
