from __future__ import annotations

import numpy as np
from tests.cases import each_case

from e3pose.detectors.base import poses_in_image
from e3pose.detectors.fit import Fit, letterbox, letterbox_to_side, stretch

SIZES = [(640, 480), (480, 640), (1920, 1088), (97, 331), (640, 640)]
FITS = {
    "stretch": lambda size: stretch(size, (224, 224)),
    "corner": lambda size: letterbox(size, (512, 288)),
    "centred": lambda size: letterbox(size, (640, 640), centred=True),
    "side": lambda size: letterbox_to_side(size, 432, 16),
}


@each_case("size", SIZES)
@each_case("kind", FITS)
def test_a_spot_comes_back_to_where_it_was(kind: str, size: tuple[int, int]) -> None:
    """Where the resized image really has the spot is what `to_image` must undo."""
    fit: Fit = FITS[kind](size)
    rows, columns = np.mgrid[: size[1], : size[0]]
    for x, y in ((0.5, 0.5), (0.23, 0.71), (0.8, 0.31)):
        centre = np.array([x * size[0], y * size[1]])
        radius = min(size) / 20
        spot = np.exp(-((columns - centre[0]) ** 2 + (rows - centre[1]) ** 2) / (2 * radius**2))
        image = np.repeat((255 * spot).astype(np.uint8)[..., None], 3, axis=2)
        seen = fit.apply(image, 0)[..., 0].astype(np.float64)
        assert seen.shape == fit.input_size[::-1]
        v, u = np.mgrid[: seen.shape[0], : seen.shape[1]]
        mean = np.array([(u * seen).sum(), (v * seen).sum()]) / seen.sum()
        assert np.abs(fit.to_image(mean) - centre).max() < 0.1


def test_proportions_and_padding() -> None:
    fit = letterbox(size := (1000, 500), (640, 640), centred=True)
    assert (fit.content_size, fit.corner) == ((640, 320), (0, 160))
    canvas = fit.apply(np.full((500, 1000, 3), 7, np.uint8), 114)
    assert (canvas[:160] == 114).all() and (canvas[160:480] == 7).all() and size == fit.image_size
    fit = letterbox_to_side((1920, 1080), 432, 16)
    assert (fit.input_size, fit.content_size, fit.corner) == ((432, 256), (432, 243), (0, 0))
    fit = letterbox_to_side((10_000, 1), 432, 16)
    assert fit.content_size == (432, 1)


def test_what_nobody_should_believe_is_missing() -> None:
    keypoints = np.array([[[-0.4, 3], [-0.6, 3], [5, 5], [9.4, 5]], [[99.0, 1]] * 4])
    scores = np.array([[1.2, 1, 0.1, np.nan], [1, 1, 1, 1]])
    poses = poses_in_image(keypoints, scores, (10, 10), min_score=0.2)
    assert len(poses) == 1  # the other one is wholly outside
    np.testing.assert_array_equal(poses.scores[0], [1, 0, 0, 0])
    np.testing.assert_array_equal(np.isnan(poses.keypoints_px[0, :, 0]), [False, True, True, True])


@each_case("size", SIZES)
@each_case("kind", FITS)
def test_places_in_the_input_are_those_of_the_image(kind: str, size: tuple[int, int]) -> None:
    fit: Fit = FITS[kind](size)
    points = np.array([[-0.5, -0.5], [3.0, 40.0], [size[0] - 0.5, size[1] - 0.5]])
    np.testing.assert_allclose(fit.to_image(fit.to_input(points)), points)
    np.testing.assert_allclose(fit.to_input(points[0]), np.array(fit.corner) - 0.5)
