"""IDF1 and HOTA of made-up tracks, against hand counts and against trackeval."""

from __future__ import annotations

import warnings
from importlib.util import find_spec

import numpy as np
import pytest

from e3pose_lab.reproduce.identity_scores import Frame, hota, idf1

pytestmark = pytest.mark.skipif(
    find_spec("motmetrics") is None, reason="motmetrics is not installed: pip install e3pose[lab]"
)


def frame(pairs: dict[int, int], similarity: float = 1.0) -> Frame:
    """A slot in which actors are shown as tracks, each at its place."""
    actors, tracks = np.array([*pairs], dtype=int), np.array([*pairs.values()], dtype=int)
    return Frame(actors, tracks, similarity * np.eye(len(pairs)))


def random_frames(seed: int) -> list[Frame]:
    rng = np.random.default_rng(seed)
    frames = []
    for _ in range(40):
        actors = np.sort(rng.choice(4, rng.integers(1, 5), replace=False))
        tracks = rng.choice(6, rng.integers(1, 6), replace=False) + 10
        close = rng.random((len(actors), len(tracks)))
        frames.append(Frame(actors, tracks, np.where(close > 0.4, close, 0.0)))
    return frames


def test_perfect_tracks_score_one() -> None:
    frames = [frame({0: 7, 1: 9})] * 10
    assert idf1(frames) == pytest.approx(1.0) and hota(frames) == pytest.approx(1.0)


def test_a_number_that_changes_half_way_costs_half() -> None:
    frames = [frame({0: 7})] * 10 + [frame({0: 8})] * 10
    assert idf1(frames) == pytest.approx(0.5)
    assert hota(frames) == pytest.approx(np.sqrt(0.5))


def test_nobody_shown_scores_nothing() -> None:
    assert hota([Frame(np.array([0]), np.zeros(0, int), np.zeros((1, 0)))]) == 0.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_hota_is_that_of_trackeval(seed: int) -> None:
    trackeval = pytest.importorskip("trackeval", reason="trackeval is not installed")
    frames = random_frames(seed)
    names = sorted({int(track) for each in frames for track in each.tracks})
    data = {
        "num_tracker_dets": sum(len(each.tracks) for each in frames),
        "num_gt_dets": sum(len(each.actors) for each in frames),
        "num_gt_ids": 4,
        "num_tracker_ids": len(names),
        "gt_ids": [each.actors for each in frames],
        "tracker_ids": [np.searchsorted(names, each.tracks) for each in frames],
        "similarity_scores": [each.similarity for each in frames],
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = trackeval.metrics.HOTA().eval_sequence(data)["HOTA"].mean()
    assert hota(frames) == pytest.approx(float(theirs), abs=1e-9)
