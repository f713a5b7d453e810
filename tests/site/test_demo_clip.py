"""The clip of the demo: what is fetched is verified."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from e3pose.base.errors import InputError
from e3pose.site.demo_clip import CALIBRATION, TOP, VIDEOS, Member, extract_members, find_clip


def wheel(path: Path, contents: dict[str, bytes]) -> tuple[Member, ...]:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(TOP + name, content)
        archive.writestr("../../evil.txt", b"evil")
    return tuple(Member(n, len(c), hashlib.sha256(c).hexdigest()) for n, c in contents.items())


def test_only_the_members_wanted_are_unpacked(tmp_path: Path) -> None:
    path, dest = tmp_path / "p.whl", tmp_path / "out"
    members = wheel(path, {"videos/a.mp4": b"film", "calibration/c.txt": b"rig", "x.py": b"code"})
    extract_members(path, members[:2], dest)
    assert {p.name: p.read_bytes() for p in dest.iterdir()} == {"a.mp4": b"film", "c.txt": b"rig"}


def altered(member: Member) -> Member:
    return Member(member.name, member.size_bytes, "0" * 64)


def longer(member: Member) -> Member:
    return Member(member.name, member.size_bytes - 1, member.sha256)


def missing(member: Member) -> Member:
    return Member("videos/none.mp4", member.size_bytes, member.sha256)


@pytest.mark.parametrize("change", [altered, longer, missing])
def test_other_member_than_expected_is_refused(
    change: Callable[[Member], Member], tmp_path: Path
) -> None:
    path = tmp_path / "p.whl"
    (member,) = wheel(path, {"videos/a.mp4": b"film" * 100})
    with pytest.raises(InputError, match=r"p\.whl: videos/"):
        extract_members(path, (change(member),), tmp_path / "out")
    assert not (tmp_path / "out" / "a.mp4").exists()


@pytest.mark.parametrize("keep", [0, 30, 200])
def test_truncated_wheel_is_refused(keep: int, tmp_path: Path) -> None:
    path = tmp_path / "p.whl"
    members = wheel(path, {"videos/a.mp4": bytes(range(256)) * 9})
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InputError, match=r"p\.whl: not a readable wheel"):
        extract_members(path, members, tmp_path / "out")


def test_damaged_cache_does_not_count_as_the_clip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "cache" / "clips" / "pose2sim-0.10.49"
    folder.mkdir(parents=True)
    for member in (CALIBRATION, *VIDEOS):
        (folder / Path(member.name).name).write_bytes(b"0" * member.size_bytes)
    assert find_clip() is None
