from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.proportions import STATURE_M, size_of
from e3pose.model.skeleton import (
    BODY25,
    CMU31,
    COCO17,
    COCO18,
    PANOPTIC19,
    SHELF14,
    SKELETONS,
    Skeleton,
    convert,
    load_skeleton,
    skeleton_table,
)

# Published orders, written out here with their own words.
PUBLISHED = {
    "coco17": "nose, L eye, R eye, L ear, R ear, L shoulder, R shoulder, L elbow, R elbow, "
    "L wrist, R wrist, L hip, R hip, L knee, R knee, L ankle, R ankle",
    "coco18": "nose, neck, R shoulder, R elbow, R wrist, L shoulder, L elbow, L wrist, R hip, "
    "R knee, R ankle, L hip, L knee, L ankle, R eye, L eye, R ear, L ear",
    "body25": "nose, neck, R shoulder, R elbow, R wrist, L shoulder, L elbow, L wrist, mid hip, "
    "R hip, R knee, R ankle, L hip, L knee, L ankle, R eye, L eye, R ear, L ear, L big toe, "
    "L small toe, L heel, R big toe, R small toe, R heel",
    "shelf14": "R ankle, R knee, R hip, L hip, L knee, L ankle, R wrist, R elbow, R shoulder, "
    "L shoulder, L elbow, L wrist, bottom head, top head",
    "panoptic19": "neck, nose, mid hip, L shoulder, L elbow, L wrist, L hip, L knee, L ankle, "
    "R shoulder, R elbow, R wrist, R hip, R knee, R ankle, L eye, L ear, R eye, R ear",
}
BODY25_TO_COCO17 = [0, 16, 15, 18, 17, 5, 2, 6, 3, 7, 4, 12, 9, 13, 10, 14, 11]
COCO18_TO_COCO17 = [0, 15, 14, 17, 16, 5, 2, 6, 3, 7, 4, 11, 8, 12, 9, 13, 10]
COCO17_TO_SHELF14 = [16, 14, 12, 11, 13, 15, 10, 8, 6, 5, 7, 9]


def some_people(skeleton: Skeleton, components: int = 3, seed: int = 0) -> tuple[Floats, Floats]:
    generator = np.random.default_rng(seed)
    joints = generator.normal(size=(2, 4, len(skeleton), components))
    return joints, generator.uniform(0.1, 1.0, joints.shape[:-1])


@each_case("name", PUBLISHED)
def test_joint_order_is_the_published_one(name: str) -> None:
    words = PUBLISHED[name].replace("L ", "left ").replace("R ", "right ").split(", ")
    assert SKELETONS[name].joints == tuple(word.replace(" ", "_") for word in words)


@each_case("skeleton", SKELETONS.values(), ids=SKELETONS)
def test_limbs_join_different_joints_of_one_side(skeleton: Skeleton) -> None:
    assert len(set(skeleton.joints)) == len(skeleton)
    assert len(set(map(frozenset, skeleton.limbs))) == len(skeleton.limbs)
    for a, b in skeleton.limbs:
        sides = {skeleton.joints[i].split("_")[0] for i in (a, b)} & {"left", "right"}
        names = {skeleton.joints[i].split("_", 1)[-1] for i in (a, b)}
        assert a != b
        assert len(sides) < 2 or len(names) == 1, "only a pair such as both hips crosses the body"


@each_case("components", [2, 3])
@each_case(("source", "columns"), [(BODY25, BODY25_TO_COCO17), (COCO18, COCO18_TO_COCO17)])
def test_openpose_orders_reach_coco17_by_the_published_indices(
    source: Skeleton, columns: list[int], components: int
) -> None:
    positions, scores = some_people(source, components)
    converted, converted_scores = convert(positions, scores, source, COCO17)
    np.testing.assert_array_equal(converted, positions[..., columns, :])
    np.testing.assert_array_equal(converted_scores, scores[..., columns])


def test_shelf_head_follows_the_protocol() -> None:
    coco, scores = some_people(COCO17)
    shelf, shelf_scores = convert(coco, scores, COCO17, SHELF14)
    np.testing.assert_array_equal(shelf[..., :12, :], coco[..., COCO17_TO_SHELF14, :])
    np.testing.assert_array_equal(shelf_scores[..., :12], scores[..., COCO17_TO_SHELF14])
    for time in range(2):
        for person in range(4):
            nose, l_ear, r_ear = (coco[time, person, i] for i in (0, 3, 4))
            ms = (coco[time, person, 5] + coco[time, person, 6]) / 2
            hc = (l_ear + r_ear) / 2
            hb = (ms + hc) / 2
            ht = hb + 2 * (hc - hb)
            bottom = 0.75 * (ms + 0.5 * (nose - ms)) + 0.25 * hb
            top = 0.75 * (ms + (nose - ms) * np.array([0.75, 0.75, 1.5])) + 0.25 * ht
            np.testing.assert_allclose(shelf[time, person, 12], bottom, atol=1e-14)
            np.testing.assert_allclose(shelf[time, person, 13], top, atol=1e-14)
    assert (shelf_scores[..., 12:] > 0).all()


@pytest.mark.parametrize("hidden", ["left_shoulder", "right_shoulder"])
def test_shelf_head_needs_both_shoulders(hidden: str) -> None:
    joints, scores = some_people(COCO17)
    joints[..., COCO17.index(hidden), :] = np.nan
    scores[..., COCO17.index(hidden)] = 0
    shelf, shelf_scores = convert(joints, scores, COCO17, SHELF14)
    assert np.isnan(shelf[..., 12:, :]).all()
    assert (shelf_scores[..., 12:] == 0).all()


@each_case("source", [BODY25, COCO18, PANOPTIC19], ids=lambda s: s.name)
def test_shelf_comes_from_any_skeleton_with_the_joints_of_coco17(source: Skeleton) -> None:
    joints, scores = some_people(source)
    direct = convert(joints, scores, source, SHELF14)
    through = convert(*convert(joints, scores, source, COCO17), COCO17, SHELF14)
    np.testing.assert_array_equal(direct[0], through[0])
    np.testing.assert_array_equal(direct[1], through[1])


def test_neck_and_mid_hip_are_middles_with_the_lower_score() -> None:
    joints, scores = some_people(COCO17)
    converted, converted_scores = convert(joints, scores, COCO17, BODY25)
    neck, mid_hip = BODY25.index("neck"), BODY25.index("mid_hip")
    np.testing.assert_allclose(converted[..., neck, :], (joints[..., 5, :] + joints[..., 6, :]) / 2)
    np.testing.assert_allclose(
        converted[..., mid_hip, :], (joints[..., 11, :] + joints[..., 12, :]) / 2
    )
    np.testing.assert_array_equal(
        converted_scores[..., neck], np.minimum(scores[..., 5], scores[..., 6])
    )
    heel = BODY25.index("left_heel")
    assert np.isnan(converted[..., heel, :]).all()
    assert (converted_scores[..., heel] == 0).all()


@given(st.integers(0, 2**32 - 1), st.sampled_from([BODY25, COCO18, PANOPTIC19]))
def test_coco17_survives_the_way_there_and_back(seed: int, through: Skeleton) -> None:
    joints, scores = some_people(COCO17, seed=seed)
    hidden = np.random.default_rng(seed).random(scores.shape) < 0.3
    scores[hidden] = 0
    joints[hidden] = np.nan
    there = convert(joints, scores, COCO17, through)
    again, again_scores = convert(*there, through, COCO17)
    np.testing.assert_array_equal(again, joints)
    np.testing.assert_array_equal(again_scores, scores)


@each_case("target", SKELETONS.values(), ids=SKELETONS)
@each_case("source", SKELETONS.values(), ids=SKELETONS)
def test_converted_joints_are_finite_exactly_where_they_score(
    source: Skeleton, target: Skeleton
) -> None:
    joints, scores = some_people(source)
    scores[0, :2, ::3] = 0
    joints[scores == 0] = np.nan
    converted, converted_scores = convert(joints, scores, source, target)
    assert converted.shape == (2, 4, len(target), 3)
    np.testing.assert_array_equal(np.isfinite(converted).all(-1), converted_scores > 0)
    assert converted_scores.max() <= 1
    nobody, none = convert(joints[:, :0], scores[:, :0], source, target)
    assert nobody.shape == (2, 0, len(target), 3)
    assert none.shape == (2, 0, len(target))


def test_conversion_refuses_arrays_of_another_skeleton() -> None:
    joints, scores = some_people(COCO17)
    with pytest.raises(InputError, match="do not fit skeleton body25 of 25 joints"):
        convert(joints, scores, BODY25, COCO17)


HEAD = 'format = "e3pose-skeleton"\nversion = 1\n'


@each_case("name", SKELETONS)
def test_a_skeleton_that_is_written_out_is_the_same(tmp_path: Path, name: str) -> None:
    wanted = replace(SKELETONS[name], name="own")
    table = {**skeleton_table(wanted), "about": "written out"}
    (tmp_path / "other.toml").write_text(tomli_w.dumps(table))
    found = load_skeleton(tmp_path / "other.toml")
    assert replace(found, rest_m=()) == replace(wanted, rest_m=())
    np.testing.assert_array_equal(np.array(found.rest_m), np.array(wanted.rest_m))


@each_case("name", SKELETONS)
def test_the_tree_of_a_skeleton_has_one_root_and_its_pairs_are_apart(name: str) -> None:
    skeleton = SKELETONS[name]
    assert skeleton.parents.count(-1) == 1
    assert max(map(skeleton.depth, range(len(skeleton)))) < 16
    seen = [joint for pair in skeleton.pairs for joint in pair]
    assert len(seen) == len(set(seen))
    for left, right in skeleton.pairs:  # mirror images hang alike
        above = skeleton.parents[left], skeleton.parents[right]
        paired = above in skeleton.pairs or above[0] == above[1]
        assert paired or {*above} & {left, right} or -1 in above or "hip" in skeleton.joints[left]


def test_hands_faces_and_animals_have_their_own_size(tmp_path: Path) -> None:
    for name in ("coco17", "halpe136", "coco133", "cmu31"):
        assert size_of(SKELETONS[name]) == 1.0
    for name, length_m in (("left_hand21", 0.188), ("right_hand20", 0.16), ("face70", 0.15)):
        assert STATURE_M * size_of(SKELETONS[name]) == pytest.approx(length_m, abs=0.04), name
    mouse = 'format = "e3pose-skeleton"\nversion = 1\njoints = ["snout", "back", "tail"]\n'
    rest = "[rest]\nback = [-0.06, 0, 0.01]\ntail = [-0.05, 0, 0]\n"
    (tmp_path / "mouse.toml").write_text(mouse + 'tree = ["snout back tail"]\n' + rest)
    assert STATURE_M * size_of(load_skeleton(tmp_path / "mouse.toml")) == pytest.approx(0.11)


def test_hands_hang_on_wrists_and_faces_on_heads() -> None:
    whole = SKELETONS["coco133"]
    for tip, chain in (
        ("left_index4", "left_index3 left_index2 left_index1 left_hand_root left_wrist"),
        ("right_pinky1", "right_hand_root right_wrist right_elbow right_shoulder"),
        ("face_62", "face_30 nose"),
    ):
        joint = whole.index(tip)
        for name in chain.split():
            joint = whole.parents[joint]
            assert whole.joints[joint] == name
    assert [whole.joints[index] for index in whole.core] == [*SKELETONS["coco23"].joints]


@each_case(
    ("text", "message"),
    [
        ("", 'missing: format = "e3pose-skeleton"'),
        ('format = "other"\nversion = 1', "format: found 'other'"),
        (HEAD, "joints: found 0 joints, expected 1 to 512 different names"),
        (HEAD + 'joints = ["a", "b", "a"]', "joints: found a twice"),
        (HEAD + 'joints = ["left wrist"]', "joints: found left wrist, expected 1 to 512"),
        (HEAD + "joints = [1]", "joints"),
        (HEAD + 'joints = ["a"]\nlimbs = ["a b"]', "limbs: found b, expected joints of"),
        (HEAD + 'joints = ["a", "b"]\ntree = ["a b", "b a"]', "tree: found a below itself"),
        (HEAD + 'joints = ["a"]\ntree = ["wrist a"]', "tree: found wrist, expected joints"),
        (HEAD + 'joints = ["a"]\npairs = ["a c"]', "pairs: found c"),
        (HEAD + 'joints = ["a"]\n[moves]\nfins = ["a"]', "moves: found fins, expected one of tr"),
        (HEAD + 'joints = ["a"]\n[rest]\nb = [0, 0, 1]', "rest: found b"),
        (HEAD + 'joints = ["a"]\n[rest]\na = [0, 1]', "rest"),
        (HEAD + 'joints = ["a"]\n[rest]\na = [0, 0, inf]', "rest: found inf, expected metres"),
        (HEAD + 'joints = ["a"]\nlimbs = ["a a"]', "limbs: found a twice in a row"),
        (HEAD + 'joints = ["a"]\n[same]\nb = ["c"]', "same: found b"),
        (HEAD + 'joints = ["a"]\ntails = 1', "unknown key 'tails'"),
        (HEAD + 'parts = ["coco18", "coco17"]', "joints: found left_ankle twice"),
        (HEAD + 'parts = ["mine.toml"]', "parts: found .*mine.toml within itself"),
        (HEAD + 'parts = ["face68", "face68"]', "parts: found 2 skeletons, expected at most 6, ea"),
        (HEAD + f"joints = {[f'j{n}' for n in range(40_000)]}", "joints: found 40000 joints"),
        (
            HEAD + 'joints = ["a", "b"]\nlimbs = ["' + "a b " * 9000 + '"]',
            "limbs: found 17999 pairs",
        ),
        (HEAD + 'parts = ["none.toml"]', "none.toml: skeleton: no such file"),
        (HEAD + 'name = "coco17"\njoints = ["a"]', "name: found coco17, expected up to 64"),
        (HEAD + 'name = "../a"\njoints = ["a"]', "name: found ../a"),
        (HEAD + f"joints = {[f'j{n}' for n in range(513)]}", "joints: found 513 joints"),
    ],
)
def test_a_broken_file_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_skeleton(tmp_path / "mine.toml")
    assert "\n" not in str(caught.value) and ".toml" in str(caught.value)


def test_unknown_names_list_the_known() -> None:
    assert load_skeleton("coco17") is COCO17
    with pytest.raises(InputError, match="smpl: skeleton: no such file, expected coco17"):
        load_skeleton("smpl")
    with pytest.raises(InputError, match="coco17 has no joint 'tail'"):
        COCO17.index("tail")


@pytest.mark.shared
def test_cmu_bones_are_named_for_their_far_ends() -> None:
    shared = os.environ.get("E3POSE_SHARED")
    if not shared:
        pytest.skip("E3POSE_SHARED is not set")
    path = Path(shared) / "data/cmu_mocap/cmu_mocap_train_30fps.npz"
    ends = {
        "root": "mid_hip", "lhipjoint": "left_hip", "lfemur": "left_knee", "ltibia": "left_ankle",
        "lfoot": "left_foot", "ltoes": "left_toes", "lclavicle": "left_shoulder",
        "lhumerus": "left_elbow", "lradius": "left_wrist", "lwrist": "left_palm",
        "lhand": "left_hand", "lthumb": "left_thumb", "lfingers": "left_fingers",
        "lowerback": "lower_back", "upperback": "upper_back", "thorax": "thorax",
        "lowerneck": "neck", "upperneck": "upper_neck", "head": "top_head",
    }  # fmt: skip
    ends |= {
        "r" + bone[1:]: joint.replace("left_", "right_")
        for bone, joint in ends.items()
        if joint.startswith("left_")
    }
    with np.load(path, allow_pickle=False) as data:
        bones = [str(name) for name in data["joint_names"]]
        clip = data[next(name for name in data.files if name != "joint_names")]
    assert CMU31.joints == tuple(ends[bone] for bone in bones)
    # Rigid limbs keep their length in the recording, which wrong joints would not.
    for upper, lower in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow")):
        for side in ("left", "right"):
            a, b = (CMU31.index(f"{side}_{joint}") for joint in (upper, lower))
            lengths = np.linalg.norm(clip[:, a] - clip[:, b], axis=-1)
            assert (a, b) in CMU31.limbs
            assert 0.2 < lengths.mean() < 0.5
            assert lengths.std() < 0.005
