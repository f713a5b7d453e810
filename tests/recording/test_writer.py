"""A recording that is written while it happens, and its lines of JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.cases import each_case
from tests.rigs import looking

from e3pose.base.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import json_lines, load_recording
from e3pose.recording.calibration.world import assumed_rig
from e3pose.recording.json_lines import decode_truth, decode_view, encode_truth, encode_view
from e3pose.recording.writer import RecordingWriter, finish_interrupted

RIG = looking((4, 0), (0, 4), (-4, 0))


def person(x: float) -> Poses2D:
    return Poses2D(np.full((1, 17, 2), x), np.full((1, 17), 0.5))


def begun(folder: Path) -> RecordingWriter:
    """Return a recording of which camera c0 has three slots, c1 one and c2 none."""
    writer = RecordingWriter(folder / "walk", RIG, 20.0, COCO17, "openpose", "A walk.")
    for slot in (0, 1, 4):
        writer.add("c0", slot, slot / 20, person(10.0 + slot))
    writer.add("c1", 2, 0.11, Poses2D.empty(17))
    return writer


def check(folder: Path) -> None:
    recording = load_recording(folder)
    assert recording.num_slots == 5 and recording.fps == 20
    assert (recording.detector, recording.source, recording.name) == ("openpose", "A walk.", "walk")
    assert [series.slots.tolist() for series in recording.views] == [[0, 1, 4], [2], []]
    view = recording.view(4, 0)
    assert view is not None and view.keypoints_px[0, 0, 0] == 14.0
    assert recording.views[1].times_s.tolist() == [0.11]


def test_finished_recording_has_its_name(tmp_path: Path) -> None:
    writer = begun(tmp_path)
    assert not (tmp_path / "walk").exists()
    assert writer.finish() == tmp_path / "walk"
    check(tmp_path / "walk")
    assert [path.name for path in tmp_path.iterdir()] == ["walk"]


def test_recording_that_a_kill_cut_off_is_put_right(tmp_path: Path) -> None:
    writer = begun(tmp_path)
    writer.close()
    with (writer.folder / "keypoints" / "c0.jsonl").open("ab") as file:
        file.write(b'{"slot":5,"time":0.2')  # torn
    with pytest.raises(InputError, match="unfinished work of another program"):
        begun(tmp_path)
    assert finish_interrupted(tmp_path) == [tmp_path / "walk"]
    check(tmp_path / "walk")
    assert finish_interrupted(tmp_path) == []


def test_a_line_that_is_too_long_costs_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(json_lines, "MAX_LINE_BYTES", 8)
    (tmp_path / "lines").write_bytes(b"one\n" + b"x" * 20 + b"\ntwo\n" + b"torn" * 5)
    assert json_lines.cut_torn(tmp_path / "lines") == (3, b"two\n")
    assert (tmp_path / "lines").read_bytes() == b"one\n" + b"x" * 20 + b"\ntwo\n"


def test_recording_without_a_view_is_none(tmp_path: Path) -> None:
    assert RecordingWriter(tmp_path / "walk", RIG, 20.0, COCO17).finish() is None
    RecordingWriter(tmp_path / "cut", RIG, 20.0, COCO17).close()
    assert finish_interrupted(tmp_path) == []
    assert not list(tmp_path.iterdir())


def test_strangers_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.partial").mkdir()
    (tmp_path / "mine.partial" / "recording.toml").write_text("mine")
    assert finish_interrupted(tmp_path) == []
    assert (tmp_path / "mine.partial" / "recording.toml").read_text() == "mine"


def test_cameras_that_nobody_placed_stay_so(tmp_path: Path) -> None:
    rig = assumed_rig({"c0": (640, 480), "c1": (640, 480)})
    with RecordingWriter(tmp_path / "walk", rig, 20.0, COCO17) as writer:
        writer.add("c0", 0, 0.0, person(5.0))
    loaded = load_recording(tmp_path / "walk").rig
    assert not loaded.placed and loaded.cameras[0].image_size == (640, 480)


def test_a_view_is_one_readable_line() -> None:
    keypoints = np.array([[[10.0, 20.5], [np.nan, np.nan]]])
    line = encode_view(7, 0.28, Poses2D(keypoints, np.array([[0.9, 0.0]])))
    assert line == b'{"slot":7,"time":0.28,"people":[[[10.0,20.5,0.9],null]]}\n'
    assert encode_view(0, 0.0, Poses2D.empty(17)) == b'{"slot":0,"time":0.0,"people":[]}\n'


@given(st.integers(0, 5), st.integers(0, 2**32 - 1))
def test_a_view_survives_within_a_thousandth_of_a_pixel(num_persons: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    keypoints = rng.uniform(-100, 5000, (num_persons, 17, 2))
    scores = np.where(rng.random((num_persons, 17)) < 0.3, 0, rng.random((num_persons, 17)))
    poses = Poses2D(keypoints, scores)
    slot, time_s, back = decode_view(encode_view(3, 1 / 3, poses), 17, "f:1")
    assert slot == 3
    assert abs(time_s - 1 / 3) < 1e-6
    np.testing.assert_array_equal(np.isnan(back.keypoints_px), np.isnan(poses.keypoints_px))
    np.testing.assert_allclose(back.keypoints_px, poses.keypoints_px, atol=5.01e-4)
    np.testing.assert_allclose(back.scores, poses.scores, atol=1.01e-5)


def test_a_joint_with_the_smallest_score_stays_seen() -> None:
    poses = Poses2D(np.ones((1, 1, 2)), np.array([[1e-12]]))
    assert decode_view(encode_view(0, 0, poses), 1, "f:1")[2].scores[0, 0] > 0


@each_case(
    ("line", "message"),
    [
        ("", "f:1: an empty line"),
        ('{"slot":0,"time":0,"people":[[[1,2,', "f:1: Input data was truncated"),
        ("[]", "f:1: Expected `object`"),
        ('{"slot":0,"people":[]}', "`time`"),
        ('{"slot":0,"time":0,"people":[],"colour":1}', "unknown field `colour`"),
        ('{"slot":-1,"time":0,"people":[]}', r"\$\.slot"),
        ('{"slot":1.5,"time":0,"people":[]}', r"\$\.slot"),
        ('{"slot":1e400,"time":0,"people":[]}', "f:1"),
        ('{"slot":0,"time":NaN,"people":[]}', "f:1: .*malformed"),
        ('{"slot":0,"time":1e300,"people":[]}', "f:1: time: found 1e"),
        ('{"slot":0,"time":0,"people":[[[1,2]]]}', r"\$\.people\[0\]\[0\]"),
        ('{"slot":0,"time":0,"people":[[[1,null,1],null]]}', "got `null`"),
        ('{"slot":0,"time":0,"people":[[null]]}', r"people\[0\]: found 1 joints, expected 2"),
        ('{"slot":0,"time":0,"people":[[[1,2,1.1],null]]}', r"people\[0\]\[0\]: score: found 1.1"),
        ('{"slot":0,"time":0,"people":[[[1,2,-1],null]]}', r"score: found -1"),
        ('{"slot":0,"time":0,"people":[[null,[1e9,2,1]]]}', r"people\[0\]\[1\]\[0\]: found 1e\+09"),
        ('{"slot":0,"time":0,"people":' + "[" * 100_000, "f:1"),
        ('{"slot":0,"time":0,"x":' + "[" * 100_000, "f:1"),
        ('{"slot":0,"time":0,"people":[' + ",".join(["[null,null]"] * 1001) + "]}", "at most 1000"),
        ('{"slot":0,"time":0,"people":[]}\x00', "f:1"),
        ("\udcff\udcfe{}", "f:1"),  # bytes that are no text
    ],
)
def test_a_wrong_view_is_named_by_place_and_field(line: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        decode_view(line.encode(errors="surrogateescape"), 2, "f:1")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_what_cannot_be_read_back_is_not_written() -> None:
    with pytest.raises(InputError, match=r"people\[0\]\[0\]\[1\]"):
        encode_view(0, 0.0, Poses2D(np.array([[[0.0, 1e7]]]), np.ones((1, 1))))
    with pytest.raises(InputError, match="time"):
        encode_view(0, float("nan"), Poses2D.empty(1))


def test_truth_keeps_who_is_who() -> None:
    joints_m = np.full((3, 2, 3), np.nan)
    joints_m[2] = [[0.1, 0.2, 1.7], [0.1, 0.2, 0.9]]
    joints_m[0, 1] = [1, 2, 3]
    line = encode_truth(4, ("ann", "bob", "cy"), joints_m)
    expected = {"ann": [None, [1.0, 2.0, 3.0]], "cy": [[0.1, 0.2, 1.7], [0.1, 0.2, 0.9]]}
    assert json.loads(line) == {"slot": 4, "people": expected}
    slot, back = decode_truth(line, ("cy", "bob", "ann"), 2, "f:1")
    assert slot == 4
    np.testing.assert_array_equal(back, joints_m[[2, 1, 0]])


@each_case(
    ("line", "message"),
    [
        ('{"slot":0,"people":{"eve":[null]}}', "eve"),
        ('{"slot":0,"people":{"ann":[null,null]}}', r"people\[ann\]: found 2 joints, expected 1"),
        ('{"slot":0,"people":{"ann":[[1,2,1e6]]}}', r"found 1e\+06 m"),
        ('{"slot":0,"people":[]}', r"\$\.people"),
    ],
)
def test_a_wrong_truth_is_named(line: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        decode_truth(line.encode(), ("ann",), 1, "f:1")
