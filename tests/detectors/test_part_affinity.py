"""The decoder against maps drawn, by the published formats, from people whose joints are known."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.detectors.inference import Network
from e3pose.detectors.openpose import HEAT, OpenPose, Prior, decode, expected_heat, find_peaks
from e3pose.detectors.topology import OPENPOSE_THIN, TOPOLOGIES, TRT_POSE

Maps = NDArray[np.float32]
Person = Mapping[str, tuple[float, float]]
Format = tuple[list[str], list[tuple[str, str, int, int]], int]

# trt_pose's tasks/human_pose/human_pose.json; its training code writes limb k's rows (y) to channel
# 2k and columns (x) to 2k + 1.
HUMAN_POSE = json.loads("""{"keypoints": ["nose", "left_eye", "right_eye", "left_ear", "right_ear",
 "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
 "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "neck"],
 "skeleton": [[16, 14], [14, 12], [17, 15], [15, 13], [12, 13], [6, 8], [7, 9], [8, 10], [9, 11],
 [2, 3], [1, 2], [1, 3], [2, 4], [3, 5], [4, 6], [5, 7], [18, 1], [18, 6], [18, 7], [18, 12],
 [18, 13]]}""")
# OpenPose's COCO order and the affinity channels (x, y) of each limb.
COCO_ORDER = """nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist
right_hip right_knee right_ankle left_hip left_knee left_ankle right_eye left_eye right_ear
left_ear"""
COCO = COCO_ORDER.split()
COCO_LIMBS = """neck right_shoulder 12|neck left_shoulder 20|right_shoulder right_elbow 14
|right_elbow right_wrist 16|left_shoulder left_elbow 22|left_elbow left_wrist 24|neck right_hip 0
|right_hip right_knee 2|right_knee right_ankle 4|neck left_hip 6|left_hip left_knee 8
|left_knee left_ankle 10|neck nose 28|nose right_eye 30|right_eye right_ear 34|nose left_eye 32
|left_eye left_ear 36|right_shoulder right_ear 18|left_shoulder left_ear 26"""

STANDING: Person = {
    "nose": (0, -10.0), "neck": (0, -7.5), "right_shoulder": (-2.5, -7.3),
    "left_shoulder": (2.5, -7.4), "right_elbow": (-3.6, -4.1), "left_elbow": (4.1, -4.4),
    "right_wrist": (-4.4, -0.7), "left_wrist": (5.6, -1.7), "right_hip": (-1.5, 0.2),
    "left_hip": (1.6, 0.3), "right_knee": (-1.8, 5.4), "left_knee": (2.3, 5.1),
    "right_ankle": (-1.9, 10.7), "left_ankle": (3.1, 10.1), "right_eye": (-0.8, -10.9),
    "left_eye": (0.9, -10.8), "right_ear": (-1.7, -10.3), "left_ear": (1.8, -10.2),
}  # fmt: skip


def published_format(name: str) -> Format:
    """Part names in channel order, limbs with their x and y channels, number of channels."""
    if name == "trt-pose":
        parts = HUMAN_POSE["keypoints"]
        pairs = enumerate(HUMAN_POSE["skeleton"])
        limbs = [(parts[a - 1], parts[b - 1], 2 * k + 1, 2 * k) for k, (a, b) in pairs]
        return parts, limbs, 42
    rows = [row.split() for row in COCO_LIMBS.split("|")]
    return COCO, [(a, b, int(x), int(x) + 1) for a, b, x in rows], 38


def placed(person: Person, x: float, y: float, scale: float = 1.0) -> Person:
    return {part: (x + scale * u, y + scale * v) for part, (u, v) in person.items()}


def without(person: Person, *parts: str) -> Person:
    return {part: where for part, where in person.items() if part not in parts}


def render(
    name: str, people: Sequence[Person], shape: tuple[int, int], noise: float = 0.0
) -> tuple[Maps, Maps]:
    """Draw people given in map cells, as networks of this kind are trained to."""
    parts, limbs, channels = published_format(name)
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    heatmaps = np.zeros((len(parts), *shape))
    affinity = np.zeros((channels, *shape))
    for person in people:
        for part, (x, y) in person.items():
            blob = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2)
            heatmaps[parts.index(part)] = np.maximum(heatmaps[parts.index(part)], blob)
        for a, b, channel_x, channel_y in limbs:
            if a not in person or b not in person:
                continue
            start, end = np.array(person[a]), np.array(person[b])
            length = np.linalg.norm(end - start)
            u, v = (end - start) / length
            along = (columns - start[0]) * u + (rows - start[1]) * v
            across = (columns - start[0]) * v - (rows - start[1]) * u
            on_limb = (along > -1) & (along < length + 1) & (np.abs(across) <= 1.2)
            affinity[channel_x][on_limb] = u
            affinity[channel_y][on_limb] = v
    generator = np.random.default_rng(5)
    heatmaps += noise * generator.standard_normal(heatmaps.shape)
    affinity += noise * generator.standard_normal(affinity.shape)
    return heatmaps.astype(np.float32), affinity.astype(np.float32)


def check_found(name: str, found: Floats, scores: Floats, people: Sequence[Person]) -> None:
    """Every person is found once, every joint within a tenth of a cell, nothing is invented."""
    parts = published_format(name)[0]
    assert len(found) == len(people)
    left = list(range(len(found)))
    for person in people:
        truth = np.array([person.get(part, (np.nan, np.nan)) for part in parts])
        errors = [np.nanmean(np.linalg.norm(found[row] - truth, axis=-1)) for row in left]
        row = left.pop(int(np.argmin(errors)))
        present = np.isfinite(truth[:, 0])
        np.testing.assert_array_equal(scores[row] > 0, present)
        np.testing.assert_array_equal(np.isfinite(found[row][:, 0]), present)
        assert np.abs(found[row] - truth)[present].max() < 0.1


SCENES: dict[str, tuple[list[Person], float]] = {
    "nobody": ([], 0.0),
    "one": ([placed(STANDING, 20.3, 23.6)], 0.0),
    "noise": ([placed(STANDING, 20.3, 23.6)], 0.01),
    "on cell centres": (
        [{part: (float(round(x)) + 20, float(round(y)) + 20) for part, (x, y) in STANDING.items()}],
        0.0,
    ),
    "two apart": ([placed(STANDING, 12.3, 23.6), placed(STANDING, 38.8, 22.1)], 0.01),
    # Torsos, arms and legs lie across each other.
    "two overlapping": ([placed(STANDING, 19.3, 23.6, 1.3), placed(STANDING, 23.4, 25.3)], 0.0),
    "one behind the other's arm": (
        [placed(STANDING, 15.0, 23.0, 1.2), without(placed(STANDING, 24.0, 23.3), "right_wrist")],
        0.0,
    ),
    "missing parts": (
        [
            without(placed(STANDING, 12.3, 23.6), "left_wrist", "right_ear", "right_ankle"),
            without(
                placed(STANDING, 38.8, 22.1),
                *("nose", "left_eye", "right_eye", "left_knee", "left_ankle"),
            ),
        ],
        0.0,
    ),
    "only a torso": (
        [without(placed(STANDING, 20.0, 20.0), *(set(STANDING) - {
            "neck", "left_shoulder", "right_shoulder", "left_hip", "right_hip"}))],
        0.0,
    ),
}  # fmt: skip


@each_case("name", sorted(TOPOLOGIES))
@each_case("scene", SCENES)
def test_known_people_are_found(name: str, scene: str) -> None:
    people, noise = SCENES[scene]
    heatmaps, affinity = render(name, people, (46, 54), noise)
    found, scores = decode(heatmaps, affinity, TOPOLOGIES[name])
    check_found(name, found, scores, people)


@pytest.mark.parametrize("name", sorted(TOPOLOGIES))
def test_three_parts_and_blobs_without_affinity_make_no_person(name: str) -> None:
    some = {p: STANDING[p] for p in ("left_shoulder", "left_elbow", "left_wrist")}
    heatmaps, affinity = render(name, [placed(some, 20, 20)], (46, 54))
    assert decode(heatmaps, affinity, TOPOLOGIES[name])[0].shape == (0, 18, 2)
    heatmaps, affinity = render(name, [placed(STANDING, 20, 23)], (46, 54))
    assert len(decode(heatmaps, np.zeros_like(affinity), TOPOLOGIES[name])[0]) == 0
    # A field that points the wrong way speaks against the limbs.
    assert len(decode(heatmaps, -affinity, TOPOLOGIES[name])[0]) == 0


def test_noise_everywhere_is_bounded() -> None:
    generator = np.random.default_rng(0)
    heatmaps = generator.random((18, 46, 54)).astype(np.float32)
    affinity = generator.uniform(-1, 1, (38, 46, 54)).astype(np.float32)
    found, scores = decode(heatmaps, affinity, OPENPOSE_THIN)
    assert len(found) <= 64 * 18 // 4 and ((scores >= 0) & (scores <= 1)).all()


def test_flat_maps_have_at_most_one_peak_a_neighbourhood() -> None:
    parts, cells, heights = find_peaks(np.ones((2, 20, 20), np.float32), 4, 2.5, 0.15)
    assert len(parts) <= 128 and np.all(heights <= 1)
    for part in (0, 1):
        own = cells[parts == part]
        near = np.linalg.norm(own[:, None] - own, axis=-1) + 9 * np.eye(len(own))
        assert near.min() > 0.99


@each_case("shape", [(1, 1), (1, 9), (2, 2)])
def test_tiny_maps_are_no_trouble(shape: tuple[int, int]) -> None:
    ones = np.ones((18, *shape), np.float32)
    people, _ = decode(ones, np.ones((38, *shape), np.float32), OPENPOSE_THIN)
    assert people.shape[1:] == (18, 2)


def fake_network(
    outputs: list[Maps],
    input_shape: tuple[int | None, ...] = (1, 3, None, None),
    declared: tuple[tuple[int | None, ...], ...] | None = None,
) -> tuple[Network, list[Maps]]:
    """Return a network that hands out given maps, and what it was shown."""
    seen: list[Maps] = []

    def run(tensor: Maps) -> list[Maps]:
        seen.append(tensor)
        return outputs

    shapes = declared or tuple(tuple(output.shape) for output in outputs)
    path = Path("fake.onnx")
    return Network(path, "cpu", 1, input_shape, "float", ("maps",), shapes, run), seen


def in_cells(person: Person, stride_x: float, stride_y: float) -> Person:
    """Pixels of the image to map cells when an image pixel is a whole share of a cell."""
    return {
        part: ((x + 0.5) / stride_x - 0.5, (y + 0.5) / stride_y - 0.5)
        for part, (x, y) in person.items()
    }


def test_openpose_thin_gives_image_pixels_of_coco18() -> None:
    person = placed(STANDING, 310.0, 260.0, 18.0)  # pixels of an 864 x 480 image
    # 864 x 480 fills 432 x 240 of the input and 54 x 30 cells: 16 pixels a cell.
    heatmaps, affinity = render("openpose-thin", [in_cells(person, 16, 16)], (30, 54))
    background = np.zeros((1, 30, 54), np.float32)
    network, shown = fake_network([np.concatenate([heatmaps, background, affinity])[None]])
    image = np.zeros((480, 864, 3), np.uint8)
    image[..., 0], image[..., 2] = 200, 30  # reddish
    detector = OpenPose(network, OPENPOSE_THIN)
    poses = detector.detect(image)
    truth = np.array([person[joint] for joint in COCO])
    assert detector.skeleton.joints == tuple(COCO)
    assert len(poses) == 1 and np.abs(poses.keypoints_px[0] - truth).max() < 1.6
    assert shown[-1].shape == (1, 3, 240, 432)
    np.testing.assert_array_equal(shown[-1][0, :, 100, 100], [30, 0, 200])  # BGR of 0..255


def test_padding_lies_right_and_below() -> None:
    person = placed(STANDING, 160.0, 300.0, 20.0)
    # 400 x 864 fills 200 x 432 of a 208 x 432 input: 26 x 54 cells, 16 pixels each.
    heatmaps, affinity = render("openpose-thin", [in_cells(person, 16, 16)], (54, 26))
    maps = np.concatenate([heatmaps, np.zeros((1, 54, 26), np.float32), affinity])[None]
    network, shown = fake_network([maps])
    poses = OpenPose(network, OPENPOSE_THIN).detect(np.full((864, 400, 3), 9, np.uint8))
    truth = np.array([person[joint] for joint in COCO])
    assert np.abs(poses.keypoints_px[0] - truth).max() < 1.6
    assert shown[-1].shape == (1, 3, 432, 208)
    assert shown[-1][0, 0, 0, 199] == 9 and shown[-1][0, 0, 0, 200] == 0


def test_trt_pose_gives_image_pixels_of_coco18() -> None:
    person = placed(STANDING, 310.0, 240.0, 16.0)
    # 896 x 448 squeezed into 224 x 224, 56 x 56 cells: 16 x 8 pixels a cell.
    maps = render("trt-pose", [in_cells(person, 16, 8)], (56, 56))
    network, shown = fake_network([maps[1][None], maps[0][None]], (1, 3, 224, 224))  # either order
    image = np.zeros((448, 896, 3), np.uint8)
    image[..., 0] = 255
    poses = OpenPose(network, TRT_POSE).detect(image)
    truth = np.array([person[joint] for joint in COCO])
    assert len(poses) == 1 and np.abs(poses.keypoints_px[0] - truth).max() < 1.6
    expected = (np.array([1.0, 0.0, 0.0]) - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]
    np.testing.assert_allclose(shown[-1][0, :, 7, 7], expected, rtol=1e-5)


def test_other_networks_are_refused() -> None:
    wrong, _ = fake_network([np.zeros((1, 20, 8, 8), np.float32)])
    with pytest.raises(InputError, match=r"fake.onnx: output: found .*expected \[1, 57"):
        OpenPose(wrong, OPENPOSE_THIN)
    wrong, _ = fake_network([np.zeros((1, 57, 8, 8), np.float32)], (1, 4))
    with pytest.raises(InputError, match=r"fake.onnx: input: found float \[1, 4\]"):
        OpenPose(wrong, OPENPOSE_THIN)
    late, _ = fake_network([np.zeros((1, 20, 8, 8), np.float32)], declared=((1, None, None, None),))
    with pytest.raises(InputError, match=r"fake\.onnx: output"):
        OpenPose(late, OPENPOSE_THIN).detect(np.zeros((50, 50, 3), np.uint8))
    broken, _ = fake_network([np.full((1, 57, 8, 8), np.nan, np.float32)])
    with pytest.raises(InputError, match="not finite"):
        OpenPose(broken, OPENPOSE_THIN).detect(np.zeros((50, 50, 3), np.uint8))


@each_case("shape", [(0, 5, 3), (5, 5), (5, 5, 4), (20_000, 5, 3)])
def test_what_is_no_image_is_refused(shape: tuple[int, ...]) -> None:
    network, _ = fake_network([np.zeros((1, 57, 8, 8), np.float32)])
    with pytest.raises(InputError, match="image: found"):
        OpenPose(network, OPENPOSE_THIN).detect(np.zeros(shape, np.uint8))


def crossing() -> tuple[Maps, Maps, Floats]:
    """Two elbows that could each belong to either of two shoulders, about as well by the field.

    Returns heatmaps, affinity and the `(2, 2, 2)` cells of each person's shoulder and elbow.
    """
    size, places = 40, np.array([[[10.0, 10], [14, 30]], [[14.0, 10], [10, 30]]])
    heatmaps = np.zeros((18, size, size), dtype=np.float32)
    affinity = np.zeros((38, size, size), dtype=np.float32)
    rows, columns = np.mgrid[:size, :size]
    shoulder, elbow = COCO.index("right_shoulder"), COCO.index("right_elbow")
    for person in places:
        for part, (x, y) in zip((shoulder, elbow), person, strict=True):
            spot = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2)
            heatmaps[part] = np.maximum(heatmaps[part], spot)
    affinity[15] = 1.0  # all limbs point down
    return heatmaps, affinity, places


def test_an_expected_joint_lifts_a_weak_peak_over_the_threshold() -> None:
    heatmaps, affinity, people = crossing()
    shoulder, elbow = COCO.index("right_shoulder"), COCO.index("right_elbow")
    heatmaps[elbow] *= 0.9 * OPENPOSE_THIN.peak_threshold
    topology = replace(OPENPOSE_THIN, min_parts=2)
    assert len(decode(heatmaps, affinity, topology)[0]) == 0
    places = np.full((1, 18, 2), np.nan)
    upright = np.array([people[0, 0], people[1, 1]])  # limbs point down
    places[0, [shoulder, elbow]] = upright + 0.3  # nobody is expected exactly
    found, _ = decode(heatmaps, affinity, topology, Prior(places, np.array([0.5])))
    assert len(found) == 1
    assert np.abs(found[0, [shoulder, elbow]] - upright).max() < 0.5


def test_prior_makes_no_limb_that_the_field_does_not_show() -> None:
    heatmaps, affinity, people = crossing()
    places = np.full((2, 18, 2), np.nan)
    places[:, [COCO.index("right_shoulder"), COCO.index("right_elbow")]] = people
    topology = replace(OPENPOSE_THIN, min_parts=2)
    found, _ = decode(heatmaps, 0 * affinity, topology, Prior(places, np.array([2.0, 2.0])))
    assert len(found) == 0


def test_expected_heat_is_highest_on_the_spot_and_nothing_for_unknown_parts() -> None:
    places = np.array([[[3.0, 4.0], [np.nan, np.nan]], [[9.0, 4.0], [np.nan, np.nan]]])
    heat = expected_heat(Prior(places, np.array([0.5, 4.0])), (12, 16))
    assert heat.shape == (2, 12, 16) and not heat[1].any()
    assert heat[0, 4, 3] == heat[0, 4, 9] == pytest.approx(HEAT)
    assert heat[0, 7, 3] < heat[0, 7, 9]  # whose prediction reaches farther
    assert heat[0, :, :6].argmax() == 4 * 6 + 3
