"""The documentation's examples are run, and its tables compared with the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from e3pose.model.skeleton import SKELETONS, SkeletonFile
from e3pose.recording import load_recording
from e3pose.recording.folder import Header
from e3pose.recording.json_lines import TruthLine, ViewLine

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "reference" / "recording-format.md").read_text()
WORLD = (ROOT / "src" / "e3pose" / "recording" / "calibration" / "world.py").read_text()
SOURCE = (ROOT / "src" / "e3pose" / "recording" / "problems.py").read_text()


def test_the_python_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"<!-- tested -->\n```python\n(.*?)```", TEXT, re.DOTALL)
    exec(compile(example, "recording-format.md", "exec"), {})
    assert load_recording(tmp_path / "walk").name == "a test"


def test_the_header_example_is_one(tmp_path: Path) -> None:
    import msgspec

    example = re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)[0]
    header = msgspec.toml.decode(example.encode(), type=Header)
    for field in Header.__struct_fields__:
        assert f"`{field}`" in TEXT or f"`[{field}]`" in TEXT, field
        assert getattr(header, field) is not None


def test_the_line_examples_are_ones() -> None:
    import msgspec

    view, truth = re.findall(r"```json\n(.*?)\n```", TEXT, re.DOTALL)
    assert msgspec.json.decode(view, type=ViewLine).slot == 0
    assert msgspec.json.decode(truth, type=TruthLine).slot == 0


def test_every_skeleton_and_kind_of_problem_is_explained() -> None:
    kinds = set(re.findall(r'Problem\(\s*"([a-z-]+)"', SOURCE))
    kinds |= set(re.findall(r'return "([a-z-]+)", \(', WORLD))
    assert len(kinds) >= 20
    for name in kinds:
        assert f"`{name}`" in TEXT, name
    skeletons = (ROOT / "docs" / "reference" / "skeletons.md").read_text()
    for name in {*SKELETONS, *SkeletonFile.__struct_fields__} - {"format", "version"}:
        assert f"`{name}`" in skeletons or f"`[{name}]`" in skeletons, name
