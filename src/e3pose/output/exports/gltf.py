"""Animated glTF 2.0: skinned skeletons of everybody in one file; metres, y up.

A person is a node that is shown (scale 1) or hidden (scale 0), a skin with a joint a bone, and a
mesh of one slim octahedron a bone, so that any viewer shows something. `.glb` is one binary file,
`.gltf` text with the numbers inside. A channel has keys only for frames that tell its value; what
lies between keys is the viewer's interpolation, not ours.
"""

from __future__ import annotations

import base64
import colorsys
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose import __version__
from e3pose.base.arrays import Flags, Floats
from e3pose.base.atomic import atomic_file
from e3pose.base.quantities import plural
from e3pose.model.take import Take
from e3pose.output.exports.base import ExportSettings, person_name
from e3pose.output.exports.bone_names import bone_names
from e3pose.output.exports.bones import Bones, count_held, present, rest_places, stretches_of

THICKNESS = 0.09  # of a bone, as a share of its length
POINTS = 9  # nodes on one, as of a face, that are no bones to be drawn
FLOAT, USHORT = 5126, 5123  # component types
ARRAY, ELEMENTS = 34962, 34963  # buffer targets
# Corners of an octahedron along y: both ends and a belt near the first, and its triangles.
CORNERS = np.array(
    [[0, 0, 0], [1, 0.15, 0], [0, 0.15, 1], [-1, 0.15, 0], [0, 0.15, -1], [0, 1, 0]], dtype=float
)
TRIANGLES = np.array(
    [
        [0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1],
        [5, 2, 1], [5, 3, 2], [5, 4, 3], [5, 1, 4],
    ]
)  # fmt: skip


def write_gltf(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write all people of a take; time 0 is the first frame of the take."""
    scene = _Scene()
    first, kept = take.span[0], 0
    for motion in settings.progress(take.motions, len(take.motions), "write"):
        times_s = (motion.first - first + np.arange(len(motion))) * take.interval_s
        keys = _Keys()
        for begin, bones in stretches_of(motion, take.skeleton):
            keys.add(bones, times_s[begin : begin + len(bones.root_m)])
            kept += count_held(bones)
        scene.add_person(motion.track_id, bones, keys, times_s, take.interval_s, settings.names)
    document, blob = scene.document(), scene.blob
    with atomic_file(dest, private=True) as temporary, temporary.open("wb") as file:
        if dest.suffix.lower() == ".gltf":
            uri = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
            document["buffers"][0]["uri"] = uri
            file.write(json.dumps(document).encode())
        else:
            file.writelines(_binary(document, blob))
    frames = sum(map(len, take.motions))
    note = f"; {kept} of {frames} frames without a key for some bone" if kept else ""
    return f"metres, y up, {plural(len(take.motions), 'person', 'people')}{note}"


class _Keys:
    """Keys of one person, gathered from stretches of frames."""

    def __init__(self) -> None:
        self.turning: set[int] = set()  # nodes whose rotation some frame shows
        self.there: list[Flags] = []  # whether each frame has the root
        self._parts: dict[tuple[str, int], list[tuple[Floats, NDArray[Any]]]] = {}

    def add(self, bones: Bones, times_s: Floats) -> None:
        self.there.append(present(bones.root_m))
        self._put("root", 0, times_s, bones.root_m, self.there[-1])
        for node in range(len(bones.names)):
            keyed = bones.keyed(node)
            if keyed.any():
                turned = quaternions(bones.rotations[keyed, node])
                self._put("rotation", node, times_s[keyed], turned, slice(None))
            if bones.measured[:, node].any():
                self.turning.add(node)
        for node, places_m in bones.moved_m.items():
            self._put("translation", node, times_s, places_m, present(places_m))

    def of(self, path: str, node: int) -> tuple[Floats, NDArray[Any]]:
        """Return times and values of a node."""
        times_s, values = zip(*self._parts[path, node], strict=True)
        return np.concatenate(times_s), np.concatenate(values)

    def _put(
        self, path: str, node: int, times_s: Floats, values: Floats, rows: Flags | slice
    ) -> None:
        part = times_s[rows], values[rows].astype("<f4")  # as the file has them
        self._parts.setdefault((path, node), []).append(part)


class _Scene:
    """A document that grows by people, and the numbers that it points into."""

    def __init__(self) -> None:
        self.blob = bytearray()
        self.nodes: list[dict[str, Any]] = []
        self.roots: list[int] = []
        self.meshes: list[dict[str, Any]] = []
        self.skins: list[dict[str, Any]] = []
        self.materials: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.samplers: list[dict[str, Any]] = []
        self.channels: list[dict[str, Any]] = []

    def document(self) -> dict[str, Any]:
        return {
            "asset": {"version": "2.0", "generator": f"e3pose {__version__}"},
            "scene": 0,
            "scenes": [{"nodes": self.roots}],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "skins": self.skins,
            "materials": self.materials,
            "animations": [{"name": "take", "samplers": self.samplers, "channels": self.channels}],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.blob)}],
        }

    def add_person(
        self,
        track_id: int,
        bones: Bones,
        keys: _Keys,
        times_s: Floats,
        interval_s: float,
        rig: str | None,
    ) -> None:
        name, base = person_name(track_id), len(self.nodes)
        top, skinned = base + len(bones.names), base + len(bones.names) + 1
        for node, joint in enumerate(bone_names(bones.names, rig)):
            # A rig's names are exact, and everybody has an armature of their own.
            entry: dict[str, Any] = {"name": f"{name}_{joint}" if rig is None else joint}
            if children := bones.children(node):
                entry["children"] = [base + child for child in children]
            entry["translation"] = bones.offsets_m[node].tolist()
            self.nodes.append(entry)
        hue = len(self.skins) * 0.618 % 1
        colour = [*colorsys.hsv_to_rgb(hue, 0.6, 0.9), 1.0]
        self.materials.append(
            {"name": name, "doubleSided": True, "pbrMetallicRoughness": {
                "baseColorFactor": colour, "metallicFactor": 0.0, "roughnessFactor": 0.8}}
        )  # fmt: skip
        self.meshes.append({"name": name, "primitives": [self._mesh(bones)]})
        joints = list(range(base, top))
        rest = rest_places(bones.parents, bones.offsets_m)
        inverse = np.tile(np.eye(4), (len(rest), 1, 1))
        inverse[:, 3, :3] = -rest  # by columns, as the format has it
        skin = {"joints": joints, "skeleton": base, "inverseBindMatrices": self._floats(inverse)}
        self.skins.append(skin)
        self.nodes.append({"name": name, "children": [base]})
        self.nodes.append(
            {"name": f"{name}_mesh", "mesh": len(self.meshes) - 1, "skin": len(self.skins) - 1}
        )
        self.roots += [top, skinned]
        self._channel(base, "translation", *keys.of("root", 0))
        for node in sorted(keys.turning):
            keyed_s, turned = keys.of("rotation", node)
            self._channel(base + node, "rotation", keyed_s, continuous(turned))
        for node in bones.moved_m:
            self._channel(base + node, "translation", *keys.of("translation", node))
        there = np.concatenate(keys.there)
        # Hidden before, after and wherever nobody knows where the hips are.
        edges = np.flatnonzero(np.diff(there.astype(np.int8), prepend=0, append=0))
        edges_s = np.append(times_s, times_s[-1] + interval_s)[edges]
        shown = np.tile([[1.0], [0.0]], (len(edges) // 2, 3))
        if edges_s[0] > 0:
            edges_s, shown = np.append(0.0, edges_s), np.concatenate([np.zeros((1, 3)), shown])
        self._channel(top, "scale", edges_s, shown, "STEP")

    def _channel(
        self, node: int, path: str, times_s: Floats, values: Floats, between: str = "LINEAR"
    ) -> None:
        sampler = {
            "input": self._floats(times_s, bounds=True),
            "output": self._floats(values),
            "interpolation": between,
        }
        target = {"node": node, "path": path}
        self.channels.append({"sampler": len(self.samplers), "target": target})
        self.samplers.append(sampler)

    def _mesh(self, bones: Bones) -> dict[str, Any]:
        """Return an octahedron for each bone, moved by the node that it starts at."""
        rest = rest_places(bones.parents, bones.offsets_m)
        ends = np.flatnonzero(bones.parents >= 0)
        ends = ends[np.linalg.norm(bones.offsets_m[ends], axis=1) > 1e-6]
        counts = np.bincount(bones.parents[bones.parents >= 0], minlength=len(rest))
        ends = ends[counts[bones.parents[ends]] < POINTS]
        corners, owners = [], []
        for node in ends.tolist():
            start, along = rest[bones.parents[node]], bones.offsets_m[node]
            length = float(np.linalg.norm(along))
            side = np.cross(along, [0.0, 0, 1] if abs(along[2]) < 0.9 * length else [1.0, 0, 0])
            side *= THICKNESS * length / np.linalg.norm(side)
            other = np.cross(along, side) / length
            corners.append(start + CORNERS @ np.stack([side, along, other]))
            owners.append(np.full(len(CORNERS), bones.parents[node]))
            owners[-1][-1] = node if node in bones.moved_m else bones.parents[node]
        joints = np.zeros((len(ends) * len(CORNERS), 4))
        joints[:, 0] = np.concatenate(owners)
        weights = np.zeros_like(joints)
        weights[:, 0] = 1.0
        triangles = np.arange(len(ends))[:, None, None] * len(CORNERS) + TRIANGLES
        return {
            "attributes": {
                "POSITION": self._floats(np.concatenate(corners), target=ARRAY, bounds=True),
                "JOINTS_0": self._shorts(joints, ARRAY, "VEC4"),
                "WEIGHTS_0": self._floats(weights, target=ARRAY),
            },
            "indices": self._shorts(triangles.ravel(), ELEMENTS, "SCALAR"),
            "material": len(self.materials) - 1,
        }

    def _floats(self, values: Floats, target: int | None = None, bounds: bool = False) -> int:
        kind = {1: "SCALAR", 3: {4: "MAT4"}.get(values.shape[-1], "VEC3")}.get(values.ndim)
        kind = kind or f"VEC{values.shape[-1]}"
        stored = values.astype("<f4")
        flat = stored.reshape(len(stored), -1)
        limits = (
            {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()} if bounds else {}
        )
        return self._accessor(stored.tobytes(), FLOAT, len(stored), kind, target, limits)

    def _shorts(self, values: NDArray[Any], target: int, kind: str) -> int:
        stored = values.astype("<u2")
        return self._accessor(stored.tobytes(), USHORT, len(stored), kind, target, {})

    def _accessor(
        self,
        content: bytes,
        component: int,
        count: int,
        kind: str,
        target: int | None,
        limits: dict[str, Any],
    ) -> int:
        view: dict[str, Any] = {
            "buffer": 0,
            "byteOffset": len(self.blob),
            "byteLength": len(content),
        }
        if target is not None:
            view["target"] = target
        self.blob += content + bytes(-len(content) % 4)
        self.views.append(view)
        entry = {"componentType": component, "count": count, "type": kind, **limits}
        self.accessors.append({"bufferView": len(self.views) - 1, **entry})
        return len(self.accessors) - 1


def quaternions(rotations: Floats) -> Floats:
    """Return `(num_frames, 4)` unit quaternions x, y, z, w, each near the one before.

    Args:
        rotations: `(num_frames, 3, 3)`.
    """
    from scipy.spatial.transform import Rotation

    return continuous(Rotation.from_matrix(rotations).as_quat())


def continuous(found: NDArray[Any]) -> NDArray[Any]:
    """Return `(num_frames, 4)` quaternions, each of the sign that is near the one before."""
    flips = np.sign((found[1:] * found[:-1]).sum(axis=1))
    found[1:] *= np.cumprod(np.where(flips < 0, -1, 1)).astype(found.dtype)[:, None]
    return found


def _binary(document: dict[str, Any], blob: bytearray) -> tuple[bytes | bytearray, ...]:
    """Return the parts of a .glb file, as section 4.4 of the specification has them."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)  # every accessor fills whole words of the other chunk
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(blob))
    head += struct.pack("<I4s", len(text), b"JSON") + text
    return head, struct.pack("<I4s", len(blob), b"BIN\0"), blob
