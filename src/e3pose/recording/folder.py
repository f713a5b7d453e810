"""A recording as a folder; `docs/reference/recording-format.md` describes every file."""

from __future__ import annotations

import math
import os
from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import tomli_w
from numpy.typing import NDArray

from e3pose.base.atomic import atomic_folder
from e3pose.base.bounded import read_lines, read_toml
from e3pose.base.errors import InputError
from e3pose.base.table import read_table
from e3pose.model.camera_fields import check_camera_id
from e3pose.model.noises.shipped import DEFAULT, detector_of
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import NAME, SHIPPED, Skeleton, load_skeleton, skeleton_table
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.recording.json_lines import decode_truth, decode_view, encode_truth, encode_view
from e3pose.recording.processor import load_processor, save_processor
from e3pose.recording.record import MAX_PEOPLE, Recording, Truth, ViewSeries

FORMAT = "e3pose-recording"
VERSIONS = (1, 2, 3)  # 2 has batteries or deaths of cameras, 3 the detector
HEADER = "recording.toml"
RIG = "calibration.toml"
TRUTH = "truth.jsonl"
SKELETON = "skeleton-{}.toml"  # of a skeleton of the user's own, by its name
MAX_HEADER_BYTES = 2**20
MAX_LINES_BYTES = 8 * 2**30
MAX_TRUTH_VALUES = 2**27  # 1 GiB of float64


class TruthHeader(msgspec.Struct, forbid_unknown_fields=True):
    """The part of recording.toml about the truth."""

    skeleton: str
    person_ids: list[str]
    complete: bool = True


class Header(msgspec.Struct, forbid_unknown_fields=True):
    """The content of recording.toml."""

    format: Literal["e3pose-recording"]
    version: Literal[1, 2, 3]
    name: str
    fps: float
    num_slots: int
    skeleton: str
    source: str = ""
    scored_slots: tuple[int, int] | None = None
    frames: dict[str, int] | None = None
    truth: TruthHeader | None = None
    videos: dict[str, str] = {}
    battery_wh: dict[str, float] = {}
    dies_at_s: dict[str, float] = {}
    detector: str = ""


def load_recording(path: Path | str) -> Recording:
    """Load a recording folder.

    Args:
        path: the folder, which holds `recording.toml`.

    Raises:
        InputError: one line naming the file, line and field that is wrong.
    """
    folder = Path(path)
    if not folder.is_dir():
        what = "found a file" if folder.exists() else "no such folder"
        raise InputError(f"{folder}: {what}, expected a recording folder")
    if not (folder / HEADER).exists():
        raise InputError(f"{folder}: found a folder without {HEADER}, expected a recording folder")
    header = _read_header(folder / HEADER)
    rig = load_rig(folder / RIG)
    skeleton = _skeleton(folder / HEADER, header.skeleton)
    _check_cameras(folder, header, rig.camera_ids)
    frames = header.frames
    views = tuple(
        read_series(
            folder / "keypoints" / f"{check_camera_id(camera_id)}.jsonl",
            num_joints=len(skeleton),
            num_slots=header.num_slots,
            num_frames=None if frames is None else frames.get(camera_id, 0),
        )
        for camera_id in rig.camera_ids
    )
    truth = None
    if header.truth is not None:
        truth = _read_truth(folder / TRUTH, header.truth, header.num_slots)
    elif (folder / TRUTH).exists():
        raise InputError(f"{folder / HEADER}: truth: missing, expected a table for {TRUTH}")
    processor = load_processor(folder, rig.camera_ids)
    try:
        return Recording(
            name=header.name,
            rig=rig,
            fps=header.fps,
            num_slots=header.num_slots,
            skeleton=skeleton,
            views=views,
            truth=truth,
            truth_complete=header.truth.complete if header.truth else True,
            scored_slots=header.scored_slots,
            videos=header.videos,
            source=header.source,
            battery_wh=header.battery_wh,
            dies_at_s=header.dies_at_s,
            detector=header.detector,
            processor=processor,
        )
    except InputError as error:
        raise InputError(f"{folder / HEADER}: {error}") from None


def read_skeleton(path: Path | str) -> Skeleton:
    """Return the skeleton of a recording's keypoints; raise `InputError` if it is none."""
    header = Path(path) / HEADER
    return _skeleton(header, _read_header(header).skeleton)


def read_detector(path: Path | str) -> str:
    """Return the detector of a recording's keypoints, empty if unknown.

    Raises:
        InputError: when there is no recording at `path`.
    """
    found = detector_of(_read_header(Path(path) / HEADER))
    return "" if found == DEFAULT else found


def save_recording(recording: Recording, path: Path | str, overwrite: bool = False) -> None:
    """Write a recording folder, whole or not at all.

    Args:
        recording: what to write. Videos are referred to, not copied.
        path: the folder to make; its parents are made too.
        overwrite: whether to replace a recording that stands there, with all that is in it.

    Raises:
        InputError: when `path` is not free, or a value cannot be written.
    """
    with atomic_folder(Path(path), overwrite=overwrite, ours=(HEADER,)) as folder:
        save_rig(recording.rig, folder / RIG)
        (folder / "keypoints").mkdir()
        for camera_id, series in zip(recording.rig.camera_ids, recording.views, strict=True):
            with (folder / "keypoints" / f"{camera_id}.jsonl").open("wb") as file:
                for slot, time_s in zip(
                    series.slots.tolist(), series.times_s.tolist(), strict=True
                ):
                    view = series.view(slot)
                    file.write(encode_view(slot, time_s, view or Poses2D.empty(0)))
        if recording.truth is not None:
            with (folder / TRUTH).open("wb") as file:
                for slot, joints_m in enumerate(recording.truth.joints_m):
                    file.write(encode_truth(slot, recording.truth.person_ids, joints_m))
        save_processor(folder, recording.processor)
        save_skeleton(folder, recording.skeleton)
        if recording.truth is not None:
            save_skeleton(folder, recording.truth.skeleton)
        (folder / HEADER).write_bytes(tomli_w.dumps(_header(recording)).encode())


def save_skeleton(folder: Path, skeleton: Skeleton) -> None:
    """Write a skeleton that is not one of e3pose into the folder of a recording."""
    if skeleton.name not in SHIPPED:
        content = tomli_w.dumps(skeleton_table(skeleton)).encode()
        (folder / SKELETON.format(skeleton.name)).write_bytes(content)


def put_header(folder: Path, table: dict[str, Any]) -> None:
    """Write a header in place of the one before, which a full disk leaves as it is."""
    written = folder / f"{HEADER}.new"
    try:
        written.write_text(tomli_w.dumps(table), encoding="utf-8")
        os.replace(written, folder / HEADER)
    finally:
        written.unlink(missing_ok=True)


def read_series(
    path: Path, num_joints: int, num_slots: int, num_frames: int | None = None
) -> ViewSeries:
    """Read one camera's `keypoints/<camera_id>.jsonl`.

    Args:
        path: the file.
        num_joints: joints of the skeleton.
        num_slots: length of the recording; slots must rise and stay below it.
        num_frames: lines to expect, or None to take at least one.

    Raises:
        InputError: naming the file and line.
    """
    slots, times_s, counts = list[int](), list[float](), [0]
    keypoints_px, scores = array("d"), array("d")  # grow in their place
    last = -1
    for number, line in read_lines(path, MAX_LINES_BYTES):
        where = f"{path}:{number}"
        slot, time_s, view = decode_view(line, num_joints, where)
        if not last < slot < num_slots:
            raise InputError(
                f"{where}: slot: found {slot}, expected more than {last} and less than {num_slots}"
            )
        last = slot
        slots.append(slot)
        times_s.append(time_s)
        counts.append(len(view))
        keypoints_px.frombytes(view.keypoints_px.tobytes())
        scores.frombytes(view.scores.tobytes())
    if num_frames is not None and len(slots) != num_frames:
        raise InputError(
            f"{path}: found {len(slots)} lines, expected {num_frames} "
            "as recording.toml says in frames"
        )
    if num_frames is None and not slots:
        raise InputError(f"{path}: is empty, expected one line per frame")
    return ViewSeries(
        np.array(slots, dtype=np.int64),
        np.array(times_s, dtype=np.float64),
        np.cumsum(counts, dtype=np.int64),
        np.frombuffer(keypoints_px).reshape(-1, num_joints, 2),
        np.frombuffer(scores).reshape(-1, num_joints),
    )


def _read_header(path: Path) -> Header:
    table = read_toml(path, MAX_HEADER_BYTES)
    if table.get("format") != FORMAT:
        raise InputError(
            f"{path}: format: found {str(table.get('format'))[:40]!r}, expected {FORMAT!r}"
        )
    if table.get("version") not in VERSIONS or isinstance(table["version"], bool):
        raise InputError(
            f"{path}: version: found {str(table.get('version'))[:40]}, expected "
            f"{VERSIONS[0]} to {VERSIONS[-1]}; a newer e3pose may read it"
        )
    try:
        header = read_table(Header, table)
    except InputError as error:
        raise error.at(path) from None
    if header.version == 1 and (header.battery_wh or header.dies_at_s):
        raise InputError(f"{path}: version: found 1, expected 2 with battery_wh or dies_at_s")
    if header.version < 3 and header.detector:
        raise InputError(f"{path}: version: found {header.version}, expected 3 with detector")
    if not 0 <= header.num_slots <= 100_000_000:
        raise InputError(
            f"{path}: num_slots: found {str(header.num_slots)[:40]}, expected 0 to 100 million"
        )
    return header


def _check_cameras(folder: Path, header: Header, camera_ids: tuple[str, ...]) -> None:
    """Every camera that the header or a file names must be in the rig."""
    named = {
        "frames": list(header.frames or ()),
        "videos": list(header.videos),
        "battery_wh": list(header.battery_wh),
        "dies_at_s": list(header.dies_at_s),
    }
    for field, names in named.items():
        for camera_id in names:
            if camera_id not in camera_ids:
                raise InputError(
                    f"{folder / HEADER}: {field}: found camera {camera_id[:64]!r}, expected one of "
                    f"{', '.join(camera_ids)}"
                )
    for camera_id in camera_ids:
        file = folder / "keypoints" / f"{check_camera_id(camera_id)}.jsonl"
        if not file.exists():
            raise InputError(
                f"{file}: file not found, expected one for each camera of {RIG}; is that the "
                "calibration of another site?"
            )
    for file in sorted((folder / "keypoints").glob("*.jsonl")):
        if file.stem not in camera_ids:
            raise InputError(
                f"{file}: camera {file.stem[:64]!r} is not in {RIG}, "
                f"which has {', '.join(camera_ids)}"
            )


def _read_truth(path: Path, header: TruthHeader, num_slots: int) -> Truth:
    where = path.parent / HEADER
    skeleton = _skeleton(where, header.skeleton)
    if len(header.person_ids) > MAX_PEOPLE:
        raise InputError(
            f"{where}: truth.person_ids: found {len(header.person_ids)} names, "
            f"expected at most {MAX_PEOPLE}"
        )
    shape = (num_slots, len(header.person_ids), len(skeleton), 3)
    values = math.prod(shape)
    if values > MAX_TRUTH_VALUES:
        raise InputError(
            f"{where}: num_slots: {num_slots} slots of {len(header.person_ids)} people are too "
            f"many for a truth, expected at most {MAX_TRUTH_VALUES} coordinates"
        )
    joints: NDArray[np.float64] = np.empty(shape)
    found = 0
    for number, line in read_lines(path, MAX_LINES_BYTES):
        slot, joints_m = decode_truth(line, header.person_ids, len(skeleton), f"{path}:{number}")
        if slot != number - 1 or slot >= num_slots:
            raise InputError(
                f"{path}:{number}: slot: found {slot}, expected {number - 1} of {num_slots} slots, "
                "one line each in order"
            )
        joints[slot] = joints_m
        found = number
    if found != num_slots:
        raise InputError(f"{path}: found {found} lines, expected one for each of {num_slots} slots")
    return Truth(skeleton, tuple(header.person_ids), joints)


def _skeleton(where: Path, name: str) -> Skeleton:
    if name in SHIPPED:
        return load_skeleton(name)
    own = where.parent / SKELETON.format(name) if NAME.fullmatch(name) else None
    if own is None or not own.is_file():
        beside = f"{SKELETON.format(name)} beside it, or " if own else ""
        wanted = f"{beside}one of {', '.join(SHIPPED)}"
        raise InputError(f"skeleton {name[:40]!r}", "no such skeleton", wanted, str(where))
    return load_skeleton(own)


def _header(recording: Recording) -> Mapping[str, Any]:
    table: dict[str, Any] = {
        "format": FORMAT,
        # A newer version is an error only for a reader that cannot read what it adds.
        "version": 3
        if recording.detector
        else 2
        if recording.battery_wh or recording.dies_at_s
        else 1,
        "name": recording.name,
        "fps": float(recording.fps),
        "num_slots": int(recording.num_slots),
        "skeleton": recording.skeleton.name,
        "source": recording.source,
    }
    if recording.detector:
        table["detector"] = recording.detector
    if recording.scored_slots is not None:
        table["scored_slots"] = [int(slot) for slot in recording.scored_slots]
    lengths = [len(series.slots) for series in recording.views]
    table["frames"] = dict(zip(recording.rig.camera_ids, lengths, strict=True))
    if recording.truth is not None:
        table["truth"] = {
            "skeleton": recording.truth.skeleton.name,
            "person_ids": list(recording.truth.person_ids),
            "complete": bool(recording.truth_complete),
        }
    if recording.videos:
        table["videos"] = dict(recording.videos)
    for name, by_camera in (
        ("battery_wh", recording.battery_wh),
        ("dies_at_s", recording.dies_at_s),
    ):
        if by_camera:
            table[name] = {camera_id: float(value) for camera_id, value in by_camera.items()}
    return table
