from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.breaking import Break, gone, instead, new, whole
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.recording import Recording, load_recording, save_recording


@pytest.fixture
def folder(scene: Recording, tmp_path: Path) -> Path:
    save_recording(scene, tmp_path / "rec")
    return tmp_path / "rec"


def test_a_recording_comes_back_as_it_was(scene: Recording, tmp_path: Path) -> None:
    views = list(scene.views)
    lost = np.array([0, 1, 2, 30])
    keep = np.setdiff1d(np.arange(40), lost)
    rows = (2 * keep[:, None] + [0, 1]).ravel()
    views[1] = replace(
        views[1],
        slots=keep,
        times_s=views[1].times_s[keep] + 0.003,
        starts=np.arange(len(keep) + 1) * 2,
        keypoints_px=views[1].keypoints_px[rows],
        scores=views[1].scores[rows],
    )
    before = replace(
        scene,
        views=tuple(views),
        name="Größe [red]",
        scored_slots=(3, 30),
        truth_complete=False,
        videos={"cam0": "a.mp4", "cam2": "/data/c d.mp4"},
        source="line one\nline two",
    )
    save_recording(before, tmp_path / "rec")
    after = load_recording(tmp_path / "rec")
    for name in ("name", "fps", "num_slots", "skeleton", "scored_slots", "truth_complete",
                 "videos", "source"):  # fmt: skip
        assert getattr(after, name) == getattr(before, name), name
    assert after.rig.camera_ids == before.rig.camera_ids
    np.testing.assert_allclose(after.rig.projections, before.rig.projections, atol=1e-6)
    for camera in range(4):
        for slot in range(40):
            old, now = before.view(slot, camera), after.view(slot, camera)
            assert (old is None) == (now is None)
            if old is not None and now is not None:
                np.testing.assert_allclose(now.keypoints_px, old.keypoints_px, atol=5.01e-4)
                np.testing.assert_allclose(now.scores, old.scores, atol=1e-5)
        np.testing.assert_allclose(after.views[camera].times_s, before.views[camera].times_s)
    assert after.truth is not None
    assert before.truth is not None
    assert after.truth.person_ids == ("ann", "bob")
    np.testing.assert_allclose(after.truth.joints_m, before.truth.joints_m, atol=5.01e-7)


def test_batteries_and_deaths_come_back_in_a_newer_version(
    scene: Recording, tmp_path: Path
) -> None:
    ids = scene.rig.camera_ids
    tired = replace(scene, battery_wh={ids[1]: 0.25}, dies_at_s={ids[0]: 1.5})
    save_recording(tired, tmp_path / "tired")
    assert "version = 2" in (tmp_path / "tired" / TOML).read_text()
    loaded = load_recording(tmp_path / "tired")
    assert loaded.battery_wh == {ids[1]: 0.25} and loaded.dies_at_s == {ids[0]: 1.5}
    save_recording(scene, tmp_path / "plain")
    assert "version = 1" in (tmp_path / "plain" / TOML).read_text()


def test_saving_what_was_loaded_changes_no_byte(folder: Path, tmp_path: Path) -> None:
    save_recording(load_recording(folder), tmp_path / "again")
    for path in folder.rglob("*"):
        if path.is_file() and path.name != "calibration.toml":
            assert (tmp_path / "again" / path.relative_to(folder)).read_bytes() == path.read_bytes()


def test_a_recording_without_truth_or_slots(scene: Recording, tmp_path: Path) -> None:
    empty = replace(
        scene,
        num_slots=0,
        truth=None,
        views=tuple(
            replace(v, slots=v.slots[:0], times_s=v.times_s[:0], starts=v.starts[:1],
                    keypoints_px=v.keypoints_px[:0], scores=v.scores[:0])
            for v in scene.views
        ),
    )  # fmt: skip
    save_recording(empty, tmp_path / "rec")
    after = load_recording(tmp_path / "rec")
    assert after.truth is None
    assert after.num_slots == 0


def test_a_hand_written_folder_needs_no_frame_counts(folder: Path) -> None:
    header = (folder / "recording.toml").read_text()
    start = header.index("[frames]")
    end = header.index("[truth]")
    (folder / "recording.toml").write_text(header[:start] + header[end:])
    assert len(load_recording(folder).views[0].slots) == 40


def _half(name: str, share: float = 0.5) -> Break:
    return lambda folder: os.truncate(folder / name, int((folder / name).stat().st_size * share))


def _drop_last_line(name: str) -> Break:
    def change(folder: Path) -> None:
        lines = (folder / name).read_bytes().splitlines(keepends=True)
        (folder / name).write_bytes(b"".join(lines[:-1]))

    return change


def _second(table: str) -> Break:
    """Add a table of version 2."""

    def change(folder: Path) -> None:
        new(TOML, "version = 1", "version = 2")(folder)
        new(TOML, "[frames]", f"{table}\n[frames]")(folder)

    return change


TOML, VIEW, TRUTH = "recording.toml", "keypoints/cam1.jsonl", "truth.jsonl"


def linked(target: str) -> Break:
    return instead(VIEW, lambda path: path.symlink_to(target))


@each_case(
    ("break_it", "message"),
    [
        (lambda folder: shutil.rmtree(folder), "rec: no such folder"),
        (gone(TOML), r"found a folder without recording.toml"),
        (whole(TOML, b""), "recording.toml: format: found 'None'"),
        (_half(TOML, 0.3), "recording.toml: "),
        (whole(TOML, b"\xff\xfe\x00"), "recording.toml: .*TOML"),
        (whole(TOML, b"a = " + b"[" * 50_000), "recording.toml: .*TOML"),
        (whole(TOML, b"#" * (2**20 + 1)), "recording.toml: found 1048577 bytes"),
        (new(TOML, "e3pose-recording", "other"), "format: found 'other'"),
        (new(TOML, "version = 1", "version = 4"), "version: found 4, expected 1 to 3; a newer"),
        (
            new(TOML, "[frames]", "[battery_wh]\ncam0 = 1.0\n[frames]"),
            "version: found 1, expected 2 with battery_wh",
        ),
        (_second("[battery_wh]\neve = 1.0"), "battery_wh: found camera 'eve'"),
        (_second("[battery_wh]\ncam0 = -1.0"), "battery_wh.cam0: found -1.0, expected a number"),
        (_second("[dies_at_s]\ncam0 = nan"), "dies_at_s.cam0: found nan, expected a number"),
        (new(TOML, "version = 1", "version = true"), "version: found True"),
        (new(TOML, "version = 1\n", ""), "version: found None"),
        (new(TOML, "fps = 20.0", "fps = nan"), "recording.toml: .*fps is nan"),
        (
            new(TOML, "fps = 20.0", 'fps = "fast"'),
            r"recording.toml: fps: found text, expected a number",
        ),
        (new(TOML, "fps = 20.0", "fps = -1"), "fps is -1"),
        (new(TOML, "num_slots = 40", "num_slots = 1000000000000"), "num_slots: found 1000000"),
        (new(TOML, "num_slots = 40", "num_slots = 99000000"), "num_slots: 99000000 slots of 2"),
        (new(TOML, "num_slots = 40", "num_slots = 39"), r"cam0.jsonl:40: slot: found 39"),
        (new(TOML, "num_slots = 40", "num_slots = 41"), "truth.jsonl: found 40 lines"),
        (new(TOML, 'skeleton = "coco17"', 'skeleton = "octopus"'), "toml: skeleton 'octopus'"),
        (new(TOML, "cam1 = 40", "eve = 40"), "frames: found camera 'eve'"),
        (new(TOML, "cam1 = 40", "cam1 = 41"), "cam1.jsonl: found 40 lines, expected 41"),
        (new(TOML, "cam1 = 40\n", ""), "cam1.jsonl: found 40 lines, expected 0"),
        (new(TOML, "name =", "colour ="), "recording.toml: "),
        (new(TOML, "[frames]", "scored_slots = [0, 41]\n[frames]"), "scored_slots: found 0..41"),
        (new(TOML, "[frames]", '[videos]\ncam0 = "../x"\n[frames]'), "videos.cam0: found '../x'"),
        (new(TOML, '"ann"', '"eve"'), "truth.jsonl:1: people: found 'ann'"),
        (gone("calibration.toml"), "calibration.toml"),
        (whole("calibration.toml", b""), "calibration.toml"),
        (_half("calibration.toml", 0.6), "calibration.toml"),
        (gone(VIEW), "cam1.jsonl: file not found"),
        (whole(VIEW, b""), "cam1.jsonl: found 0 lines, expected 40"),
        (_half(VIEW), r"cam1.jsonl:\d+: Input data was truncated"),
        (_drop_last_line(VIEW), "cam1.jsonl: found 39 lines, expected 40"),
        (new(VIEW, '{"slot":1,', '{"slot":0,'), "cam1.jsonl:2: slot: found 0, expected more"),
        (new(VIEW, '"people":[[[', '"people":[[[NaN,'), "cam1.jsonl:1: "),
        (instead(VIEW, os.mkfifo), "cam1.jsonl: found a pipe"),
        (linked("/dev/zero"), "cam1.jsonl: found a pipe, socket or device"),
        (linked("/etc/passwd"), r"cam1.jsonl:1: JSON is malformed"),
        (whole("keypoints/eve.jsonl", b""), "eve.jsonl: camera 'eve' is not in calibration.toml"),
        (gone(TRUTH), "truth.jsonl: file not found"),
        (_drop_last_line(TRUTH), "truth.jsonl: found 39 lines, expected one for each of 40"),
        (new(TRUTH, '{"slot":1,', '{"slot":7,'), "truth.jsonl:2: slot: found 7, expected 1"),
    ],
)
def test_a_broken_folder_gets_one_line_with_file_and_field(
    scene: Recording, tmp_path: Path, break_it: Break, message: str
) -> None:
    folder = tmp_path / "rec"
    save_recording(scene, folder)
    break_it(folder)
    with pytest.raises(InputError, match=message) as caught:
        load_recording(folder)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700


def test_a_truth_that_the_header_does_not_know_is_not_ignored(folder: Path) -> None:
    header = (folder / TOML).read_text()
    (folder / TOML).write_text(header[: header.index("[truth]")])
    with pytest.raises(InputError, match="truth: missing"):
        load_recording(folder)


def test_a_recording_that_cannot_be_written_leaves_nothing(
    scene: Recording, tmp_path: Path
) -> None:
    keypoints = scene.views[3].keypoints_px.copy()
    keypoints[50, 3, 0] = 1e9
    views = (*scene.views[:3], replace(scene.views[3], keypoints_px=keypoints))
    with pytest.raises(InputError, match="slot 25"):
        save_recording(replace(scene, views=views), tmp_path / "rec")
    assert list(tmp_path.iterdir()) == []


def test_an_existing_recording_is_kept_by_default(scene: Recording, folder: Path) -> None:
    with pytest.raises(InputError, match="--overwrite"):
        save_recording(scene, folder)
    save_recording(replace(scene, name="second"), folder, overwrite=True)
    assert load_recording(folder).name == "second"
