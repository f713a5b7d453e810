"""The examples run and say what they promise."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


def test_triangulate_example_finds_the_people(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / "01_triangulate.py"), run_name="__main__")
    output = capsys.readouterr().out
    numbers = re.search(r"found (\d+) of (\d+) people, mean joint error (\d+) mm", output)
    assert numbers is not None
    found, people, error_mm = map(int, numbers.groups())
    assert people == 200 and found >= 190
    assert error_mm < 40
