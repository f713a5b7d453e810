"""One view, or the truth of one slot, as a line of JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.bounded import MAX_LINE_BYTES, UNDECODABLE
from e3pose.base.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.recording.record import MAX_PEOPLE

PIXEL_LIMIT = 1e6
METRE_LIMIT = 1e5
SECOND_LIMIT = 1e9
PIXEL_DECIMALS = 3
SCORE_DECIMALS = 5
METRE_DECIMALS = 6
SECOND_DECIMALS = 6

Slot = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
Line = TypeVar("Line")


class ViewLine(msgspec.Struct, forbid_unknown_fields=True):
    """The view of one camera in one slot; a missing joint is null."""

    slot: Slot
    time: float
    people: list[list[tuple[float, float, float] | None]]


class TruthLine(msgspec.Struct, forbid_unknown_fields=True):
    """The annotated people of one slot by name; a joint without annotation is null."""

    slot: Slot
    people: dict[str, list[tuple[float, float, float] | None]]


_ENCODER = msgspec.json.Encoder()
_VIEW_DECODER = msgspec.json.Decoder(ViewLine)
_TRUTH_DECODER = msgspec.json.Decoder(TruthLine)


def cut_torn(path: Path) -> tuple[int, bytes]:
    """Cut off what a kill left after the last whole line; return how many there are, and the last.

    Args:
        path: of a file of lines; the last one is empty where there is none.
    """
    count, end, last = 0, 0, b""
    with path.open("r+b") as file:
        while piece := file.readline(MAX_LINE_BYTES):  # a line may be too long
            if piece.endswith(b"\n"):
                count, end, last = count + 1, file.tell(), piece
        file.truncate(end)
    return count, last


def encode_view(slot: int, time_s: float, poses: Poses2D) -> bytes:
    """Encode what a camera saw in one slot as one line, newline included.

    Args:
        slot: index of the slot.
        time_s: capture time in seconds since the recording began.
        poses: the people; coordinates are rounded to 0.001 px, scores to 0.00001.

    Raises:
        InputError: for a time that is not finite, or beyond `SECOND_LIMIT`.
    """
    _check_range(f"slot {slot}: people", poses.keypoints_px, PIXEL_LIMIT, "px")
    if not abs(time_s) <= SECOND_LIMIT:
        raise InputError(f"slot {slot}: time: found {time_s}, expected seconds")
    scores = poses.scores.round(SCORE_DECIMALS)
    # A joint that was seen stays seen, however small its score.
    scores = np.where(poses.scores > 0, np.maximum(scores, 10.0**-SCORE_DECIMALS), 0.0)
    triples = np.concatenate(
        [poses.keypoints_px.round(PIXEL_DECIMALS), scores[..., None]], axis=-1
    ).tolist()
    people = [[joint if joint[2] > 0 else None for joint in person] for person in triples]
    time_s = round(float(time_s), SECOND_DECIMALS)
    return _ENCODER.encode({"slot": int(slot), "time": time_s, "people": people}) + b"\n"


def decode_view(line: bytes, num_joints: int, where: str) -> tuple[int, float, Poses2D]:
    """Decode one line of a camera's keypoints.

    Args:
        line: the JSON, with or without its newline.
        num_joints: joints of the recording's skeleton.
        where: file and line number, for the error.

    Returns:
        Slot, capture time in seconds, and the detected poses.

    Raises:
        InputError: naming `where` and the field that is wrong.
    """
    view = _decode(_VIEW_DECODER, line, where)
    if not abs(view.time) <= SECOND_LIMIT:
        raise InputError(f"{where}: time: found {view.time}, expected seconds")
    if len(view.people) > MAX_PEOPLE:
        raise InputError(
            f"{where}: people: found {len(view.people)}, expected at most {MAX_PEOPLE}"
        )
    array = _joints(dict(enumerate(view.people)), num_joints, missing_score=0.0, where=where)
    _check_range(f"{where}: people", array[..., :2], PIXEL_LIMIT, "px")
    scores = array[..., 2]
    wrong = ~((scores >= 0) & (scores <= 1))
    if wrong.any():
        person, joint = (int(v) for v in np.argwhere(wrong)[0])
        raise InputError(
            f"{where}: people[{person}][{joint}]: score: found {scores[person, joint]:g}, "
            "expected 0 to 1"
        )
    return view.slot, view.time, Poses2D(array[..., :2], scores)


def encode_truth(slot: int, person_ids: Sequence[str], joints_m: Floats) -> bytes:
    """Encode the truth of one slot as one line; people without any joint are left out.

    Args:
        slot: index of the slot.
        person_ids: one name per person.
        joints_m: `(num_persons, num_joints, 3)` metres, NaN where not annotated; rounded to 1 um.
    """
    _check_range(f"slot {slot}: people", joints_m, METRE_LIMIT, "m")
    annotated = np.asarray(np.isfinite(joints_m).all(axis=-1)).tolist()
    rows = joints_m.round(METRE_DECIMALS).tolist()
    people = {
        name: [joint if seen else None for joint, seen in zip(row, mask, strict=True)]
        for name, row, mask in zip(person_ids, rows, annotated, strict=True)
        if any(mask)
    }
    return _ENCODER.encode({"slot": int(slot), "people": people}) + b"\n"


def decode_truth(
    line: bytes, person_ids: Sequence[str], num_joints: int, where: str
) -> tuple[int, Floats]:
    """Decode one line of the truth.

    Returns:
        Slot, and `(num_persons, num_joints, 3)` metres in the order of `person_ids`, NaN where not
        annotated.

    Raises:
        InputError: naming `where` and the field that is wrong.
    """
    truth = _decode(_TRUTH_DECODER, line, where)
    unknown = truth.people.keys() - set(person_ids)
    if unknown:
        raise InputError(
            f"{where}: people: found {min(unknown)[:64]!r}, which recording.toml does not name in "
            "truth.person_ids"
        )
    joints_m = np.full((len(person_ids), num_joints, 3), np.nan)
    rows = [index for index, name in enumerate(person_ids) if name in truth.people]
    people = {person_ids[row]: truth.people[person_ids[row]] for row in rows}
    joints_m[rows] = _joints(people, num_joints, missing_score=np.nan, where=where)
    _check_range(f"{where}: people", joints_m, METRE_LIMIT, "m")
    return truth.slot, joints_m


def _decode(decoder: msgspec.json.Decoder[Line], line: bytes, where: str) -> Line:
    try:
        return decoder.decode(line)
    except UNDECODABLE as error:
        found = "an empty line" if not line.strip() else str(error)[:200]
        raise InputError(f"{where}: {found}, expected one JSON object a line") from None


def _joints(
    people: Mapping[int, list[tuple[float, float, float] | None]]
    | Mapping[str, list[tuple[float, float, float] | None]],
    num_joints: int,
    missing_score: float,
    where: str,
) -> Floats:
    """Return `(num_persons, num_joints, 3)`; a null joint is NaN, NaN, `missing_score`."""
    missing = (np.nan, np.nan, missing_score)
    for name, person in people.items():
        if len(person) != num_joints:
            raise InputError(
                f"{where}: people[{name}]: found {len(person)} joints, expected {num_joints}"
            )
    rows = [[missing if joint is None else joint for joint in row] for row in people.values()]
    return np.array(rows, dtype=np.float64).reshape(len(rows), num_joints, 3)


def _check_range(where: str, values: Floats, limit: float, unit: str) -> None:
    beyond = np.abs(values) > limit  # NaN compares as within
    if beyond.any():
        index = tuple(np.argwhere(beyond)[0])
        place = "".join(f"[{i}]" for i in index)
        raise InputError(
            f"{where}{place}: found {values[index]:g} {unit}, expected within {limit:g} {unit}"
        )
