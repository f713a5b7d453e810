"""Views of an unchanged image: that nobody moves, not where anybody is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from tests.cases import each_case
from tests.estimate.filter.agreement import KERNEL, Slots, follow, model, ring, seen

from e3pose.estimate.filter import Belief
from e3pose.model.pose import Poses2D

pytestmark = pytest.mark.slow


def half_unchanged(slots: Slots, rng: np.random.Generator) -> Slots:
    """Say of half of the views that their images are unchanged, which they are not."""

    def seen_so(view: Poses2D) -> Poses2D:
        seconds = float(rng.choice([0.001, 0.04, 0.3, 1e6])) if rng.random() < 0.5 else 0.0
        return replace(view, unchanged_s=seconds)

    return [({c: seen_so(view) for c, view in views.items()}, t) for views, t in slots]


@each_case("cameras", [1, 3, 5])
def test_equals_the_reference(cameras: int) -> None:
    slots = half_unchanged(seen(ring(), cameras), np.random.default_rng(cameras))
    people, _ = follow(model(), slots)
    assert people > (ring().num_slots if cameras > 1 else 0)


def standing() -> tuple[Belief, Mapping[int, Poses2D], float]:
    """Return a belief that all cameras taught for a second, what they saw last, and when."""
    belief, slots = Belief.empty(model()), seen(ring(), 5)
    for views, time_s in slots[:25]:
        belief, _ = KERNEL(model(), belief, views, time_s)
    return belief, views, time_s


def repeated(slots: int, still: bool) -> Belief:
    """Return the belief after the last views were repeated so often, as looks or as unchanged."""
    belief, views, time_s = standing()
    for slot in range(1, slots + 1):
        if still:
            views = {c: replace(view, unchanged_s=0.04 * slot) for c, view in views.items()}
        belief, _ = KERNEL(model(), belief, views, time_s + 0.04 * slot)
    return belief


def spread_m(belief: Belief) -> np.ndarray:
    places = belief.covariance[..., :3, :3]
    return np.asarray(np.sqrt(np.trace(places, axis1=-2, axis2=-1)))


def test_an_unchanged_image_makes_no_place_surer_however_often_it_comes() -> None:
    before, _, time_s = standing()
    after = repeated(25, still=True)
    assert (spread_m(after) >= 0.98 * spread_m(before)).all()
    alone, _ = KERNEL(model(), before, {}, time_s + 1)
    assert np.median(spread_m(after)) < np.median(spread_m(alone)) / 5  # nor forgets it
    assert np.median(spread_m(repeated(25, still=False))) < np.median(spread_m(before))


def test_an_unchanged_image_holds_people_where_they_are() -> None:
    before, _, time_s = standing()
    held = repeated(12, still=True).state
    alone, _ = KERNEL(model(), before, {}, time_s + 12 * 0.04)
    speed = np.linalg.norm(held[..., 3:], axis=-1)
    assert np.median(speed) < 0.1
    moved = np.linalg.norm(held[..., :3] - before.state[..., :3], axis=-1)
    drifted = np.linalg.norm(alone.state[..., :3] - before.state[..., :3], axis=-1)
    assert np.median(moved) < np.median(drifted)


def test_it_neither_teaches_nor_counts_as_a_look() -> None:
    before, after = standing()[0], repeated(5, still=True)
    for name in ("noise", "detection_map", "existence", "hits", "missed"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name), err_msg=name)
    np.testing.assert_allclose(after.last_seen_s, before.last_seen_s + 0.2)
    assert (after.unmeasured_s == 0).any(axis=1).all()


def test_nobody_is_missed_where_it_lacks_them() -> None:
    belief, views, time_s = standing()
    nobody = Poses2D.empty(views[0].scores.shape[1])
    nothing = replace(nobody, unchanged_s=0.04)
    after, _ = KERNEL(model(), belief, dict.fromkeys(views, nothing), time_s + 0.04)
    np.testing.assert_array_equal(after.existence, belief.existence)
