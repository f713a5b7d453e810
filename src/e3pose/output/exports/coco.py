"""COCO JSON: images, and people in them as 17 keypoints; needs a calibration.

Images are called `CAMERA/FRAME.jpg`, though nobody made them. A keypoint's third number is COCO's
visibility: 2 inside the image and measured in the frame, 1 inside and predicted or filled, 0
missing. `track_id` and `scores` are fields beside COCO's own.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from e3pose.base.atomic import write_file
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.model.skeleton import COCO17, unused
from e3pose.model.take import MEASURED, Take
from e3pose.output.exports.base import ExportSettings
from e3pose.output.exports.views import frames, keypoints


def write_coco(take: Take, dest: Path, settings: ExportSettings) -> str:
    """Write all people of a take, projected into each camera.

    Raises:
        InputError: without cameras.
    """
    if settings.rig is None:
        raise InputError(
            "coco: found no cameras, expected --calibration FILE: COCO's keypoints are pixels"
        )
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    found = frames(take, COCO17)
    for slot, people in settings.progress(found, len(found), "write"):
        for camera in settings.rig.cameras:
            width, height = camera.image_size
            name = f"{camera.camera_id}/{slot:012d}.jpg"
            image = {"id": len(images) + 1, "file_name": name, "width": width, "height": height}
            images.append(image)
            for track_id, points in zip(
                people.track_ids.tolist(), keypoints(people, camera), strict=True
            ):
                inside = points[:, 2] > 0
                if not inside.any():
                    continue
                low, high = points[inside, :2].min(axis=0), points[inside, :2].max(axis=0)
                sure = _measured(take, track_id, slot)
                flags = np.where(inside, np.where(sure, 2, 1), 0)
                numbers = [
                    value
                    for (x, y, _), flag in zip(points.round(3).tolist(), flags, strict=True)
                    for value in (x, y, int(flag))
                ]
                box = np.concatenate([low, high - low])
                annotations.append(
                    {
                        "id": len(annotations) + 1,
                        "image_id": image["id"],
                        "category_id": 1,
                        "keypoints": numbers,
                        "num_keypoints": int(inside.sum()),
                        "bbox": box.round(3).tolist(),
                        "area": round(float(box[2] * box[3]), 3),
                        "iscrowd": 0,
                        "track_id": track_id,
                        "scores": points[:, 2].round(4).tolist(),
                    }
                )
    edges = [[a + 1, b + 1] for a, b in COCO17.limbs]
    person = {"id": 1, "name": "person", "supercategory": "person"}
    document = {
        "info": {"description": take.name, "version": "1.0"},
        "images": images,
        "annotations": annotations,
        "categories": [{**person, "keypoints": COCO17.joints, "skeleton": edges}],
    }
    write_file(dest, msgspec.json.encode(document), private=True)
    left = unused(take.skeleton.joints, COCO17.joints)
    people = plural(len(annotations), "person", "people")
    note = f"{len(images)} images of {len(settings.rig)} cameras, {people}"
    return note + (f"; {left}" if left else "")


def _measured(take: Take, track_id: int, slot: int) -> list[bool]:
    """Return which COCO joints of a person a view of the frame measured."""
    (motion,) = (motion for motion in take.motions if motion.track_id == track_id)
    row, names = motion.origin[slot - motion.first], take.skeleton.joints
    return [n in names and bool(row[names.index(n)] == MEASURED) for n in COCO17.joints]
