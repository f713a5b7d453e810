"""Lenses undone by the compiled kernel, projections through them, and rotations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.cases import each_case
from tests.interpreted import interpreted
from tests.rigs import on_circle, towards

from e3pose.base.arrays import Floats
from e3pose.base.kernel import LANES
from e3pose.estimate.per_slot.fuse import Fuser
from e3pose.model.camera import Camera, Rig
from e3pose.model.distortion import TOLERANCE, WIDEST_ANGLE
from e3pose.model.pose import MAX_PIXEL
from e3pose.model.project import make_optics, project_people
from e3pose.model.rotations import rotation_of
from e3pose.model.undistort import make_lenses, undistort_slot

pytestmark = pytest.mark.slow

SIZE = (1000, 800)
K = np.array([[700.0, 3.0, 500.0], [0.0, 690.0, 400.0], [0.0, 0.0, 1.0]])
NUM_JOINTS = 17
NUM_LENSES = 60
LENSES: dict[str, tuple[list[float], bool]] = {
    "none": ([], False),
    "zeros": ([0.0] * 5, False),
    "four": ([-0.28, 0.09, 0.0012, -0.0008], False),
    "five": ([-0.28, 0.09, 0.0012, -0.0008, -0.01], False),
    "eight": ([0.4, 0.06, 0.0012, -0.0008, 0.003, 0.62, 0.11, 0.005], False),
    "thin prism": ([-0.28, 0.09, 0.001, -0.001, 0, 0, 0, 0, 0.01, -0.02, -0.015, 0.02], False),
    "tilted": ([0.4, 0.06, 0.001, 0, 0, 0.6, 0.1, 0, 0.01, 0, 0, 0.01, 0.05, -0.08], False),
    "pole": ([0.0, 0.0, 0.0, 0.0, 0.0, -0.25, 0.0, 0.0], False),
    "folding": ([-0.3, 0.0, 0.002, -0.001], False),
    "much tangential": ([-0.3, 0.1, 0.05, -0.04], False),
    "enormous": ([1e6, -1e6, 1e3, 1e3, 1e6], False),
    "fisheye": ([0.02, -0.008, 0.003, -0.0006], True),
    "folding fisheye": ([-0.18, 0.01, 0.0, 0.0], True),
    "filmed in part": ([0.02, -0.008, 0.003, -0.0006], True),
}
FILMED_TO = 0.4  # radians off the axis


def camera(lens: str) -> Camera:
    coefficients, fisheye = LENSES[lens]
    known_to = FILMED_TO if lens == "filmed in part" else None
    return Camera("a", SIZE, K, np.eye(4), np.array(coefficients), fisheye, known_to=known_to)


def random_camera(rng: np.random.Generator) -> Camera:
    length = int(rng.choice([4, 4, 5, 8, 12, 14]))
    fisheye = length == 4 and bool(rng.random() < 0.5)
    brown = (0.3, 0.1, 0.002, 0.002, 0.05, 0.3, 0.1, 0.05, *[0.003] * 4, 0.03, 0.03)
    usual = (0.1, 0.05, 0.02, 0.01) if fisheye else brown
    coefficients = rng.normal(size=length) * usual[:length] * rng.choice([0.3, 1, 3])
    return Camera("a", SIZE, K, np.eye(4), coefficients, fisheye)


def by_kernel(seen_by: Camera, pixels: Floats) -> Floats:
    """Undistort `(num_points, 2)` as poses of `NUM_JOINTS`; the rest of the last pose is NaN."""
    num_poses = -(-len(pixels) // NUM_JOINTS)
    poses = np.full((1, num_poses, NUM_JOINTS, 2), np.nan)
    poses.reshape(-1, 2)[: len(pixels)] = pixels
    out = np.zeros((num_poses, NUM_JOINTS, 2))
    lenses = make_lenses(Rig((seen_by,)))
    counts = np.array([num_poses])
    undistort_slot(poses, np.ones(poses.shape[:3]), counts, *lenses, np.zeros(6 * LANES), out)
    return out.reshape(-1, 2)[: len(pixels)]


def normalised(pixels: Floats) -> Floats:
    return np.asarray((pixels - K[:2, 2]) @ np.linalg.inv(K[:2, :2]).T)


def on_the_image_plane(seen_by: Camera, shares: Floats, directions: Floats) -> Floats:
    """Return real pixels at shares of the largest angle that the lens can see."""
    ideal = np.tan(shares * min(seen_by.lens.angle_limit, 1.4))
    points = ideal[:, None] * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    pixels = seen_by.project(np.column_stack([points, np.ones(len(points))]))
    return pixels[(np.abs(pixels) <= MAX_PIXEL).all(axis=-1)]


def assert_same(seen_by: Camera, pixels: Floats) -> Floats:
    """Compare where the answer is NaN, and images under the lens; return the difference."""
    fast, plain = by_kernel(seen_by, pixels), seen_by.undistort(pixels)
    lost = np.isnan(plain).any(axis=-1)
    assert np.array_equal(np.isnan(fast).all(axis=-1), lost)
    assert not np.isnan(fast[~lost]).any()
    ideal = normalised(fast[~lost])
    real = normalised(pixels[~lost])
    allowed = 2 * TOLERANCE * (1 + np.linalg.norm(real, axis=-1))
    assert (np.abs(seen_by.lens.distort(ideal) - real).max(axis=-1) <= allowed).all()
    return np.asarray(np.abs(ideal - normalised(plain[~lost])).max(axis=-1, initial=0.0))


@each_case("lens", LENSES)
def test_pixels_of_the_image_and_around_it_move_as_in_the_reference(lens: str) -> None:
    u, v = np.meshgrid(np.linspace(-1500, 2500, 81), np.linspace(-1200, 2000, 65))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
    inside = ((pixels >= 0) & (pixels <= SIZE)).all(axis=-1)
    assert_same(camera(lens), pixels)
    if lens != "enormous":  # sees 1 pixel
        assert np.isfinite(by_kernel(camera(lens), pixels[inside])).any()


def test_random_lenses_are_inverted_as_in_the_reference() -> None:
    lost = kept = 0
    for seed in range(NUM_LENSES):
        rng = np.random.default_rng(seed)
        seen_by = random_camera(rng)
        anywhere = rng.uniform((-500, -400), (1500, 1200), (600, 2))
        assert_same(seen_by, anywhere)
        lost += int(np.isnan(seen_by.undistort(anywhere)[:, 0]).sum())
        directions = rng.uniform(0, 2 * np.pi, 600)
        to_the_fold = 1 - 10.0 ** rng.uniform(-6, 0, 600)
        assert_same(seen_by, on_the_image_plane(seen_by, to_the_fold, directions))
        # Where the slope comes near zero, rounding moves either answer: no nearer than this.
        well_seen = on_the_image_plane(seen_by, rng.uniform(0, 0.95, 600), directions)
        assert assert_same(seen_by, well_seen).max() < 1e-9
        kept += len(well_seen)
    assert lost > 1_500 and kept > 15_000


@each_case(
    ("coefficients", "fisheye", "largest"),
    [
        # r (1 - 0.3 r^2) turns at r^2 = 1 / 0.9, a (1 - 0.18 a^2) at a^2 = 1 / 0.54
        ([-0.3, 0.0, 0.0, 0.0], False, 2 / 3 / np.sqrt(0.9)),
        ([-0.18, 0.0, 0.0, 0.0], True, 2 / 3 / np.sqrt(0.54)),
        ([0.0, 0.0, 0.0, 0.0], True, WIDEST_ANGLE),
    ],
)
def test_the_last_pixel_before_the_end_has_a_ray_and_the_next_has_none(
    coefficients: list[float], fisheye: bool, largest: float
) -> None:
    seen_by = Camera("a", SIZE, K, np.eye(4), np.array(coefficients), fisheye)
    angles = np.linspace(0, 2 * np.pi, 50)[:, None, None]
    radii = largest + np.array([-1e-4, -1e-7, 1e-8, 1e-4])[:, None]
    points = radii * np.concatenate([np.cos(angles), np.sin(angles)], axis=-1)  # (50, 4, 2)
    pixels = (points @ K[:2, :2].T + K[:2, 2]).reshape(-1, 2)
    for answer in (by_kernel(seen_by, pixels), seen_by.undistort(pixels)):
        lost = np.isnan(answer).any(axis=-1).reshape(50, 4)
        assert (lost == [False, False, True, True]).all()


def test_what_is_no_keypoint_is_nan() -> None:
    pixels = np.array([[np.nan, 3], [3, np.inf], [2e6, 3], [3, -2e6], [1e300, 1e300], [400, 300]])
    answer = np.isnan(by_kernel(camera("zeros"), pixels))
    assert answer.all(axis=-1).tolist() == [True] * 5 + [False]


def test_every_camera_uses_its_own_lens_whatever_the_counts() -> None:
    rng = np.random.default_rng(4)
    rig = Rig(
        tuple(
            Camera(f"c{i}", SIZE, K, np.eye(4), np.array(coefficients), fisheye)
            for i, (coefficients, fisheye) in enumerate(LENSES.values())
        )
    )
    counts = np.arange(len(rig)) % 4
    keypoints = rng.uniform((0, 0), SIZE, (len(rig), 5, 13, 2))
    out = np.zeros((int(counts.sum()), 13, 2))
    scores = np.ones(keypoints.shape[:3])
    undistort_slot(keypoints, scores, counts, *make_lenses(rig), np.zeros(6 * LANES), out)
    expected = [c.undistort(keypoints[i, : counts[i]]) for i, c in enumerate(rig.cameras)]
    np.testing.assert_allclose(out, np.concatenate(expected), atol=1e-6)


def mixed_rig(lenses: list[str]) -> Rig:
    """A ring of cameras that look at the middle, fisheyes with a short focal length and askew."""
    cameras = []
    for index, lens in enumerate(lenses):
        coefficients, fisheye = LENSES[lens]
        angle = 2.4 * index
        place = on_circle(4.0, 2.2 + 0.1 * index, angle)
        aside = np.array(on_circle(1.0, -0.3, angle + np.pi + (0.7 if fisheye else 0.0)))
        focal = 350.0 if fisheye else 700.0
        cameras.append(
            towards(f"c{index}", place, place + aside, SIZE, focal, coefficients, fisheye)
        )
    return Rig(tuple(cameras))


@each_case(
    "lenses",
    [
        ["none", "fisheye"],
        ["none", "fisheye", "none", "fisheye", "five"],
        ["fisheye", "eight", "none"],
        ["fisheye", "fisheye", "fisheye"],
    ],
)
def test_people_seen_by_fisheyes_and_others_are_found_where_they_are(lenses: list[str]) -> None:
    rng = np.random.default_rng(5)
    spots = np.array([(-0.8, 0.1, 0), (0.7, 0.6, 0), (0.2, -0.9, 0)])
    truth = spots[:, None] + rng.uniform((-0.25, -0.25, 0.1), (0.25, 0.25, 1.7), (NUM_JOINTS, 3))
    rig = mixed_rig(lenses)
    keypoints = rig.project(truth)
    assert np.isfinite(keypoints).all()
    fuser = Fuser(rig, NUM_JOINTS)
    counts = np.full(len(rig), len(truth))
    fusion = fuser.fuse_arrays(keypoints, np.full(keypoints.shape[:3], 0.9), counts)
    assert len(fusion.people) == len(truth)
    order = fusion.members[:, 0]
    assert (fusion.members == order[:, None]).all()
    assert np.abs(fusion.people.joints_m - truth[order]).max() < 1e-6
    assert fusion.reprojection_error_px.max() < 1e-3


def test_nothing_is_placed_beyond_what_was_filmed() -> None:
    seen_by = camera("filmed in part")
    angles = np.array([0.9, 1.1]) * FILMED_TO
    whole = camera("fisheye")
    points = np.stack([np.tan(angles), 0 * angles, 1 + 0 * angles], axis=-1)
    pixels = whole.project(points)
    assert np.isfinite(pixels).all()
    placed = by_kernel(seen_by, pixels)
    assert np.isfinite(placed[0]).all() and np.isnan(placed[1]).all()
    assert seen_by.sees(points).tolist() == [True, False]


FAR_PX = 1e6  # beyond it digits differ, and nothing is in view


@each_case("lens", sorted(LENSES))
def test_people_are_where_the_rig_projects_them(lens: str) -> None:
    rng = np.random.default_rng(3)
    rig = Rig((camera(lens),))
    points_m = rng.normal(scale=(1.5, 1.5, 3.0), size=(40, 17, 3))
    points_m[rng.random(points_m.shape[:2]) < 0.1] = np.nan
    points_m[0, 0] = 0.0
    points_m[0, 1] = [0.0, 0.0, 2.0]
    found, expected = np.empty((40, 17, 2)), rig.project(points_m)[0]
    interpreted(project_people)(0, make_optics(rig), points_m, found)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    near = np.abs(expected).max(axis=-1) < FAR_PX
    assert near.any() or lens == "enormous"
    np.testing.assert_allclose(found[near], expected[near], rtol=1e-9, atol=1e-9)


AXIS = np.array([0.6, -0.48, 0.64])


@each_case("angle", [0.0, 1e-12, 1e-4, 0.7, np.pi - 1e-9, np.pi, 5.0, 100.0])
def test_vector_is_axis_times_angle(angle: float) -> None:
    expected = Rotation.from_rotvec(angle * AXIS).as_matrix()
    np.testing.assert_allclose(rotation_of(angle * AXIS), expected, rtol=0, atol=1e-13)
