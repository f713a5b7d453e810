"""Whatever is wrong with a calibration, one line names the file, the camera and the field."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.cases import each_case
from tests.recording.calibration.known_rigs import KNOWN, POINTS_M, pixels, with_second, write
from tests.recording.calibration.test_calibration_formats import CONTENTS
from tests.recording.detections.test_detections import mutated, mutated_bytes

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.recording.calibration import FORMATS, load_calibration, load_rig

pytestmark = pytest.mark.slow

NAMES = sorted(FORMATS)
INTRINSICS = np.array([[1200.0, 0.0, 960.0], [0.0, 1200.0, 540.0], [0.0, 0.0, 1.0]])
NAN = float("nan")


def refusal(path: Path, format: str | None = None) -> str:
    with pytest.raises(InputError) as caught:
        load_rig(path, format)
    message = str(caught.value)
    assert str(path.parent) in message, "the file is named"
    assert "\n" not in message
    assert len(message) < 900
    return message


def intrinsics(**entries: float) -> Any:
    K = INTRINSICS.copy()
    for name, value in entries.items():
        K[{"fx": (0, 0), "fy": (1, 1), "cx": (0, 2)}[name]] = value
    return K


WRONG_FIELDS: dict[str, tuple[dict[str, Any], tuple[str, ...], tuple[str, ...]]] = {
    # changes to the second camera, words that tell the field, formats that cannot express it
    "singular matrix": ({"K": intrinsics(fx=0.0)}, ("positive focal",), ()),
    "negative focal length": ({"K": intrinsics(fy=-1200.0)}, ("positive focal",), ()),
    "focal length in millimetres": ({"K": intrinsics(fx=8.0, fy=8.0)}, ("focal length",), ()),
    "matrix with NaN": ({"K": intrinsics(cx=NAN)}, ("finite", "not TOML", "number"), ()),
    "infinite matrix": ({"K": intrinsics(fx=float("inf"))}, ("finite", "number"), ()),
    "enormous matrix": ({"K": intrinsics(fx=1e300)}, ("focal length",), ()),
    "matrix is absent": ({"K": None}, ("matrix", "K", "intrinsic"), ()),
    "rotation of zeros": ({"R": np.zeros((3, 3))}, ("rotation", "otation", "Rot", "R:"), ()),
    "sheared rotation": (
        {"R": np.array([[1.0, 0.4, 0], [0, 1, 0], [0, 0, 1]])},
        ("orthonormal",),
        ("anipose", "pose2sim", "caliscope"),
    ),
    "mirror": ({"R": np.diag([1.0, 1.0, -1.0])}, ("mirror",), ("anipose", "pose2sim", "caliscope")),
    "rotation is absent": ({"R": None}, ("rotation", "R", "transform"), ()),
    "translation is absent": ({"t": None}, ("translation", "t:", "T", "transform"), ()),
    "translation with NaN": ({"t": np.array([0.0, NAN, 4.0])}, ("finite", "number"), ()),
    "translation of two": ({"t": np.array([1.0, 2.0])}, ("shape (2,", "(3,)"), ("qualisys",)),
    "translation of 1e300": ({"t": np.array([1e300, 1e300, 0.0])}, ("ranslation", "finite"), ()),
    "three distortion coefficients": (
        {"distortion": [0.1, 0.2, 0.3]},
        ("distortion: found 3 coefficients",),
        ("qualisys",),
    ),
    "NaN distortion": ({"distortion": [NAN, 0.0, 0, 0, 0]}, ("finite", "number"), ()),
    "enormous distortion": ({"distortion": [1e30, 0.0, 0, 0, 0]}, ("distortion",), ()),
    "image without width": ({"size": (0, 1080)}, ("size",), ()),
    "image of a million": ({"size": (10**6, 1080)}, ("size",), ()),
}


@each_case(
    ("wrong", "name"),
    [
        (wrong, name)
        for wrong in WRONG_FIELDS
        for name in NAMES
        if name not in WRONG_FIELDS[wrong][2]
    ],
)
def test_wrong_field_is_named_with_its_camera(tmp_path: Path, wrong: str, name: str) -> None:
    changes, words, _ = WRONG_FIELDS[wrong]
    message = refusal(write(name, tmp_path, with_second(**changes)), name)
    assert any(word in message for word in words), message
    if "not TOML" not in message:
        camera = {"anipose": "cam_1", "caliscope": "1"}.get(name, "hall_2")
        assert camera in message or "hall_2" in message or "number 2" in message, message


@each_case("name", NAMES)
@each_case(
    ("found", "camera_id"),
    [
        ("../../x", "_.._x"), ("/etc/passwd", "_etc_passwd"), (".hidden", "hidden"), ("-rf", "rf"),
        ("Cam 2", "Cam_2"), ("Küche", "Kuche"), ("x" * 65, "x" * 64), ("a\\b", "a_b"),
        ("con:1", "con_1"),
    ],
)  # fmt: skip
def test_name_that_is_no_file_name_becomes_a_safe_id(
    tmp_path: Path, name: str, found: str, camera_id: str
) -> None:
    if name == "easymocap" and found in ("con:1",):
        return  # its fields are called after cameras, and this would end one
    known = load_calibration(write(name, tmp_path, with_second(name=found)), name)
    assert camera_id in known.rig.camera_ids
    assert any(f"is called {camera_id}" in note for note in known.notes)


@each_case("name", NAMES)
@each_case(
    ("found", "words"),
    [*((found, "1 to 64 letters|name") for found in ("", "//", "-")), ("hall_1", "twice")],
)
def test_name_of_which_nothing_is_left_or_that_is_taken_is_refused(
    tmp_path: Path, name: str, found: str, words: str
) -> None:
    message = refusal(write(name, tmp_path, with_second(name=found)), name)
    assert re.search(words, message), message


@each_case("name", NAMES)
@each_case(
    ("factor", "words"),
    [
        (1000.0, "translation.*millimetres or centimetres"),
        (100.0, "translation.*millimetres or centimetres"),
        (0.001, "other units"),  # cameras in one spot
    ],
)
def test_lengths_in_other_units_are_noticed(
    tmp_path: Path, name: str, factor: float, words: str
) -> None:
    cameras = tuple(replace(known, t=known.t * factor) for known in KNOWN)
    message = refusal(write(name, tmp_path, cameras), name)
    assert re.search(words, message), message


@each_case("forced", [True, False], ids=["forced", "recognised"])
@each_case("name", NAMES)
def test_truncated_file_is_refused_or_whole_up_to_there(
    tmp_path: Path, name: str, forced: bool
) -> None:
    path = write(name, tmp_path)
    whole = path.read_bytes()
    refused = 0
    for cut in np.linspace(0, len(whole) - 2, 12).astype(int):
        path.write_bytes(whole[:cut])
        try:
            rig = load_rig(path, name if forced else None)
        except InputError as error:
            refused += 1
            assert str(tmp_path) in str(error)
        else:  # a cut between two cameras looks like a smaller rig
            assert isinstance(rig, Rig)
            for known, found_px in zip(KNOWN, rig.project(POINTS_M), strict=False):
                np.testing.assert_allclose(found_px, pixels(known))
    assert refused > 7


@each_case("form", [*NAMES, *CONTENTS])
def test_odd_calibrations_are_read_or_named(tmp_path: Path, form: str) -> None:
    rng, read = np.random.default_rng(len(form)), 0
    path = tmp_path / "rig.yaml" if form in CONTENTS else write(form, tmp_path)
    whole, content = path.read_bytes() if form not in CONTENTS else b"", CONTENTS.get(form)
    for trial in range(30):
        if content is None:
            path.write_bytes(mutated_bytes(whole, rng))
        else:
            changed = mutated(mutated(content(KNOWN), rng), rng)
            as_yaml = form == "kalibr" or trial % 2
            text = json.dumps(changed)
            path.write_text(yaml.safe_dump(json.loads(text)) if as_yaml else text)
        try:
            read += len(load_calibration(path).rig) > 0
        except InputError as error:
            assert str(tmp_path) in str(error) and "\n" not in str(error) and len(str(error)) < 900
    assert read > 0


WHOLE_FILES: dict[str, bytes] = {
    "empty": b"",
    "blank": b" \n\n",
    "binary": bytes(range(256)) * 20,
    "zeros": bytes(1000),
    "utf-16": "[cam_0]\nname='a'".encode("utf-16"),
    "number": b"42",
    "prose": b"once upon a time there was no calibration",
    "empty object": b"{}",
    "no cameras": b'{"cameras": []}',
    "cameras is a number": b'{"cameras": 3}',
    "camera is a number": b'{"cameras": [3]}',
    "null camera": b'{"cameras": [{"name": null}]}',
    "deep json": b'{"cameras": ' + b"[" * 200_000,
    "deep toml": b"a = " + b"[" * 100_000,
    "deep yaml": b"%YAML:1.0\n---\na: " + b"[" * 50_000,
    "deep xml": b"<a>" * 200_000,
    "toml without cameras": b"[metadata]\nadjusted = true\n",
    "toml of a number": b"a = 3\n",
    "toml with a key twice": b"[cam_0]\nname = 'a'\nname = 'b'\n",
    "toml with a huge integer": b"[cam_0]\nsize = [1" + b"0" * 5000 + b", 2]\n",
    "json with a huge integer": b'{"cameras": [{"name": 1' + b"0" * 5000 + b"}]}",
    "json with a field twice": b'{"cameras": [], "cameras": []}',
    "other xml": b"<svg/>",
    "xml without cameras": b"<calibration/>",
    "camera without anything": b"<calibration><cameras><camera/></cameras></calibration>",
    "entity bomb": b'<!DOCTYPE a [<!ENTITY b "bbbb"><!ENTITY c "&b;&b;">]><calibration>&c;'
    b"</calibration>",
    "external entity": b'<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]>'
    b"<calibration>&b;</calibration>",
    "alias bomb": b"%YAML:1.0\n---\na: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n",
    "python object": b"%YAML:1.0\n---\na: !!python/object/apply:os.system ['false']\n",
    "yaml list": b"---\n- 1\n- 2\n",
    "yaml field twice": b"---\nK: 1\nK: 2\n",
    "yaml of nulls": b"%YAML:1.0\n---\nnames:\n",
    "yaml names are lists": b"%YAML:1.0\n---\nnames: [[a], [b]]\n",
    "yaml matrix lies": b"---\ncamera_matrix: !!opencv-matrix\n  rows: 1000000000\n"
    b"  cols: 1000000000\n  data: [1.]\nimage_width: 9\nimage_height: 9\n",
}


@each_case("forced", [*NAMES, None])
@each_case("content", WHOLE_FILES)
def test_no_content_gets_past_any_reader(tmp_path: Path, content: str, forced: str | None) -> None:
    path = tmp_path / ("intri.yml" if forced == "easymocap" else "rig.any")
    path.write_bytes(WHOLE_FILES[content])
    (tmp_path / "extri.yml").write_bytes(WHOLE_FILES[content])
    refusal(path, forced)


@each_case("forced", [*NAMES, None])
def test_enormous_missing_and_unreadable_files(tmp_path: Path, forced: str | None) -> None:
    huge = tmp_path / "intri.yml"
    with huge.open("wb") as file:
        file.truncate(100_000_000)
    assert "expected at most" in refusal(huge, forced)
    assert "not found" in refusal(tmp_path / "none" / "intri.yml", forced)
    (tmp_path / "folder").mkdir()
    refusal(tmp_path / "folder", forced)


def test_unknown_format_lists_the_known(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"anipose.*opencv"):
        load_rig(tmp_path / "a.toml", format="vicon")


@each_case(
    ("name", "extra", "said"),
    [
        *(
            ("caliscope", {"rotation_count": count}, "camera 1: rotation_count: .*expected quarter")
            for count in (4, -4, 0.5, "x", True, [1])
        ),
        ("qualisys", {"viewrotation": "90"}, "hall_2.*viewrotation"),
        ("qualisys", {"video_resolution": "540p"}, "hall_2.*video_resolution"),
        ("anipose", {"fisheye": "yes"}, "camera cam_1: fisheye"),
        ("opencv", {"distortion_model": "omni"}, "hall_2: distortion_model: found 'omni'"),
    ],
)
def test_what_a_format_says_beyond_the_lens_is_checked(
    tmp_path: Path, name: str, extra: dict[str, Any], said: str
) -> None:
    message = refusal(write(name, tmp_path, with_second(extra=extra)))
    assert re.search(said, message), message


def test_unknown_units_are_refused(tmp_path: Path) -> None:
    path = write("anipose", tmp_path)
    path.write_text(path.read_text() + 'units = "inches"\n')
    assert "units: found 'inches', expected m, cm or mm" in refusal(path)


@pytest.mark.parametrize("format", ["e3pose-site", "e3pose-recording"])
def test_a_file_of_another_kind_is_no_calibration(tmp_path: Path, format: str) -> None:
    path = tmp_path / "site.toml"
    path.write_text(f'name = "lab"\nversion = 1\nformat = "{format}"\n')
    with pytest.raises(InputError) as caught:
        load_rig(path)
    wanted = f"found a file of the format '{format}', expected a calibration file, such as rig.toml"
    assert str(caught.value) == f"{path}: {wanted}"
