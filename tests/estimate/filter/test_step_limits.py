"""Input that the compiled step refuses, and input that must not cost the slot."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.agreement import KERNEL, assert_agree, model, ring, seen
from tests.reference.filter_step import step

from e3pose.base.errors import InputError
from e3pose.estimate.filter import Belief
from e3pose.estimate.filter.scratch import MAX_LEFTOVERS
from e3pose.estimate.filter.state import MAX_TRACKS
from e3pose.model.pose import Poses2D

pytestmark = pytest.mark.slow


@each_case(
    ("views", "time_s", "message"),
    [
        ({9: Poses2D.empty(17)}, 0.0, "camera 9"),
        ({0: Poses2D.empty(14)}, 0.0, "found 14 joints, expected 17"),
        ({}, np.nan, "time: found nan"),
    ],
)
def test_wrong_input_is_the_same_clear_line(
    views: Mapping[int, Poses2D], time_s: float, message: str
) -> None:
    for advance in (step, KERNEL):
        with pytest.raises(InputError, match=message):
            advance(model(), Belief.empty(model()), views, time_s)


def noise(people: int, rng: np.random.Generator) -> Poses2D:
    """Return a view full of detections, each an upright body somewhere in the image."""
    body = rng.uniform((-20, -60), (20, 60), (people, 17, 2))
    spots = rng.uniform((30, 70), (1000, 700), (people, 1, 2))
    return Poses2D(body + spots, rng.uniform(0.2, 1.0, (people, 17)))


def test_views_full_of_noise_are_bounded_and_equal() -> None:
    rng = np.random.default_rng(1)
    plain = fast = Belief.empty(model())
    for slot in range(4):
        views = {camera: noise(3000, rng) for camera in range(5)}
        plain, _ = step(model(), plain, views, slot / 25)
        start = time.thread_time()
        fast, _ = KERNEL(model(), fast, views, slot / 25)
        # Tens of milliseconds; without bounds the pairs alone would take minutes.
        assert time.thread_time() - start < 1.0
        assert_agree(fast, plain)
    assert len(fast) <= MAX_TRACKS
    assert len(fast.leftovers) <= MAX_LEFTOVERS


def test_one_noisy_view_keeps_nobody_from_being_born() -> None:
    rng = np.random.default_rng(2)
    plain = fast = Belief.empty(model())
    for views, time_s in seen(ring(), 5)[:20]:
        crowded = {**views, 0: noise(80, rng)}
        plain, _ = step(model(), plain, crowded, time_s)
        fast, found = KERNEL(model(), fast, crowded, time_s)
        assert_agree(fast, plain)
    assert len(found) >= 3


def test_more_tracks_than_anybody_starts_are_still_stepped() -> None:
    views, _ = seen(ring(), 5)[0]
    belief, _ = step(model(), Belief.empty(model()), views, 0.0)
    copies = 200
    columns = {
        name: np.repeat(column[:1], copies, axis=0) for name, column in belief.columns().items()
    }
    columns["track_ids"] = np.arange(copies)
    state = np.array(columns["state"], dtype=np.float64)
    state[..., 0] += 0.5 * np.arange(copies)[:, None]
    columns["state"] = state
    many = replace(belief, next_id=copies, **columns)  # type: ignore[arg-type]
    expected, _ = step(model(), many, views, 0.04)
    found, _ = KERNEL(model(), many, views, 0.04)
    assert_agree(found, expected)
    assert len(found) > MAX_TRACKS
