from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from e3pose.base.atomic import atomic_file, atomic_folder, check_free, write_file
from e3pose.base.errors import InputError


def _recording(path: Path) -> Path:
    path.mkdir()
    (path / "recording.toml").write_text("old")
    return path


def test_folder_appears_whole_when_the_block_ends_and_not_at_all_where_it_fails(
    tmp_path: Path,
) -> None:
    with pytest.raises(RuntimeError), atomic_folder(tmp_path / "failed") as folder:
        (folder / "x").write_text("1")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    with atomic_folder(tmp_path / "a" / "b") as folder:
        (folder / "x").write_text("1")
        assert not (tmp_path / "a" / "b").exists()
    assert (tmp_path / "a" / "b" / "x").read_text() == "1"
    assert [entry.name for entry in (tmp_path / "a").iterdir()] == ["b"]


def test_a_folder_of_ours_is_replaced_only_on_request(tmp_path: Path) -> None:
    old = _recording(tmp_path / "a")
    with pytest.raises(InputError, match="--overwrite"), atomic_folder(old):
        pass
    with atomic_folder(old, overwrite=True) as folder:
        (folder / "new").write_text("1")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a"]
    assert [entry.name for entry in old.iterdir()] == ["new"]


def test_a_folder_of_somebody_else_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match="will not be replaced"):
        check_free(tmp_path, overwrite=True)
    with (
        pytest.raises(InputError, match=r"no report\.html"),
        atomic_folder(tmp_path, overwrite=True, ours=("report.html",)),
    ):
        pass
    assert (tmp_path / "thesis.tex").read_text() == "precious"


def test_a_folder_that_fills_up_meanwhile_is_not_lost(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not empty"), atomic_folder(tmp_path / "a"):
        (tmp_path / "a").mkdir()
        (tmp_path / "a" / "theirs").write_text("1")
    assert (tmp_path / "a" / "theirs").read_text() == "1"


def test_the_old_folder_comes_back_when_the_new_one_cannot_take_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = _recording(tmp_path / "a")
    replace = os.replace

    def fail_on_new(source: Any, target: Any) -> None:
        if (Path(source) / "new").exists():
            raise OSError("disk on fire")
        replace(source, target)

    monkeypatch.setattr("e3pose.base.atomic.os.replace", fail_on_new)
    with (
        pytest.raises(InputError, match=r"a: .*on fire"),
        atomic_folder(old, overwrite=True) as folder,
    ):
        (folder / "new").write_text("1")
    assert (old / "recording.toml").read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a"]


def test_a_link_is_not_written_through(tmp_path: Path) -> None:
    target = _recording(tmp_path / "target")
    (tmp_path / "link").symlink_to(target)
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    for name in ("link", "dangling"):
        with pytest.raises(InputError, match="symbolic link"):
            check_free(tmp_path / name, overwrite=True)


def test_a_file_stays_as_it_was_when_the_block_fails(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text("old")
    with pytest.raises(RuntimeError), atomic_file(path) as temporary:
        temporary.write_text("new")
        raise RuntimeError
    assert path.read_text() == "old"
    write_file(path, "über")
    assert path.read_bytes() == "über".encode()
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.json"]


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """What was put on the disk and what was renamed, in order."""
    done: list[tuple[str, str]] = []
    fsync, replace = os.fsync, os.replace

    def note_sync(handle: int) -> None:
        done.append(("sync", Path(os.readlink(f"/proc/self/fd/{handle}")).name))
        fsync(handle)

    def note_replace(source: Any, target: Any) -> None:
        done.append(("replace", Path(target).name))
        replace(source, target)

    monkeypatch.setattr("e3pose.base.atomic.os.fsync", note_sync)
    monkeypatch.setattr("e3pose.base.atomic.os.replace", note_replace)
    return done


def test_a_file_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, synced: list[tuple[str, str]]
) -> None:
    with atomic_file(tmp_path / "state.npz") as temporary:
        temporary.write_bytes(b"1")
    assert synced == [
        ("sync", temporary.name),
        ("replace", "state.npz"),
        ("sync", tmp_path.name),
    ]


def test_a_folder_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, synced: list[tuple[str, str]]
) -> None:
    with atomic_folder(tmp_path / "a") as folder:
        (folder / "b").mkdir()
        (folder / "b" / "x").write_text("1")
        (folder / "b" / "elsewhere").symlink_to("/dev/zero")
    renamed = synced.index(("replace", "a"))
    assert {name for _, name in synced[:renamed]} == {"x", "b", folder.name}
    assert synced[renamed + 1 :] == [("sync", tmp_path.name)]


def test_private_files_are_for_their_owner_or_the_group_of_their_folder(tmp_path: Path) -> None:
    old = os.umask(0)
    try:
        for above, file, folder in ((0o777, 0o600, 0o700), (0o2777, 0o640, 0o2750)):
            place = tmp_path / f"{above:o}"
            place.mkdir()
            place.chmod(above)
            write_file(place / "new" / "state.npz", b"1", private=True)
            with atomic_folder(place / "site", private=True):
                pass
            found = [place / "new" / "state.npz", place / "new", place / "site"]
            modes = [path.stat().st_mode & 0o7777 for path in found]
            assert modes == [file, folder, folder]
    finally:
        os.umask(old)
