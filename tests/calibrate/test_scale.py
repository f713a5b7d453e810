"""The scale of a rig, from lengths that are known up to the error of a measuring tape."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.rigs import looking

from e3pose.base.errors import InputError
from e3pose.calibrate.matched_people import Joints
from e3pose.calibrate.people_3d import (
    MIN_LIMBS,
    SHANK,
    SPINE,
    THIGH,
    People3D,
    from_distance,
    from_limb,
    from_stature,
    place_people,
    statures,
)
from e3pose.model.skeleton import COCO17

TAPE_M = 0.01  # by which a distance between lenses is measured wrong


def standing(statures_m: list[float], unit_m: float, moments: int = MIN_LIMBS) -> People3D:
    """Return people who stand upright for some moments, in a unit of so many metres."""
    shapes: NDArray[np.float64] = np.full((len(statures_m), 17, 3), np.nan)
    for joints, tall_m in zip(shapes, np.array(statures_m) / unit_m, strict=True):
        heights = {"ankle": 0, "knee": SHANK, "hip": SHANK + THIGH}
        heights["shoulder"] = heights["hip"] + SPINE
        for x, side in ((-0.1, "left"), (0.1, "right")):
            for name, height in heights.items():
                joints[COCO17.index(f"{side}_{name}")] = [x * tall_m, 0, height * tall_m]
    person = np.repeat(np.arange(len(statures_m)), moments)
    return People3D(shapes[person], person, np.arange(len(person)), COCO17, 25.0)


def test_distance_is_as_sure_as_a_measuring_tape_makes_it() -> None:
    """A centimetre is more of a short baseline: what is stated covers it, and not much more."""
    unit_m = 2.5
    for metres in np.geomspace(0.02, 50.0, 40).tolist():
        off, rig = [], looking((0.0, 3.0), (metres / unit_m, 3.0))
        for error_m in (-TAPE_M, 0.0, TAPE_M):
            scale = from_distance(rig, "c0", "c1", metres + error_m)
            off.append(abs(scale.factor / unit_m - 1))
            assert scale.share == pytest.approx(TAPE_M / (metres + error_m))
        assert off[1] == pytest.approx(0)
        assert max(off) == pytest.approx(TAPE_M / metres)
    tiny = from_distance(looking((0.0, 3.0), (0.004, 3.0)), "c0", "c1", 0.004)
    assert tiny.share == 1.0, "no more than all of it"
    assert tiny.known_from == "0.004 m from c0 to c1"


@pytest.mark.parametrize("second", ["c0", "c1"])
def test_distance_needs_two_places(second: str) -> None:
    rig = looking((0.0, 3.0), (0.0, 3.0) if second == "c1" else (1.0, 3.0))
    with pytest.raises(InputError, match=f"--distance: found c0,{second}, expected two cameras"):
        from_distance(rig, "c0", second, 2.0)


def test_joints_are_placed_where_two_views_agree() -> None:
    rig, rng = looking((4, 0), (0, 4), (-4, 0)), np.random.default_rng(0)
    truth_m = rng.uniform((-0.5, -0.5, 0.2), (0.5, 0.5, 1.8), (2 * 17, 3))
    pixels = np.stack([camera.project(truth_m) for camera in rig.cameras])
    pixels[2, 0] += 200.0  # wrong in one view
    pixels[2, 1] = np.nan  # not seen there
    pixels[:, 2] += [[150.0, 90.0], [-150.0, 120.0], [20.0, -200.0]]  # wrong in all
    numbers = np.repeat([7, 8], 17), np.repeat([3, 4], 17), np.tile(np.arange(17), 2)
    joints = Joints(pixels, np.full(pixels.shape[:2], 2.0), *numbers)
    found = place_people(rig, joints, COCO17, 25.0)
    assert (found.person.tolist(), found.slot.tolist()) == ([7, 8], [3, 4])
    assert np.isnan(found.joints[0, 2]).all()
    placed_m = np.delete(found.joints.reshape(-1, 3), 2, axis=0)
    np.testing.assert_allclose(placed_m, np.delete(truth_m, 2, axis=0), atol=0.01)


def test_limb_has_its_measured_length() -> None:
    people = standing([1.8, 1.8], unit_m=2.5, moments=MIN_LIMBS // 2)
    scale = from_limb(people, "left_hip", "left_knee", 1.8 * THIGH)
    assert scale.factor == pytest.approx(2.5) and 0.01 < scale.share < 0.05
    assert scale.known_from == f"{1.8 * THIGH:g} m from left_hip to left_knee"
    for second in ("nose", "left_hip"):  # never seen; no length
        with pytest.raises(InputError, match="rarely triangulated together"):
            from_limb(people, "left_hip", second, 0.4)


def test_stature_is_that_of_most_people_who_were_seen_long_enough() -> None:
    people = standing([1.8, 1.8, 1.2], unit_m=2.5)
    np.testing.assert_allclose(2.5 * statures(people), [1.8, 1.8, 1.2])
    people.joints[-MIN_LIMBS:-1] = np.nan  # of a child nothing but a moment
    known = from_stature(people, 1.8)
    assert known.factor == pytest.approx(2.5) and known.known_from == "people 1.8 m tall"
    guessed = from_stature(people, None)
    assert guessed.factor == pytest.approx(2.5 * 1.7 / 1.8)
    assert guessed.known_from == "people assumed to be 1.7 m tall"
    # A guess is as far off as people differ, and surely further than what was measured.
    assert 0.01 < known.share < 0.05 < guessed.share
    assert abs(guessed.factor / 2.5 - 1) < guessed.share
    with pytest.raises(InputError, match="pass --distance or --limb"):
        from_stature(standing([1.8], 2.5, moments=1), 1.8)
