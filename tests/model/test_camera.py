from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.model.camera_fields import check_camera_id
from e3pose.model.distortion import Distortion

SIZE = (1280, 720)
K = np.array([[910.0, 0.0, 644.0], [0.0, 905.0, 352.0], [0.0, 0.0, 1.0]])
LENSES: dict[str, tuple[list[float], bool]] = {
    "none": ([], False),
    "four": ([-0.28, 0.09, 0.0012, -0.0008], False),
    "five": ([-0.28, 0.09, 0.0012, -0.0008, -0.01], False),
    "eight": ([0.4, 0.06, 0.0012, -0.0008, 0.003, 0.62, 0.11, 0.005], False),
    "thin prism": ([-0.28, 0.09, 0.001, -0.001, 0, 0, 0, 0, 0.01, -0.02, -0.015, 0.02], False),
    "tilted": ([0.4, 0.06, 0.001, 0, 0, 0.6, 0.1, 0, 0.01, 0, 0, 0.01, 0.05, -0.08], False),
    "pincushion": ([0.3, 0.05, -0.002, 0.001], False),
    "fisheye": ([0.02, -0.008, 0.003, -0.0006], True),
    "folding fisheye": ([-0.18, 0.01, 0.0, 0.0], True),
}


def rotation(rotation_vector: Any) -> Floats:
    """Rodrigues' formula as in textbooks."""
    vector = np.asarray(rotation_vector, dtype=float)
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross)


def camera(lens: str = "none", R: Any = None, t: Any = (0.0, 0.0, 4.0), **changes: Any) -> Camera:
    distortion, fisheye = LENSES[lens]
    R = np.eye(3) if R is None else R
    arguments = {
        "camera_id": "a", "image_size": SIZE, "K": K, "R": R, "t": t,
        "distortion": distortion, "fisheye": fisheye,
    }  # fmt: skip
    return Camera.from_world_to_camera(**(arguments | changes))


coordinates = st.floats(-1.0, 1.0, allow_subnormal=False)
vectors = st.tuples(coordinates, coordinates, coordinates)
lens_names = st.sampled_from(sorted(LENSES))


@st.composite
def extrinsics(draw: st.DrawFn) -> tuple[Floats, Floats]:
    """Cameras 3 to 9 m in front of a 2 m cube of points around the origin."""
    turn = rotation(np.array(draw(vectors)) * np.pi)
    return turn, np.array([*(0.3 * np.array(draw(vectors))[:2]), draw(st.floats(3.0, 9.0))])


@given(extrinsics(), vectors, lens_names)
def test_undistorted_pixels_are_those_of_the_projection_matrix(
    pose: tuple[Floats, Floats], point: tuple[float, float, float], lens: str
) -> None:
    seen = camera(lens, *pose)
    homogeneous = seen.projection @ np.array([*point, 1.0])
    expected = homogeneous[:2] / homogeneous[2]
    np.testing.assert_allclose(seen.undistort(seen.project(point)), expected, atol=1e-5)


@given(extrinsics(), vectors, lens_names)
def test_ray_of_a_projected_point_passes_through_it(
    pose: tuple[Floats, Floats], point: tuple[float, float, float], lens: str
) -> None:
    seen = camera(lens, *pose)
    ray = seen.rays(seen.project(point))
    away = np.array(point) - seen.center_m
    assert math.isclose(np.linalg.norm(ray), 1.0, abs_tol=1e-12)
    np.testing.assert_allclose(ray, away / np.linalg.norm(away), atol=1e-8)


@given(extrinsics(), extrinsics(), vectors)
def test_fundamental_matrix_vanishes_for_one_point_in_two_views(
    first: tuple[Floats, Floats], second: tuple[Floats, Floats], point: tuple[float, float, float]
) -> None:
    rig = Rig((camera("none", *first), camera("five", *second, camera_id="b")))
    F = rig.fundamental(0, 1)
    x = [np.append(c.undistort(c.project(point)), 1.0) for c in rig.cameras]
    scale = np.abs(x[1][:, None] * F * x[0]).max()
    assert abs(x[1] @ F @ x[0]) <= 1e-9 * max(scale, 1.0)
    np.testing.assert_allclose(rig.fundamental(1, 0), F.T, atol=1e-9 * max(1.0, np.abs(F).max()))


def test_fundamental_matrix_of_a_sideways_pair_makes_rows_correspond() -> None:
    rig = Rig((camera(t=(0, 0, 4)), camera(t=(-1, 0, 4), camera_id="b")))
    F = rig.fundamental(0, 1)
    row = np.array([300.0, 200.0, 1.0])
    assert abs(np.array([900.0, 200.0, 1.0]) @ F @ row) < 1e-12
    assert abs(np.array([900.0, 230.0, 1.0]) @ F @ row) > 1e-3


@given(extrinsics())
def test_centre_is_where_world_to_camera_gives_zero(pose: tuple[Floats, Floats]) -> None:
    R, t = pose
    seen = camera("none", R, t)
    np.testing.assert_allclose(R @ seen.center_m + t, 0, atol=1e-12)
    np.testing.assert_allclose(seen.R, R, atol=1e-12)
    np.testing.assert_allclose(seen.t, t, atol=1e-12)
    np.testing.assert_allclose(seen.T_world_camera @ [0, 0, 0, 1], [*seen.center_m, 1], atol=1e-12)


def test_axes_are_right_down_and_forward() -> None:
    seen = camera(t=(0, 0, 0))
    np.testing.assert_allclose(seen.project([0, 0, 2]), [644, 352])
    np.testing.assert_allclose(seen.project([1, 0, 2]), [644 + 455, 352])
    np.testing.assert_allclose(seen.project([0, 1, 2]), [644, 352 + 452.5])
    np.testing.assert_allclose(seen.rays([644, 352]), [0, 0, 1], atol=1e-12)


@each_case("lens", sorted(LENSES))
def test_projection_agrees_with_opencv(lens: str) -> None:
    cv2 = pytest.importorskip("cv2")
    distortion, fisheye = LENSES[lens]
    R, t = rotation([0.3, -0.5, 0.2]), np.array([0.1, -0.2, 4.0])
    points = np.random.default_rng(0).uniform(-1.2, 1.2, (300, 3))
    rvec, coefficients = cv2.Rodrigues(R)[0], np.array(distortion)
    if fisheye:
        pixels, _ = cv2.fisheye.projectPoints(points[:, None], rvec, t[:, None], K, coefficients)
    else:
        pixels, _ = cv2.projectPoints(points, rvec, t, K, coefficients if distortion else None)
    seen = camera(lens, R, t)
    np.testing.assert_allclose(seen.project(points), pixels.reshape(-1, 2), atol=1e-8)


@each_case("lens", [name for name in sorted(LENSES) if name != "none"])
def test_undistortion_reaches_every_pixel_of_the_image(lens: str) -> None:
    seen = camera(lens)
    u, v = np.meshgrid(np.linspace(0, SIZE[0] - 1, 41), np.linspace(0, SIZE[1] - 1, 23))
    pixels = np.stack([u, v], axis=-1)
    again = seen.project(seen.center_m + 5 * seen.rays(pixels))
    np.testing.assert_allclose(again, pixels, atol=1e-5)


@given(
    st.lists(st.floats(-0.6, 0.6), min_size=4, max_size=4),
    st.floats(0, 2 * np.pi),
    st.floats(0.0, 0.97),
    st.booleans(),
)
@settings(max_examples=60)
def test_any_lens_inverts_up_to_its_fold(
    coefficients: list[float], direction: float, share: float, fisheye: bool
) -> None:
    if not fisheye:
        coefficients = [*coefficients[:2], 0.0, 0.0]
    lens = Distortion(np.array(coefficients), fisheye)
    angle = share * min(lens.angle_limit, np.radians(75))
    ideal = np.tan(angle) * np.array([np.cos(direction), np.sin(direction)])
    real = lens.distort(ideal)
    assert np.isfinite(real).all()
    # Where the slope is near zero the inverse is ill conditioned, so compare images of the lens.
    back = lens.undistort(real)
    np.testing.assert_allclose(lens.distort(back), real, atol=1e-8 * (1 + np.abs(real).max()))
    np.testing.assert_allclose(back, ideal, atol=1e-5 * (1 + np.abs(ideal).max()))


def test_fold_is_where_the_distorted_radius_stops_rising() -> None:
    # r (1 - 0.3 r^2) has slope 1 - 0.9 r^2
    assert math.isclose(Distortion(np.array([-0.3, 0, 0, 0.0])).radius_limit, 1 / math.sqrt(0.9))
    # theta (1 - 0.18 theta^2) has slope 1 - 0.54 theta^2
    lens = Distortion(np.array([-0.18, 0, 0, 0.0]), fisheye=True)
    assert math.isclose(lens.angle_limit, 1 / math.sqrt(0.54))
    # 1 / (1 + r^2) times r rises up to radius one
    lens = Distortion(np.array([0, 0, 0, 0, 0, 1.0, 0, 0]))
    assert math.isclose(lens.radius_limit, 1.0)
    # a pole: 1 / (1 - r^2 / 4)
    lens = Distortion(np.array([0, 0, 0, 0, 0, -0.25, 0, 0]))
    assert math.isclose(lens.radius_limit, 2.0)


def test_points_beyond_the_fold_and_pixels_without_a_ray_are_nan() -> None:
    seen = camera(distortion=[-0.3, 0.0, 0.0, 0.0])
    # radius 2.5 at depth 2 lies beyond 1.05, though the polynomial would bring it into the image
    assert np.isnan(seen.project([2.5, 0, -2.0])).all()
    # the largest distorted radius is 0.7 x 910 px = 639 px
    assert np.isfinite(seen.undistort([644 + 600, 352.0])).all()
    assert np.isnan(seen.undistort([644 + 700, 352.0])).all()
    assert np.isnan(seen.rays([644 + 700, 352.0])).all()


@each_case("lens", sorted(LENSES))
def test_points_without_a_pixel_are_nan(lens: str) -> None:
    seen = camera(lens)
    points = np.array(
        [[0, 0, -4.1], [0, 0, -4.0], [np.nan, 0, 0], [0, 0, np.inf], [1e300, 1e300, 0], [0, 0, 0]]
    )
    pixels = seen.project(points)
    assert np.isnan(pixels[:4]).all()
    assert not (np.abs(pixels[4]) < 1e6).any()
    np.testing.assert_allclose(pixels[5], [644, 352])
    assert seen.sees(points).tolist() == [False] * 5 + [True]
    assert np.isnan(seen.undistort([np.nan, 3.0])).any()
    assert not np.isfinite(seen.undistort([1e200, 3.0])).all() or lens == "none"


def test_seeing_ends_at_the_edge_of_the_outer_pixels() -> None:
    seen = camera(t=(0, 0, 0))
    corners = {(-0.49, -0.49): True, (-0.51, 5): False, (1279.49, 719.49): True, (5, 719.51): False}
    for pixel, expected in corners.items():
        point = seen.rays(pixel) * 3
        assert bool(seen.sees(point)) is expected, pixel


def test_batches_keep_their_shape() -> None:
    seen = camera("five")
    points = np.random.default_rng(1).uniform(-1, 1, (2, 3, 5, 3))
    pixels = seen.project(points)
    assert pixels.shape == (2, 3, 5, 2)
    assert seen.rays(pixels).shape == (2, 3, 5, 3)
    assert seen.sees(points).shape == (2, 3, 5)
    np.testing.assert_array_equal(pixels[1, 2, 3], seen.project(points[1, 2, 3]))
    np.testing.assert_allclose(seen.undistort(pixels)[1, 2], seen.undistort(pixels[1, 2]))
    assert seen.project(np.zeros((0, 3))).shape == (0, 2)
    assert seen.undistort(np.zeros((0, 2))).shape == (0, 2)
    rig = Rig((seen, camera(camera_id="b")))
    assert rig.project(points).shape == (2, 2, 3, 5, 2)


def test_skew_moves_pixels_sideways_with_height() -> None:
    skewed = camera("five", K=K + np.array([[0, 40.0, 0], [0, 0, 0], [0, 0, 0]]))
    plain = camera("five")
    point = np.array([0.4, 0.7, 0.2])
    shift = skewed.project(point) - plain.project(point)
    down = (plain.project(point)[1] - 352) / 905
    np.testing.assert_allclose(shift, [40 * down, 0], atol=1e-9)
    away = point - skewed.center_m
    ray = skewed.rays(skewed.project(point))
    np.testing.assert_allclose(ray, away / np.linalg.norm(away), atol=1e-9)


def test_rotation_with_few_digits_becomes_exact() -> None:
    R = rotation([0.4, 1.0, -0.3])
    seen = camera("none", R.round(4))
    np.testing.assert_allclose(seen.R @ seen.R.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(seen.R, R, atol=2e-4)
    np.testing.assert_allclose(seen.t, [0, 0, 4], atol=1e-12)


def test_records_cannot_be_changed() -> None:
    seen = camera("five")
    for array in (seen.K, seen.T_world_camera, seen.distortion):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "focal length of zero": ({"K": np.diag([0.0, 900, 1])}, "K: .*positive focal"),
    "normalised matrix": ({"K": np.diag([0.7, 0.7, 1])}, "K: .*not millimetres or a share"),
    "focal length of the y axis": ({"K": np.diag([900.0, 9.0, 1])}, "K: .*900 and 9"),
    "transposed matrix": ({"K": K.T}, "K: .*cx"),
    "scaled matrix": ({"K": 2 * K}, "K: .*fx, s, cx"),
    "NaN matrix": ({"K": np.full((3, 3), np.nan)}, "K: .*not finite"),
    "far principal point": ({"K": K + [[0, 0, 1e9], [0, 0, 0], [0, 0, 0]]}, "K: .*near the image"),
    "matrix of 3 x 4": ({"K": np.zeros((3, 4))}, r"K: .*\(3, 4\)"),
    "not orthonormal": ({"R": 1.01 * np.eye(3)}, "rotation: .*orthonormal"),
    "mirror": ({"R": np.diag([1.0, 1.0, -1.0])}, "rotation: .*mirror"),
    "NaN rotation": ({"R": np.full((3, 3), np.nan)}, "rotation: .*not finite"),
    "NaN translation": ({"t": (0, np.nan, 1)}, "T_world_camera: .*not finite"),
    "millimetres": ({"t": (0, 0, 4000)}, "translation: .*4000 m.*millimetres"),
    "six coefficients": ({"distortion": np.zeros(6)}, "distortion: found 6"),
    "fisheye of five": ({"distortion": np.zeros(5), "fisheye": True}, "distortion: found 5"),
    "NaN coefficient": ({"distortion": [np.nan] * 4}, "distortion: "),
    "no width": ({"image_size": (0, 9)}, "image size"),
    "three sizes": ({"image_size": (9, 9, 3)}, "image size"),
    "NaN size": ({"image_size": (np.nan, 9)}, "image size"),
    "enormous size": ({"image_size": (10**9, 9)}, "image size"),
}  # fmt: skip


@each_case("wrong", WRONG)
def test_wrong_camera_is_named_with_its_field(wrong: str) -> None:
    changes, message = WRONG[wrong]
    with pytest.raises(InputError, match=f"camera left: {message}"):
        camera(camera_id="left", **changes)


@each_case(
    "name", ["", ".", "..", "../x", "a/b", "a\\b", "-x", "a b", "a\n", "é", "A" * 65, None, 7, b"a"]
)
def test_camera_ids_that_could_be_paths_are_refused(name: object) -> None:
    with pytest.raises(InputError, match="camera id"):
        check_camera_id(name)
    for plain in ("cam1", "0", "hd_00-05.x", "A" * 64, "_"):
        assert check_camera_id(plain) == plain


def test_rig_knows_its_cameras_by_name_and_order() -> None:
    rig = Rig((camera(camera_id="a"), camera(camera_id="b", t=(1, 0, 3)), camera(camera_id="c")))
    assert len(rig) == 3
    assert rig.index("b") == 1
    assert rig.subset([2, 1]).camera_ids == ("c", "b")
    np.testing.assert_allclose(rig.centers_m[1], [-1, 0, -3])
    np.testing.assert_array_equal(rig.projections[1], rig.cameras[1].projection)
    with pytest.raises(InputError, match="'d', which is not in the rig, expected one of a, b, c"):
        rig.index("d")
    with pytest.raises(InputError, match="'a' appears twice"):
        Rig((camera(), camera()))
    with pytest.raises(InputError, match="found no camera"):
        Rig(())


@pytest.mark.shared
@pytest.mark.parity
def test_shelf_truth_falls_on_the_detections() -> None:
    shared = os.environ.get("E3POSE_SHARED")
    if not shared:
        pytest.skip("E3POSE_SHARED is not set")
    from e3pose.model.skeleton import COCO17, SHELF14

    with np.load(Path(shared) / "data/shelf/shelf.npz", allow_pickle=False) as data:
        fields = ("K", "R", "t", "det_coco17", "det_view", "det_frame", "gt3d")
        K, R, t, detections, views, frames, truth = (data[name] for name in fields)
    rig = Rig(
        tuple(Camera.from_world_to_camera(f"s{n}", (1032, 776), K[n], R[n], t[n]) for n in range(5))
    )
    detected_columns = [COCO17.index(name) for name in SHELF14.joints[:12]]
    distances = []
    pixels = rig.project(truth[:, :, :12])  # (5, 301, 4, 12, 2)
    for view in range(5):
        for slot in range(len(truth)):
            rows = detections[(views == view) & (frames == slot)][:, detected_columns]
            if len(rows) == 0:
                continue
            for person in pixels[view, slot]:
                gaps = np.linalg.norm(rows[..., :2] - person, axis=-1)
                gaps[rows[..., 2] <= 0] = np.nan
                seen = np.isfinite(gaps).sum(axis=1) >= 6
                if seen.any():
                    closest = min(gaps[seen], key=np.nanmedian)
                    distances.append(closest[np.isfinite(closest)])
    assert 11.0 < np.median(np.concatenate(distances)) < 14.0
