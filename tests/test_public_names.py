"""What a person sees who tries the package in an interpreter."""

from __future__ import annotations

import re

import e3pose
from e3pose.simulate import SceneSettings, simulate


def test_public_names_are_listed_and_there() -> None:
    names = dir(e3pose)
    assert "replay" in names and "annotations" not in names and "importlib" not in names
    assert all(hasattr(e3pose, name) for name in names)


def test_a_recording_shows_itself_in_a_line() -> None:
    shown = repr(simulate(SceneSettings(people=1, seconds=1.0, fps=10, cameras=2), 0))
    assert len(shown) < 100 and "\n" not in shown
    assert re.fullmatch(r"<Recording '.+': 2 cameras, 10 slots at 10 fps, truth of \d+>", shown)
