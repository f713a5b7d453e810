"""Blender itself reads the bones that we write, where it is: as `blender`, or as the module bpy.

`pip install bpy` in an environment of its own serves too: BLENDER_PYTHON=its/bin/python.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.output.exports.takes import take

from e3pose.base.arrays import Floats
from e3pose.model.skeleton import COCO17
from e3pose.output.exports import export

pytestmark = pytest.mark.slow

START_S = 300
FRAMES = (0, 6, 15, 33)
ALONE = replace(take(), motions=take().motions[:1])  # from frame 0
# Bones reach from joint to joint: heads and tails in Blender's world, metres, z up.
SCRIPT = """
import json, sys
import bpy

path, frames = sys.argv[-2], json.loads(sys.argv[-1])
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.context.scene.render.fps = 25
if path.endswith(".bvh"):
    bpy.ops.import_anim.bvh(filepath=path, axis_up="Y", axis_forward="-Z", global_scale=1.0)
    first = 1
else:
    bpy.ops.import_scene.gltf(filepath=path)
    first = 0
found = {}
(armature,) = [one for one in bpy.context.scene.objects if one.type == "ARMATURE"]
for frame in frames:
    bpy.context.scene.frame_set(frame + first)
    found[frame] = {
        bone.name: [list(armature.matrix_world @ at) for at in (bone.head, bone.tail)]
        for bone in armature.pose.bones
    }
print("BONES " + json.dumps(found))
"""


def blender() -> list[str]:
    """Return how Blender runs a script; skip where it is not."""
    python = os.environ.get("BLENDER_PYTHON")
    if python:
        return [python]
    program = shutil.which("blender")
    if program is None:
        pytest.skip("no Blender here: expected the program blender, or BLENDER_PYTHON with bpy")
    return [program, "--background", "--factory-startup", "--python-exit-code", "1", "--python"]


def bones(folder: Path, path: Path) -> dict[int, dict[str, Floats]]:
    """Return, by frame, `(2, 3)` where bones begin and end as Blender has them."""
    script = folder / "read.py"
    script.write_text(SCRIPT)
    start = blender()
    words = [*start, str(script), *(["--"] if len(start) > 1 else []), str(path)]
    done = subprocess.run(
        [*words, json.dumps(FRAMES)], capture_output=True, text=True, timeout=START_S
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("BONES "))
    told = json.loads(line.removeprefix("BONES "))
    return {int(f): {n: np.array(at) for n, at in found.items()} for f, found in told.items()}


def apart_mm(found: dict[int, dict[str, Floats]], prefix: str = "") -> Floats:
    """Return how far limbs begin from where their joints are, in all frames."""
    motion, distances = ALONE.motions[0], []
    for frame, there in found.items():
        for name in ("elbow", "shoulder", "knee", "hip"):
            for side in ("left", "right"):
                joint = f"{side}_{name}"
                place = motion.joints_m[frame - motion.first, COCO17.index(joint)]
                distances.append(1000 * np.linalg.norm(there[prefix + joint][0] - place))
    return np.array(distances)


@pytest.mark.parametrize(
    ("name", "form", "prefix"), [("a.bvh", "bvh", ""), ("a.glb", "gltf", "track3_")]
)
def test_bones_stand_where_people_stood(tmp_path: Path, name: str, form: str, prefix: str) -> None:
    ((path, _),) = export(ALONE, tmp_path / name, form)
    assert apart_mm(bones(tmp_path, path), prefix).max() < 0.5
