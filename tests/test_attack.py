"""The attack of `make attack`, for some seconds: what it does without a network."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def inputs() -> Iterator[ModuleType]:
    path = str(Path(__file__).parents[1] / "benchmarks")
    sys.path.insert(0, path)
    try:
        import attack_inputs

        yield attack_inputs
    finally:
        sys.path.remove(path)


def test_decoders_raise_nothing_but_input_errors(inputs: ModuleType) -> None:
    result = inputs.fuzz(seconds=60.0, decodes=20_000, seed=3)
    assert result.held, result.figures
    assert result.figures.startswith("20")  # thousand and a few, of all kinds


def test_an_attack_that_gets_through_is_told(
    inputs: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(message: object) -> None:
        raise OverflowError("cannot convert float infinity to integer")

    monkeypatch.setattr(inputs, "used", broken)
    result = inputs.fuzz(seconds=60.0, decodes=1000, seed=3)
    assert not result.held and "OverflowError: cannot convert" in result.figures


def test_damaged_files_end_in_one_line(inputs: ModuleType) -> None:
    result = inputs.hostile_files(seconds=4.0, seed=3)
    assert result.held, result.figures
