"""Pictures: short numbers where nobody reads them, whole ones where people do."""

from __future__ import annotations

from pathlib import Path

from e3pose_lab.evaluate.drawing import picture


def test_labels_keep_their_digits_and_paths_lose_theirs(tmp_path: Path) -> None:
    path = tmp_path / "small.svg"
    with picture(path, 3.0, 2.0) as figure:
        axes = figure.subplots()
        axes.plot([0, 1, 2], [0.0475, 0.0483, 0.0525])
        axes.set_yticks([0.0475, 0.0525])
    text = path.read_text()
    assert ">0.0475<" in text and ">0.0525<" in text
    words = [word for part in text.split(' d="')[1:] for word in part.split('"')[0].split()]
    assert words and not any(len(word.partition(".")[2]) > 2 for word in words)
