"""Forms in which tools write the people of pictures: JSON, CSV and arrays, one table of fields.

A form is told by its fields, not by its name. Every reader gives the same: pictures with people.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.bounded import UNDECODABLE, open_regular, read_bytes
from e3pose.base.errors import InputError, reason_of
from e3pose.recording.arrays import BROKEN, read_array

MAX_FILE_BYTES = 1 * 2**30
MAX_NUMBER = 10**15  # of a frame or an image
PERSON = 1  # COCO's category
# Fields with the keypoints of a person, in the order of their tools; the first is the body.
KEYPOINTS = (
    "pose_keypoints_2d",
    "pose_keypoints",
    "keypoints",
    "landmarks",
    "pose_landmarks",
    "hand_landmarks",
    "joints",
)
MORE = (  # after it, of COCO-WholeBody and OpenPose
    "foot_kpts", "face_kpts", "lefthand_kpts", "righthand_kpts",
    "hand_left_keypoints_2d", "hand_right_keypoints_2d", "face_keypoints_2d",
)  # fmt: skip
SCORES = ("keypoint_scores", "scores", "keypoints_visible")
PEOPLE = ("people", "instances", "predictions", "poses", "bodies")
FRAME_NAMES = ("image_id", "frame_id", "frame", "frame_number", "file_name")
FRAMES = ("instance_info", "frames", "annotations")
HDF5 = (".h5", ".hdf5")
SUFFIXES = (".json", ".csv", ".npy", ".txt", *HDF5)
EXPECTED = (
    "people as OpenPose, AlphaPose, MMPose, Ultralytics, COCO results, DeepLabCut, SLEAP, "
    "Caliscope or FreeMoCap write them"
)


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """The people of one picture.

    Attributes:
        name: name of the image, frame number, or None where the file is the picture.
        people: `(num_people, count, 3)` x, y and score of each keypoint; 0 where missing.
        camera: its place in the file, for files of several cameras.
    """

    name: str | int | None
    people: tuple[Floats, ...]
    camera: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """The content of a file.

    Attributes:
        pictures: in the order of the file.
        names: of keypoints, where it tells them.
        all_named: whether every picture is named, also those of nobody.
        bad: of each entry that cannot be read, why.
    """

    pictures: list[Picture]
    names: tuple[str, ...] = ()
    all_named: bool = False
    bad: tuple[str, ...] = ()


def read_pictures(path: Path, images: Mapping[Any, str] | None = None) -> Pictures:
    """Read a file of detections.

    Args:
        path: with one of `SUFFIXES`, but no HDF5.
        images: name of the image of an `image_id`, from another file.

    Raises:
        InputError: naming the file and what is wrong with it.
    """
    if path.suffix.lower() == ".npy":
        return _arrays(path)
    content = read_bytes(path, MAX_FILE_BYTES)
    if path.suffix.lower() == ".csv":
        return _csv(content, path)
    if path.suffix.lower() == ".txt":
        return _yolo(content, path)
    value = parse(content, path)
    try:
        return _json(value, images or {})
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def parse(content: bytes, path: Path) -> Any:
    """Return the content of JSON, with the NaN that Python and NumPy write for missing numbers."""
    try:
        return msgspec.json.decode(content)
    except UNDECODABLE as first:
        found = str(first)[:200] if content.strip() else "an empty file"
        try:
            return json.loads(content)
        except (ValueError, RecursionError):
            raise InputError(f"{path}: {found}, expected {EXPECTED}") from None


def image_table(value: Any) -> dict[Any, str]:
    """Return the names of images by their id of a COCO data set; empty without any."""
    table: dict[Any, str] = {}
    entries = value.get("images") if isinstance(value, Mapping) else None
    for index, image in enumerate(entries if isinstance(entries, list) else ()):
        name = image.get("file_name") if isinstance(image, Mapping) else None
        if not isinstance(name, str) or not isinstance(image.get("id"), str | int):
            raise InputError(f"images[{index}]: found no id with a file_name")
        if image["id"] in table:
            raise InputError(f"images[{index}]: image {str(image['id'])[:40]} appears twice")
        table[image["id"]] = name
    return table


def _json(value: Any, images: Mapping[Any, str]) -> Pictures:
    images = {**images, **image_table(value)}
    bad: list[str] = []
    if isinstance(value, list):
        return _of_list(value, "", images)
    if not isinstance(value, Mapping):
        raise InputError(f"found {type(value).__name__}, expected {EXPECTED}")
    for key in PEOPLE:
        if isinstance(value.get(key), list):
            people = _people(value[key], key, bad)
            return Pictures([Picture(None, people)], bad=tuple(bad))
    for key in FRAMES:
        if isinstance(value.get(key), list):
            return _of_list(value[key], key, images)
    maps = {k: v for k, v in value.items() if isinstance(v, Mapping)}
    named = {k: v[key] for k, v in maps.items() for key in PEOPLE if key in v}
    if named and len(named) == len(value):
        return Pictures([Picture(k, _people(v, k, bad)) for k, v in named.items()], bad=tuple(bad))
    found, scores = _field(value, KEYPOINTS), _field(value, SCORES)
    if isinstance(found, list):  # arrays of all people of a picture, or the points of one
        found = [found] if _are_points(found) else found
        scores = [None] * len(found) if scores is None else scores
        if not isinstance(scores, list) or len(scores) != len(found):
            raise InputError(f"scores: found others than of {len(found)} people")
        each = [{"keypoints": p, "scores": s} for p, s in zip(found, scores, strict=True)]
        return Pictures([Picture(None, _people(each, "keypoints", bad))], bad=tuple(bad))
    raise InputError(f"found fields {', '.join(map(str, value))[:120]!r}, expected {EXPECTED}")


def _of_list(entries: Sequence[Any], key: str, images: Mapping[Any, str]) -> Pictures:
    """Read a list of pictures with people, or of people that name their picture."""
    pictures: list[Picture] = []
    bad: list[str] = []
    found: dict[Any, list[Floats]] = {name: [] for name in images.values()}
    for index, entry in enumerate(entries):
        where = f"{key}[{index}]"
        try:
            if not isinstance(entry, Mapping):
                raise InputError(f"{where}: found {type(entry).__name__}, expected {EXPECTED}")
            people = next((entry[k] for k in PEOPLE if isinstance(entry.get(k), list)), None)
            if people is not None:
                name = _name(entry, FRAME_NAMES, where)
                seen = _people(people, where, bad)
                pictures.append(Picture(index if name is None else name, seen))
            elif entry.get("category_id", PERSON) == PERSON:
                found.setdefault(_image(entry, images, where), []).append(_person(entry, where))
        except InputError as error:
            bad.append(str(error))
    if None in found:  # people without a picture: the file is theirs
        return Pictures([Picture(None, tuple(found[None]))], bad=tuple(bad))
    pictures += [Picture(name, tuple(people)) for name, people in found.items()]
    if bad and not any(picture.people for picture in pictures):
        raise InputError(bad[0])
    return Pictures(pictures, all_named=bool(images) or not found, bad=tuple(bad))


def _image(entry: Mapping[str, Any], images: Mapping[Any, str], where: str) -> str | int | None:
    """Return the name of the image that an entry is of."""
    name, file_name = _name(entry, FRAME_NAMES, where), _name(entry, ("file_name",), where)
    if images and name not in images and file_name is None:
        raise InputError(
            f"{where}.image_id: found {str(name)[:80]!r}, expected an image of the images "
            "table (--images FILE) or <camera>/<frame>"
        )
    return images.get(name, name if file_name is None else file_name)


def _name(entry: Mapping[str, Any], names: Sequence[str], where: str) -> str | int | None:
    found = _field(entry, names)
    if isinstance(found, float) and found.is_integer():
        found = int(found)
    if found is None or isinstance(found, str):
        return found
    if isinstance(found, int) and not isinstance(found, bool) and abs(found) < MAX_NUMBER:
        return found
    raise InputError(f"{where}: found {type(found).__name__} for a picture, expected its name")


def _people(entries: Any, where: object, bad: list[str]) -> tuple[Floats, ...]:
    if not isinstance(entries, list):
        raise InputError(f"{where}: found {type(entries).__name__}, expected a list of people")
    if len(entries) == 1 and isinstance(entries[0], list):  # lists within lists
        entries = entries[0]
    people = []
    for index, entry in enumerate(entries):
        place = f"{where}[{index}]"
        try:
            if not isinstance(entry, Mapping):
                raise InputError(f"{place}: found {type(entry).__name__}, expected a person")
            person = _person(entry, place)
        except InputError as error:
            bad.append(str(error))
            continue
        if len(person):
            people.append(person)
    if bad and not people:
        raise InputError(bad[-1])
    return tuple(people)


def _field(entry: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((entry[name] for name in names if entry.get(name) is not None), None)


def _are_points(values: Any) -> bool:
    """Return whether keypoints are tables with x and y."""
    first = values[0] if isinstance(values, list) and values else None
    return isinstance(first, Mapping) and {"x", "y"} <= first.keys()


def _person(entry: Mapping[str, Any], where: str) -> Floats:
    """Return `(count, 3)` of a person, whatever the tool calls its fields."""
    values = _field(entry, KEYPOINTS)
    if values is None:
        raise InputError(f"{where}: found no keypoints, expected one of {', '.join(KEYPOINTS)}")
    scores = _field(entry, SCORES)
    if isinstance(values, Mapping):  # Ultralytics: columns
        rows = [values.get(name) for name in ("x", "y", "visible") if name in values]
        return clean(_numbers(rows, where).T, None, where)
    if not isinstance(values, list) or not isinstance(scores, list | None):
        raise InputError(f"{where}: found keypoints of {type(values).__name__}, expected a list")
    if _are_points(values) and all(isinstance(value, Mapping) for value in values):  # MediaPipe
        told = any(v.get("visibility") for v in values)  # of hands it is 0 throughout
        rows = [[v.get("x"), v.get("y"), v.get("visibility", 1) if told else 1] for v in values]
        return clean(_numbers(rows, where), None, where)
    body = _numbers(values, where)
    if body.ndim == 1:
        more = [_numbers(entry[name], where) for name in MORE if entry.get(name)]
        if any(part.ndim != 1 for part in more):
            raise InputError(f"{where}: found keypoints within keypoints, expected numbers")
        body = np.concatenate([body, *more])
        if len(body) % 3:
            raise InputError(f"{where}: found {len(body)} numbers, expected x, y, score of each")
        body = body.reshape(-1, 3)
        flags = set(body[:, 2].tolist())
        if flags <= {0.0, 1.0, 2.0} and (2.0 in flags or scores is not None):
            # Flags of annotations: 0 not labelled, 1 labelled, 2 visible.
            fitting = scores is not None and len(scores) == len(body)
            shown = _numbers(scores, where) if fitting else np.ones(len(body))
            body = np.column_stack([body[:, :2], np.where(body[:, 2] > 0, shown, 0.0)])
        return clean(body, None, where)
    return clean(body, None if scores is None else _numbers(scores, where), where)


def _numbers(values: Any, where: str) -> Floats:
    """Return numbers as an array, NaN for null and empty text."""
    try:
        return np.array(_without_gaps(values), dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise InputError(f"{where}: found what are not numbers, expected keypoints") from None


def _without_gaps(value: Any) -> Any:
    if isinstance(value, list):
        return [_without_gaps(item) for item in value]
    if isinstance(value, bool):
        raise ValueError
    if isinstance(value, str):
        return float(value) if value.strip() else np.nan
    return np.nan if value is None else value


def clean(points: Floats, scores: Floats | None, where: str) -> Floats:
    """Return `(count, 3)` with 0 where tools write NaN, -1 or no score for what they miss.

    Args:
        points: `(count, 2 or 3)` x, y and perhaps score.
        scores: `(count,)`; None for those of `points`, or 1.
        where: for the error.
    """
    if (
        points.ndim != 2
        or points.shape[1] not in (2, 3)
        or len(points) != len(points if scores is None else scores)
    ):
        raise InputError(f"{where}: found keypoints of shape {points.shape}, expected joints x 3")
    if scores is None:
        scores = points[:, 2] if points.shape[1] == 3 else np.ones(len(points))
    xy = points[:, :2]
    missing = ~np.isfinite(xy).all(axis=1) | ~(scores > 0) | (xy == -1).all(axis=1)
    if points.shape[1] == 2:
        missing |= (xy == 0).all(axis=1)
    return np.where(missing[:, None], 0.0, np.column_stack([xy, scores]))


def _csv(content: bytes, path: Path) -> Pictures:
    try:
        rows = list(csv.reader(io.StringIO(content.decode("utf-8-sig"))))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: found no CSV ({str(error)[:80]})") from None
    heads = {row[0]: row for row in rows[:4] if row}
    if rows and "frame_idx" in rows[0]:
        return _sleap(rows, path)
    if "bodyparts" in heads and "coords" in heads:
        return _deeplabcut(rows, heads, path)
    if rows and {"point_id", "img_loc_x", "img_loc_y"} <= set(rows[0]):
        return _caliscope(rows, path)
    raise InputError(f"{path}: found columns {', '.join(rows[0])[:120] if rows else 'none'!r}, "
                     "expected those of DeepLabCut or Caliscope")  # fmt: skip


def _deeplabcut(
    rows: Sequence[Sequence[str]], heads: Mapping[str, Sequence[str]], path: Path
) -> Pictures:
    """Rows of frames; columns of individual, body part and coordinate."""
    parts, coords = heads["bodyparts"], heads["coords"]
    who = heads.get("individuals", ["single"] * len(parts))
    first = next((i for i, c in enumerate(coords) if c in ("x", "y", "likelihood")), len(coords))
    columns = list(zip(who[first:], parts[first:], coords[first:], strict=False))
    begin = rows.index(coords) + 1
    labels, values = [], np.full((len(rows) - begin, len(columns)), np.nan)
    for at, row in enumerate(rows[begin:]):
        texts = row[first : first + len(columns)]
        values[at, : len(texts)] = [_float(t, f"{path}:{begin + at + 1}") for t in texts]
        labels.append(row[first - 1] if row and first else "")
    return of_columns(columns, values, [int(t) if t.isdigit() else t for t in labels], str(path))


def of_columns(
    columns: Sequence[tuple[str, str, str]], values: Floats, labels: Sequence[Any], where: str
) -> Pictures:
    """Return the pictures of a table of frames.

    Args:
        columns: individual, body part and coordinate (x, y, likelihood) of each.
        values: `(num_frames, num_columns)`, NaN where missing.
        labels: name or number of each frame.
        where: for errors.
    """
    names = tuple(dict.fromkeys(part for _, part, _ in columns))
    people_ids = list(dict.fromkeys(person for person, _, _ in columns))
    found = np.full((len(values), len(people_ids), len(names), 3), np.nan)
    found[..., 2] = 1.0
    for (person, part, coord), column in zip(columns, values.T, strict=True):
        if coord in ("x", "y", "likelihood"):
            axis = ("x", "y", "likelihood").index(coord)
            found[:, people_ids.index(person), names.index(part), axis] = column
    return of_array(found, labels, names, where)


def of_array(
    found: Floats, labels: Sequence[Any], names: Sequence[str] = (), where: str = "array"
) -> Pictures:
    """Return the pictures of `(num_frames, num_people, count, 2 or 3)` x, y and score."""
    pictures = []
    for label, people in zip(labels, found, strict=True):
        shown = (clean(person, None, where) for person in people)
        pictures.append(Picture(label, tuple(p for p in shown if p[:, 2].any())))
    return Pictures(pictures, tuple(names), all_named=True)


def _sleap(rows: Sequence[Sequence[str]], path: Path) -> Pictures:
    """Rows of people; columns NODE.x, NODE.y and perhaps NODE.score."""
    head = set(rows[0])
    nodes = [name[:-2] for name in rows[0] if name.endswith(".x") and f"{name[:-2]}.y" in head]
    coords = ["x", "y", "score"] if f"{nodes[0] if nodes else ''}.score" in head else ["x", "y"]
    wanted = [f"{node}.{coord}" for node in nodes for coord in coords]
    frames, *columns = _columns(rows, ("frame_idx", *wanted), path)
    people = np.array(columns).reshape(len(nodes), len(coords), -1).transpose(2, 0, 1)
    found: dict[int, list[Floats]] = {}
    for frame, person in zip(_whole(frames, path), people, strict=True):
        found.setdefault(frame, []).append(clean(person, None, str(path)))
    return Pictures([Picture(frame, tuple(each)) for frame, each in found.items()], tuple(nodes))


def _yolo(content: bytes, path: Path) -> Pictures:
    """Lines of people: class, box, then x, y and score of keypoints, shares of the image."""
    people = []
    for number, line in enumerate(content.decode(errors="replace").splitlines(), 1):
        where = f"{path}:{number}"
        numbers = [_float(word, where) for word in line.split()]
        whole = 5 + (len(numbers) - 5) // 3 * 3  # a track's number may follow
        if whole < 8:
            raise InputError(f"{where}: found {len(numbers)} numbers, expected YOLO's keypoints")
        people.append(clean(np.array(numbers[5:whole]).reshape(-1, 3), None, where))
    return Pictures([Picture(None, tuple(people))])


def _caliscope(rows: Sequence[Sequence[str]], path: Path) -> Pictures:
    """Rows of points; a row names camera, frame and point."""
    camera_key = next((key for key in ("port", "cam_id") if key in rows[0]), "port")
    frame_key = next((key for key in ("sync_index", "frame_index") if key in rows[0]), "sync_index")
    names = (camera_key, frame_key, "point_id", "img_loc_x", "img_loc_y")
    *keys, x, y = _columns(rows, names, path)
    cameras, frames, points = (_whole(key, path) for key in keys)
    count = 1 + max(points, default=0)
    if count > 1000:
        raise InputError(f"{path}: found point {count - 1}, expected at most 999")
    found: dict[tuple[int, int], Floats] = {}
    for camera, frame, point, *xy in zip(cameras, frames, points, x, y, strict=True):
        found.setdefault((camera, frame), np.full((count, 2), np.nan))[point] = xy
    pictures = [Picture(frame, (clean(person, None, str(path)),), camera=camera)
                for (camera, frame), person in found.items()]  # fmt: skip
    return Pictures(pictures, all_named=True)


def _columns(rows: Sequence[Sequence[str]], names: Sequence[str], path: Path) -> list[Floats]:
    """Return the numbers of columns of a table with a head, NaN where empty."""
    at = {name: index for index, name in enumerate(rows[0])}
    if missing := [name for name in names if name not in at]:
        raise InputError(f"{path}: found no column {missing[0][:80]}, expected {EXPECTED}")
    short = next((i for i, row in enumerate(rows[1:], 2) if len(row) < len(at)), 0)
    if short:
        raise InputError(f"{path}:{short}: found too few columns, expected {len(at)}")
    body = list(enumerate(rows[1:], 2))
    return [np.array([_float(row[at[n]], f"{path}:{i}") for i, row in body]) for n in names]


def _whole(numbers: Floats, path: Path) -> list[int]:
    """Return frames, cameras or points as whole numbers of 0 and more."""
    if not ((numbers >= 0) & (numbers < MAX_NUMBER)).all():
        raise InputError(f"{path}: found a frame, camera or point that is no whole number")
    return [int(number) for number in numbers]


def _float(text: str, where: str) -> float:
    try:
        value = float(text) if text.strip() else np.nan
    except ValueError:
        raise InputError(f"{where}: found {text[:40]!r}, expected a number") from None
    return value


def _arrays(path: Path) -> Pictures:
    """FreeMoCap's array: cameras x frames x keypoints x 2 or 3; of one camera without the first."""
    with open_regular(path, MAX_FILE_BYTES) as file:
        try:
            array = read_array(file, path.stat().st_size)
        except BROKEN as error:
            raise InputError(f"{path}: {reason_of(error)[:200]}") from None
    if array.ndim not in (3, 4) or array.shape[-1] not in (2, 3) or array.dtype.kind not in "fiu":
        wanted = "numbers of cameras x frames x joints x 2, or of frames x joints x 2"
        raise InputError(f"{path}: found {array.dtype} of shape {array.shape}, expected {wanted}")
    alone = array.ndim == 3
    points = (array[None] if alone else array)[:, :, None, :, :2].astype(np.float64)  # one person
    cameras = [of_array(camera, range(len(camera))).pictures for camera in points]
    seen = [replace(p, camera=None if alone else i) for i, pictures in enumerate(cameras)
            for p in pictures]  # fmt: skip
    return Pictures(seen, all_named=True)
