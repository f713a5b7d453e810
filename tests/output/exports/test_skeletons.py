"""BVH and glTF: bones turned in a test's own forward kinematics land on the joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.cases import each_case
from tests.output.exports.takes import MISSING_FRAMES, NUM_FRAMES, take, walking

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17, HALPE26, MEANS, SIDES, SKELETONS
from e3pose.model.take import Motion, Take, motions_of
from e3pose.output.exports import ExportSettings, export
from e3pose.output.exports.base import y_up
from e3pose.output.exports.bone_names import FINGERS
from e3pose.output.exports.bones import bones_of
from e3pose.simulate.feet import add_joints

TAKE = take()
FIRST, SECOND = TAKE.motions
PLACES = {"spine": "mid_hip", "head": "neck"}  # nodes that stand where another is


def joint(motion: Motion, name: str) -> Floats:
    """Return a joint, or a mean of joints, with y up."""
    name = PLACES.get(name, name)
    parts = [COCO17.index(part) for part in MEANS.get(name, (name,))]
    return y_up(motion.joints_m[:, parts].mean(axis=1))


def read_bvh(path: Path) -> tuple[list[str], list[int], Floats, float, Floats]:
    """Return names, parents, offsets, seconds per frame and the world places of all nodes."""
    lines = [line.strip() for line in path.read_text().splitlines()]
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    channels: list[tuple[int, str]] = []
    stack: list[int] = []
    start = lines.index("MOTION")
    for words in (line.split() for line in lines[:start]):
        if words[0] in ("ROOT", "JOINT", "End"):
            names.append(words[1])
            parents.append(stack[-1] if stack else -1)
        elif words[0] == "{":
            stack.append(len(names) - 1)
        elif words[0] == "}":
            stack.pop()
        elif words[0] == "OFFSET":
            offsets.append([float(word) for word in words[1:]])
        elif words[0] == "CHANNELS":
            assert int(words[1]) == len(words) - 2
            channels += [(len(names) - 1, word) for word in words[2:]]
    count = int(lines[start + 1].removeprefix("Frames: "))
    seconds = float(lines[start + 2].removeprefix("Frame Time: "))
    values = np.array([[float(w) for w in line.split()] for line in lines[start + 3 :]])
    assert values.shape == (count, len(channels))
    turns = [np.tile(np.eye(3), (count, 1, 1)) for _ in names]
    moves = np.tile(np.array(offsets), (count, 1, 1))
    for (node, channel), value in zip(channels, values.T, strict=True):
        if channel.endswith("position"):
            moves[:, node, "XYZ".index(channel[0])] = value
        else:
            turn = Rotation.from_euler(channel[0], value[:, None], degrees=True)
            turns[node] = turns[node] @ turn.as_matrix()
    world = np.zeros((count, len(names), 3))
    for node, parent in enumerate(parents):
        if parent < 0:
            world[:, node] = moves[:, node]
            continue
        world[:, node] = world[:, parent] + np.einsum("nab,nb->na", turns[parent], moves[:, node])
        turns[node] = turns[parent] @ turns[node]
    return names, parents, np.array(offsets), seconds, world


def test_bvh_puts_rigid_limbs_where_they_were(tmp_path: Path) -> None:
    alone = replace(TAKE, motions=(SECOND,))
    ((path, summary),) = export(alone, tmp_path / "walk.bvh", "bvh")
    assert "m, y up" in summary and summary.endswith("begins at 0.24 s")
    names, parents, offsets, seconds, world = read_bvh(path)
    assert seconds == pytest.approx(0.04)
    assert names[0] == "mid_hip" and parents.count(-1) == 1
    assert len(world) == len(SECOND)
    # A person at rest faces z, with y up and the left hand towards x.
    rest = np.zeros_like(offsets)
    for node, parent in enumerate(parents):
        rest[node] = offsets[node] + (rest[parent] if parent >= 0 else 0)
    assert rest[names.index("left_elbow"), 0] > 0.2
    assert rest[names.index("right_elbow"), 0] < -0.2
    checked = [(node, name) for node, name in enumerate(names) if name != "Site"]
    for node, name in checked:
        apart_mm = 1000 * np.linalg.norm(world[:, node] - joint(SECOND, name), axis=-1)
        assert apart_mm.max() < 0.1, name
    assert {*COCO17.joints[:5], *COCO17.joints[11:15]} <= {name for _, name in checked}
    ends = [world[:, node] for node, name in enumerate(names) if name == "Site"]
    for name in ("left_wrist", "right_wrist", "left_ankle", "right_ankle"):
        nearest = min(np.abs(end - joint(SECOND, name)).max() for end in ends)
        assert nearest < 1e-4, name


def test_bvh_keeps_a_rotation_that_no_frame_tells_and_says_so(tmp_path: Path) -> None:
    alone = replace(TAKE, motions=(FIRST,))
    ((path, summary),) = export(alone, tmp_path / "walk.bvh", "bvh")
    assert "4 of 40 frames keep" in summary
    *_, world = read_bvh(path)
    assert len(world) == NUM_FRAMES and np.isfinite(world).all()


def test_lengths_of_limbs_are_medians() -> None:
    rng = np.random.default_rng(0)
    joints = SECOND.joints_m + rng.normal(scale=0.01, size=SECOND.joints_m.shape)
    bones = bones_of(replace(SECOND, joints_m=joints), COCO17)
    node = bones.names.index("left_knee")
    lengths = np.linalg.norm(joints[:, 13] - joints[:, 11], axis=-1)
    assert np.linalg.norm(bones.offsets_m[node]) == pytest.approx(np.median(lengths))
    np.testing.assert_allclose(np.linalg.det(bones.rotations), 1.0, atol=1e-9)


def test_somebody_without_hips_cannot_be_bones(tmp_path: Path) -> None:
    joints = FIRST.joints_m.copy()
    joints[:, 11] = np.nan
    ids, sigma_m = np.full(len(joints), 5), np.ones(joints.shape[:2])
    (nobody,) = motions_of(np.arange(len(joints)), People(ids, joints, sigma_m=sigma_m))
    with pytest.raises(InputError, match="track5: found no frame with both hips"):
        list(export(Take("w", COCO17, 0.04, (nobody,)), tmp_path / "w.glb", "gltf"))
    assert list(tmp_path.iterdir()) == []


class Gltf:
    """A file as pygltflib reads it, and where its nodes are at a time."""

    def __init__(self, path: Path) -> None:
        from pygltflib import GLTF2

        self.file: Any = GLTF2().load(str(path))
        self.blob: bytes = self.file.binary_blob() or self.file.get_data_from_buffer_uri(
            self.file.buffers[0].uri
        )
        self.names = [node.name for node in self.file.nodes]
        nodes = enumerate(self.file.nodes)
        self.parents = {child: index for index, node in nodes for child in node.children}
        (animation,) = self.file.animations
        self.keys: dict[tuple[int, str], tuple[Floats, Floats, str]] = {}
        for channel in animation.channels:
            sampler = animation.samplers[channel.sampler]
            times, values = self.array(sampler.input)[:, 0], self.array(sampler.output)
            assert (np.diff(times) > 0).all()
            target = channel.target.node, channel.target.path
            self.keys[target] = times, values, sampler.interpolation

    def array(self, index: int) -> Floats:
        accessor = self.file.accessors[index]
        view = self.file.bufferViews[accessor.bufferView]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor.type]
        kind = {5126: "<f4", 5123: "<u2"}[accessor.componentType]
        found = np.frombuffer(self.blob, kind, accessor.count * width, view.byteOffset)
        return found.reshape(accessor.count, width).astype(np.float64)

    def value(self, node: int, path: str, time_s: float, otherwise: list[float]) -> Floats:
        if (node, path) not in self.keys:
            return np.array(otherwise)
        times, values, between = self.keys[node, path]
        if between == "STEP":
            return np.asarray(values[max(int(np.searchsorted(times, time_s + 1e-6)) - 1, 0)])
        return np.asarray(values[int(np.abs(times - time_s).argmin())])

    def world(self, node: int, time_s: float) -> tuple[Floats, Floats]:
        """Return the linear part and the place of a node."""
        above, start = np.eye(3), np.zeros(3)
        if node in self.parents:
            above, start = self.world(self.parents[node], time_s)
        rest = self.file.nodes[node].translation or [0.0, 0.0, 0.0]
        move = self.value(node, "translation", time_s, rest)
        x, y, z, w = self.value(node, "rotation", time_s, [0.0, 0.0, 0.0, 1.0])
        turn = Rotation.from_quat([x, y, z, w]).as_matrix()
        size = self.value(node, "scale", time_s, [1.0, 1.0, 1.0])
        return above @ turn @ np.diag(size), start + above @ move


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_gltf_moves_joints_and_hides_who_is_away(tmp_path: Path, suffix: str) -> None:
    ((path, summary),) = export(TAKE, tmp_path / f"walk{suffix}", "gltf")
    assert "2 people" in summary and "4 of 74 frames without a key" in summary
    file = Gltf(path)
    for motion, name in ((FIRST, "track3"), (SECOND, "track7")):
        for frame in (0, 7, 15, 33):
            time_s = (motion.first + frame) / 25
            for part in ("mid_hip", "neck", "left_elbow", "right_wrist", "left_ankle", "nose"):
                node = file.names.index(f"{name}_{part}")
                _, place = file.world(node, time_s)
                assert 1000 * np.linalg.norm(place - joint(motion, part)[frame]) < 0.5, part
    top = file.names.index("track7")
    shown = [file.value(top, "scale", frame / 25, [])[0] for frame in (5, 6, 39, 40)]
    assert shown == [0.0, 1.0, 1.0, 0.0]  # from frame 6 to the end
    keys = file.keys.get((file.names.index("track3_left_elbow"), "rotation"))
    assert keys is not None
    assert len(keys[0]) == NUM_FRAMES - (MISSING_FRAMES.stop - MISSING_FRAMES.start)


def test_gltf_skin_keeps_the_mesh_at_rest(tmp_path: Path) -> None:
    ((path, _),) = export(TAKE, tmp_path / "walk.glb", "gltf")
    file = Gltf(path)
    skin = file.file.skins[0]
    inverse = file.array(skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
    mesh = file.file.meshes[0].primitives[0]
    weights, owners = file.array(mesh.attributes.WEIGHTS_0), file.array(mesh.attributes.JOINTS_0)
    assert (weights.sum(axis=1) == 1).all() and owners.max() < len(skin.joints)
    corners = file.array(mesh.attributes.POSITION)
    assert file.array(mesh.indices).max() < len(corners)
    # A corner at a bone's start is the place of its joint: bound, it lies at the joint's origin.
    bind = inverse[owners[::6, 0].astype(int)]
    bound = np.einsum("nab,nb->na", bind[:, :3, :3], corners[::6]) + bind[:, :3, 3]
    np.testing.assert_allclose(bound, 0.0, atol=1e-6)


def gripping() -> Take:
    """Return somebody who bends wrists and fingers, and whose fingers are lost for a while."""
    whole = SKELETONS["coco133"]
    places, time = add_joints(walking(), whole), np.arange(NUM_FRAMES)
    for side in SIDES:
        wrist, first, last = (
            places[:, whole.index(f"{side}_{part}")].copy()
            for part in ("wrist", "index1", "pinky1")
        )
        aside = (first - last) / np.linalg.norm(first - last, axis=1)[:, None]
        bend = Rotation.from_rotvec((0.4 + 0.3 * np.sin(time / 5))[:, None] * aside)
        root = whole.index(f"{side}_hand_root")
        places[:, root] = wrist + bend.apply(places[:, root] - wrist)
        for finger in FINGERS:
            chain = [whole.index(f"{side}_{finger}{i}") for i in range(1, 5)]
            parts = np.diff(places[:, chain], axis=1, prepend=wrist[:, None])
            turn = bend
            for place, part in zip(chain, parts.swapaxes(0, 1), strict=True):
                places[:, place] = turn.apply(part) + (
                    wrist if place == chain[0] else places[:, place - 1]
                )
                turn = bend * turn
    places[10:14, whole.index("left_index3")] = np.nan
    places[[20, 30], whole.index("left_middle1")] = np.nan  # and not what hangs on it
    places[22:25, whole.index("left_wrist") : whole.index("right_wrist")] = np.nan
    ids, sigma_m = np.full(NUM_FRAMES, 2), np.ones(places.shape[:2])
    return Take(
        "w", whole, 0.04, motions_of(np.arange(NUM_FRAMES), People(ids, places, sigma_m=sigma_m))
    )


def test_fingers_turn_and_are_where_they_were(tmp_path: Path) -> None:
    person = gripping()
    (motion,), whole = person.motions, person.skeleton
    for name in ("walk.bvh", "walk.glb"):
        list(export(person, tmp_path / name, name[-3:].replace("glb", "gltf")))
    names, _, offsets, _, world = read_bvh(tmp_path / "walk.bvh")
    file = Gltf(tmp_path / "walk.glb")
    for side in SIDES:
        for number in range(1, 5):
            for finger in FINGERS:
                part = f"{side}_{finger}{number}"
                wanted = y_up(motion.joints_m[:, whole.index(part)])
                known = np.isfinite(wanted).all(axis=1)
                node = file.names.index(f"track2_{part}")
                shown = np.array([file.world(node, frame / 25)[1] for frame in range(NUM_FRAMES)])
                for found in (world[:, names.index(part)], shown):
                    assert np.abs(found - wanted)[known].max() < 1e-4, part
                keys = file.keys.get((node, "translation"))
                assert keys is not None
                off_mm = 1000 * np.abs(keys[1] - file.file.nodes[node].translation)
                assert np.median(off_mm) < 0.1, part  # turns bring it there
                if number < 4:
                    assert (node, "rotation") in file.keys
    rest = {name: offset for name, offset in zip(names, offsets, strict=True) if name != "Site"}
    assert rest["left_index2"][0] > 0.03 and rest["right_index2"][0] < -0.03  # in a T-pose
    assert rest["left_thumb2"][2] > 0.01 < rest["right_thumb2"][2]


def no_detectors_person() -> Take:
    """Return somebody whose hips are below the middle of the hips and behind it, and shoulders."""
    joints = [HALPE26.index(name) for name in COCO17.joints]
    joints_m = np.full((NUM_FRAMES, len(HALPE26), 3), np.nan)
    joints_m[:, joints] = walking()
    hips = walking()[:, [11, 12]]
    across = np.diff(hips, axis=1)[:, 0]
    ahead = np.cross(across, [0, 0, 1.0])
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    joints_m[:, HALPE26.index("mid_hip")] = hips.mean(axis=1) + 0.02 * ahead + [0, 0, 0.06]
    shoulders = walking()[:, [5, 6]].mean(axis=1)
    joints_m[:, HALPE26.index("neck")] = shoulders + 0.01 * ahead + [0, 0, 0.05]
    ids, sigma_m = np.full(NUM_FRAMES, 2), np.ones(joints_m.shape[:2])
    motions = motions_of(np.arange(NUM_FRAMES), People(ids, joints_m, sigma_m=sigma_m))
    return Take("w", HALPE26, 0.04, motions)


def test_hips_and_shoulders_hang_where_they_are(tmp_path: Path) -> None:
    person = no_detectors_person()
    ((path, _),) = export(person, tmp_path / "walk.bvh", "bvh")
    names, _, offsets, _, world = read_bvh(path)
    (motion,) = person.motions
    for name in ("mid_hip", "left_hip", "right_knee", "left_shoulder", "right_elbow"):
        place = y_up(motion.joints_m[:, HALPE26.index(name)])
        apart_mm = 1000 * np.linalg.norm(world[:, names.index(name)] - place, axis=-1)
        assert apart_mm.max() < 2.0, (name, apart_mm.max())
    for side, sign in (("left", 1), ("right", -1)):
        x, y, z = offsets[names.index(f"{side}_hip")]
        assert sign * x > 0.05 and -0.07 < y < -0.05 and abs(z) < 0.04, (x, y, z)


@each_case(
    ("rig", "arm", "hips", "finger"),
    [
        ("vrm", "leftUpperArm", "hips", "leftLittleIntermediate"),
        ("mixamo", "mixamorig:LeftArm", "mixamorig:Hips", "mixamorig:LeftHandPinky2"),
        ("unreal", "upperarm_l", "pelvis", "pinky_02_l"),
    ],
)
def test_bones_have_a_rig_s_names(
    tmp_path: Path, rig: str, arm: str, hips: str, finger: str
) -> None:
    list(export(gripping(), tmp_path / "hand.bvh", "bvh", ExportSettings(names=rig)))
    assert finger in read_bvh(tmp_path / "hand.bvh")[0]
    alone = replace(TAKE, motions=(SECOND,))
    settings = ExportSettings(names=rig)
    list(export(alone, tmp_path / "walk.bvh", "bvh", settings))
    names, *_ = read_bvh(tmp_path / "walk.bvh")
    assert names[0] == hips and arm in names
    assert {name.lower().split(":")[-1] for name in names} & {"lefthand", "hand_l"}
    assert len(names) == len(set(names) - {"Site"}) + 6  # ends of hands, feet and ears
    list(export(TAKE, tmp_path / "walk.glb", "gltf", settings))
    file = Gltf(tmp_path / "walk.glb")
    assert file.names.count(arm) == 2 and "track3" in file.names
    skins = [{file.names[node] for node in skin.joints} for skin in file.file.skins]
    assert len(skins) == 2 and skins[0] == skins[1] and {arm, hips} <= skins[0]
