"""What no verb may do with bad input: more than one line, another exit code, anything left over."""

from __future__ import annotations

import functools
import io
import os
import re
import shutil
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from tests.breaking import Break, cut, gone, new, sparse, whole
from tests.cases import each_case
from tests.cli.commands import refused_and_unchanged, run

from e3pose.cli import main
from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow

HEADER, RIG, KEYPOINTS, TRUTH = (
    "recording.toml",
    "calibration.toml",
    "keypoints/cam0.jsonl",
    "truth.jsonl",
)
ESCAPE = "\x1b[2J"
HUGE = 5000 * "9"
LAUGHS = '<!DOCTYPE a [<!ENTITY b "ha"><!ENTITY c "&b;&b;">]><a>&c;</a>'


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hostile") / "rec"
    save_recording(simulate(SceneSettings(people=2, seconds=0.4, cameras=3), seed=0), folder)
    return folder


def days_of_nothing(folder: Path) -> None:
    gone(TRUTH)(folder)
    header = (folder / HEADER).read_text()
    header = header[: header.index("[truth]")]
    (folder / HEADER).write_text(re.sub(r"num_slots = \d+", "num_slots = 100_000_000", header))


def crowd(count: int) -> str:
    names = ", ".join(f'"q{n}"' for n in range(count))
    return f'person_ids = [{names}, "person1",'


# What is wrong with a recording -> what the line must say. tests/recording/test_folder.py has what
# the reader says of the rest.
RECORDINGS: dict[str, tuple[Break, str]] = {
    "no header": (gone(HEADER), "found a folder without recording.toml"),
    "unknown key that clears the screen": (
        new(HEADER, "fps", '"\\u001b[2J" = 1\nfps'),
        r"recording.toml: .*\\x1b",
    ),
    "more digits than Python reads": (
        new(HEADER, "num_slots = 10", "num_slots = 1" + 5000 * "0"),
        "recording.toml",
    ),
    "days of slots, a few lines": (
        days_of_nothing,
        "recording.toml: recording: num_slots: found 100000000",
    ),
    "people without number": (new(HEADER, "person_ids = [", crowd(50_000)), "person_ids: found"),
    "TOML of dots": (whole(HEADER, "a" + 50_000 * ".a" + " = 1"), "line 1: .*dots"),
    "header of 10 GB": (sparse(HEADER), "recording.toml: found 10737418240 bytes"),
    "title that clears the screen": (new(HEADER, 'name = "', 'name = "\\u001b[2J'), "name: found"),
    "camera called ../x": (
        new(RIG, 'name = "cam0"', 'name = "../x"'),
        "frames: found camera 'cam0'",
    ),
    "two cameras of one name": (new(RIG, '"cam0"', '"cam1"'), "appears twice"),
    "rig of 10 GB": (sparse(RIG), "calibration.toml: found"),
    "rig that laughs": (whole(RIG, LAUGHS), "document type"),
    "keypoints of 10 GB": (sparse(KEYPOINTS), "cam0.jsonl: found"),
    "time without end": (new(KEYPOINTS, '"time":0.0', '"time":1e308'), "cam0.jsonl:1: time"),
    "deep JSON": (whole(KEYPOINTS, '{"slot":0,"people":' + 10**6 * "["), "cam0.jsonl:1"),
    "key that clears the screen": (whole(KEYPOINTS, '{"\\u001b[2J":1}'), "cam0.jsonl:1"),
    "a crowd in one line": (
        whole(KEYPOINTS, '{"slot":0,"time":0,"people":[' + 10**5 * "[]," + "[]]}"),
        "cam0.jsonl:1: people: found 100001",
    ),
    "keypoints of a stranger": (whole(f"keypoints/x{ESCAPE}.jsonl", "{}"), "is not in calibration"),
    "truncated truth": (cut(TRUTH, -20), "truth.jsonl:10"),
}
# The verbs share the reader of recordings: one hears of everything, the others of one thing.
READERS = [("info", name) for name in RECORDINGS] + [
    (verb, "days of slots, a few lines") for verb in ("replay", "evaluate")
]


@each_case(("verb", "wrong"), READERS)
def test_a_bad_recording_gets_one_line(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], verb: str, wrong: str
) -> None:
    break_it, message = RECORDINGS[wrong]
    folder = tmp_path / "rec"
    shutil.copytree(made, folder)
    break_it(folder)
    refused_and_unchanged(capsys, [verb, str(folder)], message, folder)


# Words of a command -> what the line must say. $REC is a good recording, $NEW a free place, $BAD a
# file of the test's own, $PIPE, $SPARSE (10 GB), $FOLDER and $FULL (a folder of somebody's) exist.
WORDS: list[tuple[str, str]] = [
    ("info", "RECORDING"),
    ("info $NEW", "no such folder"),
    ("info $BAD", "found a file"),
    (f"info a{ESCAPE}b", r"a\\x1b\[2Jb: no such folder"),
    (f"info {HUGE}", "too long"),
    ("info \udcff", r"\\udcff: no such folder"),
    ("infx $REC", "infx"),
    ("simulate", "DEST"),
    ("simulate $FULL", "exists and is not empty"),
    ("simulate $FULL --overwrite", "holds no recording.toml"),
    ("simulate $BAD", "found a file"),
    ("simulate $BAD/x", "bad/x: cannot be written"),
    ("simulate $LINK", "symbolic link"),
    ("simulate $NEW --people 1.5", "not a whole number"),
    ("simulate $NEW --seconds 1e300", "seconds: found"),
    ("simulate $NEW --seconds \u22121", "seconds"),
    (f"simulate $NEW --seed {HUGE}", "seed"),
    ("simulate $NEW --scene ../x", "scene: found"),
    ("simulate $NEW --resolution 0x0", "image width: found 0"),
    ("simulate $NEW --resolution big", "resolution: found 'big'"),
    ("simulate $NEW --calibration missing.toml", "missing.toml"),
    ("simulate $NEW --calibration missing.toml --cameras 3", "--cameras: found 3"),
    ("simulate $NEW --calibration $PIPE", "pipe: found a pipe"),
    ("simulate $NEW --calibration $SPARSE", "found 10737418240 bytes"),
    ("simulate $NEW --calibration $EMPTY", "empty: file is empty"),
    ("simulate $NEW --calibration $LAUGHS", "document type"),
    ("simulate $NEW --calibration $ALIASES", "alias"),
    ("simulate $NEW --calibration $DEEP", "deep: "),
    ("simulate $NEW --calibration $FAR", "far: camera a: "),
    ("import shelf $EMPTY $NEW", "found no .npz"),
    ("import shelf $PIPE $NEW", "found a pipe"),
    ("import shelf $SPARSE $NEW", "found 10737418240 bytes"),
    ("import shelf $PICKLE $NEW", "array 'K': found object"),
    ("import shelf $LIES $NEW", "array 'K': header promises"),
    ("import shelf $BOMB $NEW", "array 'R' is missing"),
    ("import shelf $BAD $BAD", "found a file"),
    ("import shelf $BAD $NEW --skeleton x", "skeleton"),
    (f"import panoptic $BAD $NEW --cameras {HUGE}", "bad: found no .npz"),
    ("import openpose $FULL $NEW --calibration $RIG --fps nan", "--fps: found nan"),
    ("import openpose $FULL $NEW --calibration $RIG --fps 1e-300", "--fps: found 1e-300"),
    ("import coco $DEEP $NEW --calibration $RIG --fps 1e-300", "--fps: found 1e-300"),
    ("detect cam0=$BAD $NEW --calibration $RIG --fps 1e-300", "fps: found 1e-300"),
    ("import openpose $FULL $NEW --calibration $RIG --fps 25", "cameras without a folder: cam0"),
    ("import openpose $FULL $NEW --calibration $RIG --fps 25 --folder ../x", "--folder: found"),
    ("import openpose $FULL $NEW --calibration $RIG --fps 25 --folder a:b", "found 'a:b'"),
    ("import openpose $FULL $NEW --calibration absent.toml --fps 25", "absent.toml"),
    ("import openpose $FULL $NEW --calibration $RIG --fps fast", "fps"),
    ("import openpose $FULL $NEW --calibration $RIG", "fps"),
    ("import coco $DEEP $NEW --calibration $RIG --fps 25", "deep: "),
    ("import coco $PIPE $NEW --calibration $RIG --fps 25", "found a pipe"),
    ("detect", "VIDEO"),
    ("detect $BAD --calibration $RIG", "found 1 path, expected videos, then the folder to"),
    ("detect $BAD $FULL --calibration $RIG", "exists and is not empty"),
    ("detect cam0=$BAD $NEW --calibration $RIG --every 1.5", "not a whole number"),
    ("detect cam0=$BAD $NEW --calibration $RIG --every 0", "every"),
    ("detect cam0=$BAD $NEW --calibration $RIG --link-videos --copy-videos", "at most one"),
    ("detect cam0=$BAD $NEW --calibration $RIG --offset cam0", "CAMERA=SECONDS"),
    ("detect cam0=$BAD $NEW --calibration $RIG --offset cam0=x", "--offset: found.*CAMERA=SECONDS"),
    ("detect cam0=$BAD $NEW --calibration $RIG --rotation cam0", "CAMERA=DEGREES"),
    ("detect cam0=$BAD $NEW --calibration $RIG --rotation cam0=45", "with 0, 90, 180 or 270"),
    ("detect cam0=$BAD $NEW --calibration $RIG --rotation cam0=-90", "CAMERA=DEGREES"),
    ("detect cam0=$BAD $NEW --calibration $RIG --rotation =90", "CAMERA=DEGREES"),
    ("detect cam0=$BAD $NEW --calibration $RIG --model x.onnx --family nonsense", "nonsense"),
    ("calibrate intrinsics $FULL", r"VIDEO\.\.\. DEST: found 1 path"),
    ("calibrate intrinsics $FULL lenses.txt", "expected a calibration file to write, .toml"),
    ("calibrate intrinsics $FULL $NEW.toml --board a4", "expected a name as it is printed"),
    ("calibrate intrinsics $FULL $NEW.toml --frames 1", "--frames: found 1"),
    ("calibrate intrinsics $NEW.mp4 $NEW.toml", "found no file"),
    ("calibrate intrinsics $FULL $NEW.toml --picture a.pdf", "--picture: found 'a.pdf'"),
    ("detect cam0=$BAD $NEW --calibration $RIG --model ../x", r"\.\./x"),
    ("models pull ../x", r"\.\./x"),
    ("models path nosuch", "nosuch"),
    ("replay $REC --cameras 0", "--cameras: found 0"),
    ("replay $REC --cameras 1000000000", "--cameras: found"),
    ("replay $REC --budget nan", "--budget: found nan"),
    ("replay $REC --budget -1", "--budget: found -1"),
    ("replay $REC --quality-weight inf", "--quality-weight: found inf"),
    ("replay $REC --lead 0", "--lead: found 0"),
    (f"replay $REC --lead {HUGE}", "not a whole number"),
    ("replay $REC --warmup -1", "--warmup: found -1"),
    ("replay $REC --phase 99999999999999999999", "--phase: found 9"),
    ("replay $REC --seed -1", "--seed: found -1"),
    ("replay $REC --predictor=", "--predictor: found ''"),
    ("replay $REC --pipeline x", "--pipeline: found 'x'"),
    (f"replay $REC --idle-mode {ESCAPE}", "idle-mode"),
    ("replay $REC --profile $PIPE", "pipe: "),
    ("replay $REC --profile $DEEP", "deep: "),
    ("replay $REC --battery-wh nan", "--battery-wh: found 'nan'"),
    ("replay $REC --poses $NEW.txt", "expected .csv or .parquet"),
    ("replay $REC --report $NEW.txt", "ending in .html"),
    ("replay $REC --json $FOLDER", "found a folder"),
    ("replay $REC --json $PIPE", "found a pipe"),
    ("replay $REC --json $BAD/x", "is a file"),
    ("replay $REC --json $REC/recording.toml", "a file of the recording"),
    ("replay $REC --json $NEW.csv --poses $NEW.csv", "--json: found the file of --poses"),
    ("replay $REC --json $NEW --json $NEW.2", "multiple times"),
    ("evaluate $REC --policies=", "--policies: found ''"),
    ("evaluate $REC --jobs 1000000000", "--jobs: found"),
    ("evaluate $REC --json $FOLDER", "found a folder"),
]


@each_case(("words", "message"), WORDS)
def test_a_bad_command_gets_one_line_and_leaves_nothing(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str, message: str
) -> None:
    places = {"REC": made, "RIG": made / RIG, **traps(tmp_path)}
    filled = [re.sub(r"\$([A-Z]+)", lambda m: str(places[m[1]]), word) for word in words.split()]
    refused_and_unchanged(capsys, filled, message, tmp_path, made)


def test_group_without_a_verb_lists_its_verbs(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("import") == 0
    out, err = capsys.readouterr()
    assert not err and "shelf" in out and "panoptic" in out


def traps(folder: Path) -> dict[str, Path]:
    names = "NEW BAD EMPTY PIPE SPARSE FOLDER FULL LINK LAUGHS ALIASES DEEP PICKLE LIES BOMB FAR"
    places = {name: folder / name.lower() for name in names.split()}
    places["BAD"].write_text("bad\n")
    places["EMPTY"].touch()
    os.mkfifo(places["PIPE"])
    with places["SPARSE"].open("wb") as file:
        file.truncate(10 * 2**30)
    places["FOLDER"].mkdir()
    places["FULL"].mkdir()
    (places["FULL"] / "thesis.txt").touch()
    places["LINK"].symlink_to(places["FULL"])
    places["LAUGHS"].write_text(LAUGHS)
    places["ALIASES"].write_text("a: &a [1, 2]\nb: [*a, *a]\n")
    places["DEEP"].write_text("[" * 100_000)
    places["FAR"].write_text(
        '[a]\nname = "a"\nsize = [640, 480]\nmatrix = [[600, 0, 320], [0, 600, 240], [0, 0, 1]]\n'
        "distortions = []\nrotation = [[1e200, 1e200, 0], [1e200, 0, 1e200], [0, 1, 1]]\n"
        "translation = [1e300, -1e300, 1e300]\n"
    )
    with places["PICKLE"].open("wb") as file:
        np.savez(file, K=np.array([{}], dtype=object))
    npy(places["LIES"], "(1000000000000, 3, 3)", 72)
    places["BOMB"].write_bytes(bomb())
    return places


@functools.cache
def bomb() -> bytes:
    """Return an archive of sixteen megabytes of nothing, which take long to pack."""
    file = io.BytesIO()
    npy(file, "(5, 3, 3)", 2**24)
    return file.getvalue()


def npy(path: Path | io.BytesIO, shape: str, num_bytes: int) -> None:
    """Write an array K whose header says `shape` above `num_bytes` zeros, which pack to nothing."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}\n".encode()
    start = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("K.npy", start + bytes(num_bytes))


def test_output_that_cannot_be_shown_is_no_error(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", shown)
    with pytest.raises(SystemExit, match="0"):
        main(["info", str(made)])
    assert b"cam2" in shown.buffer.getvalue()


def test_a_closed_output_is_no_error(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout", None)
    with pytest.raises(SystemExit, match="0"):
        main(["info", str(made)])
    sys.stdout.close()  # which `main` opened


def test_an_interruption_says_so(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("e3pose.cli.information.load_recording", interrupt)
    assert run("info", made) == 130
    assert capsys.readouterr() == ("", "e3pose: interrupted\n")
