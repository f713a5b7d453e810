"""Measured processor time goes with a recording, in a file that older programs pass over."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.recording import ProcessorTime, Recording, load_recording, save_recording
from e3pose.recording.processor import FILE, load_processor

TIMES = {"cam0": ProcessorTime(0.168, 0.015, 30), "cam2": ProcessorTime(0.2, 0.0, 1)}


def test_what_was_measured_comes_back(scene: Recording, tmp_path: Path) -> None:
    save_recording(replace(scene, processor=TIMES), tmp_path / "rec")
    assert load_recording(tmp_path / "rec").processor == TIMES


def test_nothing_is_written_where_nothing_was_measured(scene: Recording, tmp_path: Path) -> None:
    save_recording(scene, tmp_path / "rec")
    assert not (tmp_path / "rec" / FILE).exists()
    assert load_recording(tmp_path / "rec").processor == {}


@each_case(
    "old, new, named",
    [
        ("cam2", "cam9", "cam9"),
        ("version = 1", "version = 2", "version"),
        ("looks = 30", "looks = 0", "0 looks"),
        ("look_s = 0.168", "look_s = -1.0", "-1.0"),
        ("look_s = 0.168", "look_s = nan", "nan"),
        ("look_s = 0.168", "", "look_s"),
        ("[cameras", "[[", FILE),
    ],
)
def test_a_broken_file_is_named(
    scene: Recording, tmp_path: Path, old: str, new: str, named: str
) -> None:
    save_recording(replace(scene, processor=TIMES), tmp_path / "rec")
    file = tmp_path / "rec" / FILE
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=FILE) as error:
        load_recording(tmp_path / "rec")
    assert named in str(error.value)


def test_the_documented_example_is_one(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs/reference/recording-format.md").read_text()
    _, example = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    (tmp_path / FILE).write_text(example)
    assert load_processor(tmp_path, ("cam1",)) == {"cam1": ProcessorTime(0.168, 0.015, 30)}
