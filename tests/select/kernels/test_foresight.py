"""Cameras before the compiled foresight: blind places, boxes, sets, entrants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.cases import each_case
from tests.reference import expected_information as plain
from tests.reference import newcomers
from tests.reference import occlusion as plain_boxes
from tests.rigs import looking
from tests.select.outlooks import standing

from e3pose.base.arrays import Flags
from e3pose.estimate.base import Outlook
from e3pose.model.noise import ErrorMemory
from e3pose.select.expected_information import Foresight, expected_entrants, foresee
from e3pose.select.occlusion import box_iou, occlusion, person_boxes

RIG = looking((4, 0), (0, 4), (-4, 0), (3, 3))
SLOT_S = 0.04
JOINTS = 9
MEMORY = ErrorMemory()


def outlook(seed: int, people: int = 3) -> Outlook:
    """Return people about the middle, some of them outside the images, behind others or lost."""
    rng = np.random.default_rng(seed)
    joints_m = rng.uniform(-1.5, 1.5, (people, 1, 3)) + rng.normal(0, 0.4, (people, JOINTS, 3))
    joints_m[..., 2] += 1.0
    root = rng.normal(0, 0.1, (people, JOINTS, 6, 6))
    shape = (people, len(RIG))
    still = standing(
        joints_m,
        len(RIG),
        confirmed=rng.random(people) < 0.8,
        covariance=root @ np.swapaxes(root, -1, -2) + 1e-4 * np.eye(6),
        drift_m2ps3=rng.uniform(0, 1, (people, JOINTS)),
        velocity_lasts_s=rng.uniform(0.2, 1.0, JOINTS),
        delivered=rng.uniform(0, 1, shape),
        shows=rng.uniform(0, 1, shape),
        last_seen_s=np.where(rng.random(shape) < 0.2, np.inf, rng.uniform(0, 3, shape)),
        sigma_px=rng.uniform(2, 8, len(RIG)),
    )
    return replace(still, has_memory=bool(seed % 2))


def subsets() -> Flags:
    return (np.arange(16)[:, None] >> np.arange(4) & 1).astype(bool)


@each_case("seed", range(8))
def test_foresight_is_that_of_numpy(seed: int) -> None:
    people, ordered = outlook(seed), subsets()[seed : seed + 3]
    found = foresee(RIG, people, SLOT_S, ordered)
    expected = plain.foresee(RIG, people, SLOT_S, ordered)
    for name in ("prior", "views", "counted", "new", "weights"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=1e-8, err_msg=name
        )


@each_case("seed", range(8))
def test_worth_of_sets_is_that_of_numpy(seed: int) -> None:
    found = foresee(RIG, outlook(seed), SLOT_S)
    sets = subsets()
    nats = plain.information(found, sets)
    np.testing.assert_allclose(found.information(sets), nats, atol=1e-12)
    if found.people.confirmed.any():
        error_m = plain.expected_error_m(found, sets)
        np.testing.assert_allclose(found.expected_error_m(sets), error_m, rtol=1e-10)
    for chosen in sets:
        gains = [
            nats[(sets == (chosen | one)).all(axis=1)] - nats[(sets == (chosen & ~one)).all(axis=1)]
            for one in np.eye(4, dtype=bool)
        ]
        np.testing.assert_allclose(found.gains_nats(chosen), np.ravel(gains), atol=1e-12)


def test_hundreds_of_joints_do_not_overflow() -> None:
    found = foresee(RIG, outlook(1), SLOT_S)
    many = Foresight(
        **{name: getattr(found, name) for name in found.__dataclass_fields__}
        | {"prior": np.tile(found.prior, (1, 60, 1)), "views": np.tile(found.views, (1, 1, 60, 1))}
    )
    np.testing.assert_allclose(many.information(subsets()), found.information(subsets()))


@each_case("seed", range(20))
def test_entrants_are_those_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arguments = (
        RIG, rng.integers(0, 3, len(RIG)), rng.uniform(0, 0.3, len(RIG)), 0.14, SLOT_S,
        rng.random((seed % 5, len(RIG))) < 0.5,
    )  # fmt: skip
    found, expected = expected_entrants(*arguments), newcomers.expected_entrants(*arguments)
    np.testing.assert_allclose(found.others, expected.others)
    np.testing.assert_allclose(found.weights, expected.weights)
    np.testing.assert_allclose(found.starts(subsets()), newcomers.starts(expected, subsets()))


SIZE = (640, 480)


@each_case("seed", range(10))
def test_boxes_and_their_overlap_are_those_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-100, 700, (3, 5, 1, 2))
    pixels = middle + rng.normal(0, 80, (3, 5, 7, 2))
    pixels[rng.random(pixels.shape[:3]) < 0.3] = np.nan
    pixels[0, 2] = np.nan
    boxes = person_boxes(pixels, SIZE)
    np.testing.assert_allclose(boxes, plain_boxes.person_boxes(pixels, SIZE), atol=1e-12)
    np.testing.assert_allclose(occlusion(boxes), plain_boxes.occlusion(boxes), atol=1e-12)
    pairs = boxes[0][:, None], boxes[1][None]
    np.testing.assert_allclose(box_iou(*pairs), plain_boxes.box_iou(*pairs), atol=1e-12)


def test_nobody_occludes_nobody() -> None:
    assert occlusion(np.zeros((4, 0, 4))).tolist() == [0.0] * 4
    assert person_boxes(np.zeros((0, 17, 2)), SIZE).shape == (0, 4)
