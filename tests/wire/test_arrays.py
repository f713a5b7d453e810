"""Arrays in messages."""

from __future__ import annotations

import numpy as np

from e3pose.model.pose import Poses2D
from e3pose.wire.arrays import MAX_PERSONS, pack_poses, unpack
from e3pose.wire.codec import decode, encode
from e3pose.wire.site_messages import OutboxPart


def test_of_too_many_people_those_of_best_score_are_sent() -> None:
    people = MAX_PERSONS + 3
    rng = np.random.default_rng(1)
    scores = rng.permutation(np.linspace(0.1, 0.9, people))[:, None].repeat(2, axis=1)
    keypoints_px = np.arange(people, dtype=float)[:, None, None] + np.zeros((people, 2, 2))
    packed_px, packed = (unpack(each) for each in pack_poses(Poses2D(keypoints_px, scores)))
    best = np.argsort(-scores[:, 0])[:MAX_PERSONS]
    np.testing.assert_array_equal(packed_px[:, 0, 0], best)
    np.testing.assert_allclose(packed, scores[best], rtol=1e-6)


def test_answer_that_says_nothing_is_valid() -> None:
    assert decode(encode(OutboxPart()), OutboxPart, "edge") == OutboxPart()
