"""`e3pose train`: options are checked before anything heavy is loaded."""

from __future__ import annotations

from pathlib import Path

import pytest

from e3pose.cli.training import train
from e3pose.errors import InputError


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("hold_out", 0.95),
        ("hold_out", float("nan")),
        ("history", 3),
        ("leads", 0),
        ("hidden", 100_000),
        ("steps", 0),
        ("minutes", 0.0),
        ("batch", 1),
        ("seed", -1),
        ("combinations", 0),
        ("jobs", 0),
    ],
)
def test_an_impossible_option_is_named(tmp_path: Path, option: str, value: float) -> None:
    with pytest.raises(InputError, match=f"--{option.replace('_', '-')}: found"):
        train([tmp_path], out=tmp_path / "out", **{option: value})  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()
