"""Files that others replace: loaded once for each change, refused once for each reason."""

from __future__ import annotations

from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.version import Watched


def test_files_are_loaded_again_once_they_changed_and_a_reason_is_told_once(tmp_path: Path) -> None:
    path, loaded, refused = tmp_path / "list", list[str](), list[str]()
    path.write_text("a")

    def load() -> None:
        if path.read_text() == "wrong":
            raise InputError("wrong")
        loaded.append(path.read_text())

    watched = Watched((path,), load, refused.append)
    watched.update()
    assert not loaded
    path.write_text("b, longer")
    watched.update()
    watched.update()
    assert loaded == ["b, longer"]
    for _ in range(2):
        path.write_text("wrong")
        watched.update()
        watched.update()
    assert refused == ["wrong"]
    path.unlink()  # being replaced
    watched.update()
    path.write_text("c")
    watched.update()
    assert loaded == ["b, longer", "c"] and refused == ["wrong"]
