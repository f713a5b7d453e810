"""COCO keypoint results or annotations: one JSON file over all cameras and frames."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import TypeVar

import msgspec
import numpy as np

from e3pose.base.bounded import decode_json, read_bytes
from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording
from e3pose.recording.calibration import load_rig
from e3pose.recording.detections.openpose import frame_number
from e3pose.recording.detections.views import check_fps, poses_from_triples, series_from_frames

EXPECTED = "COCO keypoint results"
MAX_FILE_BYTES = 1 * 2**30
PERSON = 1  # COCO's category


class _Result(msgspec.Struct):
    keypoints: list[float]
    image_id: int | str | None = None
    file_name: str | None = None
    category_id: int = PERSON
    scores: list[float] | None = None  # as `e3pose export` writes them

    def triples(self) -> list[list[float]]:
        """Return x, y and score of the keypoints; without scores, a labelled keypoint has 1.

        The third number of a result is a score; of an annotation, a flag: 0 not labelled, 1
        labelled, 2 visible.
        """
        triples = [self.keypoints[i : i + 3] for i in range(0, len(self.keypoints), 3)]
        flags = [triple[2] for triple in triples]
        if not {*flags} <= {0, 1, 2} or (self.scores is None and 2 not in flags):
            return triples
        scores = self.scores if len(self.scores or ()) == len(flags) else None
        return [
            [x, y, (1.0 if scores is None else scores[i]) if flag else 0.0]
            for i, (x, y, flag) in enumerate(triples)
        ]


class _Image(msgspec.Struct):
    id: int | str
    file_name: str


class _Dataset(msgspec.Struct):
    images: list[_Image]
    annotations: list[_Result] = []


_Frame = tuple[int, int]  # camera index, frame number
_T = TypeVar("_T")


def import_coco(
    source: Path,
    calibration: Path,
    fps: float,
    images: Path | None = None,
    detector: str = "",
) -> Recording:
    """Read COCO keypoint results or annotations.

    Args:
        source: a list of results `{"image_id", "category_id", "keypoints": [51 numbers]}`, or a
            COCO dataset with `images` and `annotations`.
        calibration: the rig, in any format that `e3pose.recording.calibration` reads.
        fps: frames per second of the cameras.
        images: a COCO dataset whose `images` translates `image_id` to `file_name`; without it,
            `image_id` or `file_name` of a result must be the file name itself.
        detector: what made the results; empty if unknown.

    Returns:
        A recording. File names are `<camera>/<frame>.<suffix>`, perhaps within other folders. With
        a table of images, an image without a result is an empty view and a frame without an image a
        lost one; without a table every frame without a result counts as empty, as results do not
        tell.

    Raises:
        InputError: naming the file, entry and field that is wrong.
    """
    check_fps(fps)
    rig = load_rig(calibration)
    results, table = _read_results(source)
    if images is not None:
        content = read_bytes(images, MAX_FILE_BYTES)
        table = decode_json(_Dataset, content, images, EXPECTED).images
    found: dict[_Frame, list[list[list[float]]]] = {}
    by_id: dict[int | str, _Frame] = {}
    for index, image in enumerate(table or ()):
        where = f"{images or source}: images[{index}]"
        frame = _frame(rig, image.file_name, where)
        if image.id in by_id or frame in found:
            raise InputError(f"{where}: image {str(image.id)[:40]} appears twice")
        by_id[image.id] = frame
        found[frame] = []
    for index, result in enumerate(results):
        where = f"{source}: [{index}]"
        if result.category_id != PERSON:
            continue
        if len(result.keypoints) != 3 * len(COCO17):
            raise InputError(
                f"{where}.keypoints: found {len(result.keypoints)} numbers, expected 51 (COCO-17)"
            )
        found.setdefault(_frame_of(rig, result, by_id, where), []).append(result.triples())
    if table is None:
        numbers = [number for _, number in found]
        seen = range(min(numbers), max(numbers) + 1) if numbers else range(0)
        if len(seen) > 1000 + 100 * len(found):
            raise InputError(
                f"{source}: frame numbers: found {seen[0]} to {seen[-1]}, expected consecutive ones"
            )
        found = {(c, n): found.get((c, n), []) for c in range(len(rig)) for n in seen}
    frames: list[dict[int, Poses2D]] = [{} for _ in rig.camera_ids]
    for (camera, number), people in found.items():
        triples = np.array(people, dtype=np.float64).reshape(-1, len(COCO17), 3)
        where = f"{source}: camera {rig.camera_ids[camera]} frame {number}"
        frames[camera][number] = poses_from_triples(triples, where)
    num_slots, views = series_from_frames(frames, fps, len(COCO17), str(source))
    return Recording(
        name="".join(char for char in source.stem if char.isprintable())[:200],
        rig=rig,
        fps=fps,
        num_slots=num_slots,
        skeleton=COCO17,
        views=views,
        source="COCO keypoint results",
        detector=detector,
    )


def _read_results(source: Path) -> tuple[list[_Result], list[_Image] | None]:
    content = read_bytes(source, MAX_FILE_BYTES)
    if content[:1000].lstrip()[:1] == b"{":
        dataset = decode_json(_Dataset, content, source, EXPECTED)
        return dataset.annotations, dataset.images
    return decode_json(list[_Result], content, source, EXPECTED), None


def _frame_of(rig: Rig, result: _Result, by_id: Mapping[int | str, _Frame], where: str) -> _Frame:
    if result.image_id is not None and result.image_id in by_id:
        return by_id[result.image_id]
    if result.file_name is not None:
        return _frame(rig, result.file_name, where)
    if isinstance(result.image_id, str) and not by_id:
        return _frame(rig, result.image_id, where)
    raise InputError(
        f"{where}.image_id: found {str(result.image_id)[:80]!r}, expected an image of the images "
        "table (--images FILE) or <camera>/<frame>"
    )


def _frame(rig: Rig, file_name: str, where: str) -> _Frame:
    path = PurePosixPath(file_name.replace("\\", "/"))
    cameras = [index for index, name in enumerate(rig.camera_ids) if name in path.parent.parts]
    if len(cameras) != 1:
        raise InputError(
            f"{where}: file name: found {file_name[:120]!r}, expected <camera>/<frame> with a "
            f"camera of {', '.join(rig.camera_ids)}"
        )
    try:
        return cameras[0], frame_number(path.name)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
