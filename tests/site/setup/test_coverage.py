"""What a walk covers, and where it is to go next."""

from __future__ import annotations

import numpy as np
import pytest
from tests.rigs import looking

from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.site.setup.coverage import Coverage, hints

RIG = looking((4, 0), (0, 4), (-4, 0))
SIZES = [camera.image_size for camera in RIG.cameras]
FPS = 10.0


def person(x: float, y: float) -> np.ndarray:
    """Return `(17, 3)` joints of somebody who stands on the floor."""
    joints = np.zeros((17, 3))
    joints[:, 0] = x + np.linspace(-0.2, 0.2, 17)
    joints[:, 1], joints[:, 2] = y, np.linspace(0.05, 1.7, 17)
    return joints


def seen(camera: int, *people: np.ndarray) -> Poses2D:
    pixels = np.stack([RIG.cameras[camera].project(joints) for joints in people])
    return Poses2D(pixels, np.ones(pixels.shape[:2]))


def covered() -> Coverage:
    return Coverage(RIG, COCO17, FPS)


def test_people_are_counted_by_camera_by_pair_and_by_place() -> None:
    made, somebody = covered(), person(0.7, 0.2)
    for _ in range(5):
        made.add({0: seen(0, somebody), 1: seen(1, somebody), 2: Poses2D.empty(17)}, SIZES)
    assert made.people.tolist() == [5, 5, 0] and made.slots == 5
    assert made.pair_s(0, 1) == pytest.approx(0.5) and made.pair_s(0, 2) == 0
    assert made.seconds == pytest.approx(0.5)
    assert dict(made.floor) == {(1, 0): 5}, "half a metre a cell"
    assert made.seen[0].sum() == 5 and made.share(0) == pytest.approx(1 / 8)
    # Two people have two places.
    made, people = covered(), (person(0.7, 0.2), person(-0.8, -0.9))
    made.add({0: seen(0, *people), 1: seen(1, *people)}, SIZES)
    assert set(made.floor) == {(1, 0), (-2, -2)}
    # Poses that are hardly seen do not count.
    made, scores = covered(), np.where(np.arange(17) < 5, 1.0, 0.1)[None]
    made.add({0: Poses2D(seen(0, person(0, 0)).keypoints_px, scores)}, SIZES)
    assert made.people.tolist() == [0, 0, 0] and 0 in made.newest and made.newest[0] == []


def test_hints_name_what_is_missing_first() -> None:
    made = covered()
    made.add({0: seen(0, person(0, 0)), 1: seen(1, person(0, 0))}, SIZES)
    found = hints(made)
    assert found[0] == "c2 has seen nobody yet: walk in front of it."
    assert any("c0 shares only 0 s with another camera (c1)" in hint for hint in found)
    assert found[-1] == "Go on for 30 s."
    # Nothing is missing after a walk through all of it.
    made = covered()
    made.slots = made.shared = 400
    made.people[:] = 400
    made.together[:] = 400
    made.seen[:, 3, :] = 5
    assert hints(made) == []
    made.seen[1, :, :5] = 0
    assert hints(made) == ["Walk further to the left of c1."]
    # Cameras in two groups are told apart.
    rig = looking((4, 0), (0, 4), (-4, 0), (0, -4))
    made = Coverage(rig, COCO17, FPS)
    made.shared = made.slots = 400
    made.people[:] = 400
    made.seen[:] = 1
    made.together[:2, :2] = made.together[2:, 2:] = 400
    assert hints(made) == ["Nobody was seen by c0, c1 and c2, c3 at once: walk from one to the "
                           "other."]  # fmt: skip
