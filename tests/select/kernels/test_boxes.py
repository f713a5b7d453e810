"""Boxes of people and their overlap: the compiled form against plain numpy."""

from __future__ import annotations

import numpy as np
from tests.cases import each_case
from tests.reference import occlusion as plain

from e3pose.select.occlusion import box_iou, occlusion, person_boxes

SIZE = (640, 480)


@each_case("seed", range(10))
def test_boxes_and_their_overlap_are_those_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-100, 700, (3, 5, 1, 2))
    pixels = middle + rng.normal(0, 80, (3, 5, 7, 2))
    pixels[rng.random(pixels.shape[:3]) < 0.3] = np.nan
    pixels[0, 2] = np.nan
    boxes = person_boxes(pixels, SIZE)
    np.testing.assert_allclose(boxes, plain.person_boxes(pixels, SIZE), atol=1e-12)
    np.testing.assert_allclose(occlusion(boxes), plain.occlusion(boxes), atol=1e-12)
    pairs = boxes[0][:, None], boxes[1][None]
    np.testing.assert_allclose(box_iou(*pairs), plain.box_iou(*pairs), atol=1e-12)


def test_nobody_occludes_nobody() -> None:
    assert occlusion(np.zeros((4, 0, 4))).tolist() == [0.0] * 4
    assert person_boxes(np.zeros((0, 17, 2)), SIZE).shape == (0, 4)
