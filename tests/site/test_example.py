"""The clip of the demo, and sites that are written for a try."""

from __future__ import annotations

import hashlib
import socket
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.recording import load_recording
from e3pose.recording.calibration import load_rig
from e3pose.settings.resolved import resolve_site
from e3pose.settings.site_file import SITE_FILE, load_site
from e3pose.simulate import SceneSettings, simulate
from e3pose.site import example
from e3pose.site.check.parts import start_problems
from e3pose.site.check.sources import source_problems
from e3pose.site.demo_clip import CALIBRATION, TOP, VIDEOS, Member, extract_members, find_clip
from e3pose.site.example import (
    Example,
    free_port,
    make_example,
    there_and_back,
    write_example,
    write_recorded,
)


def test_site_of_a_recording_passes_its_own_check(tmp_path: Path) -> None:
    recording = simulate(SceneSettings(people=1, seconds=0.2, cameras=3), 0)
    path = write_recorded(tmp_path, recording, "hall")
    site, rig = resolve_site(path), load_rig(tmp_path / "rig.toml")
    assert (site.file.name, site.file.fps, site.file.skeleton_name) == (
        "hall",
        recording.fps,
        recording.skeleton.name,
    )
    assert rig.camera_ids == recording.rig.camera_ids
    found = [*start_problems(site), *source_problems(site)]
    assert [f for f in found if f.level != "ok"] == []
    assert path.read_text().startswith("# ")


def test_a_recording_there_and_back_ends_where_it_begins() -> None:
    once = simulate(SceneSettings(people=2, seconds=1.0, cameras=2), 0)
    loop = there_and_back(once)
    assert loop.num_slots == 2 * once.num_slots - 2
    for camera in range(2):
        shown = [loop.view(slot, camera) for slot in range(loop.num_slots)]
        assert all(view is not None for view in shown)
        for slot in range(1, once.num_slots):
            there, back = shown[slot], shown[-slot]
            assert there is not None and back is not None
            np.testing.assert_array_equal(there.keypoints_px, back.keypoints_px)


def test_example_says_what_it_is_given(tmp_path: Path) -> None:
    rig = simulate(SceneSettings(people=0, seconds=0.1, cameras=2), 0).rig
    wanted = Example(
        "lab", dict.fromkeys(rig.camera_ids, "usb:0"), 12.5, "coco18", 1, 0.5, 300.0,
        {"threads": 2}, "one\ntwo", {"pipeline": "paper"},
    )  # fmt: skip
    path = write_example(tmp_path / "new", wanted, rig)
    site = load_site(path)
    assert (site.fps, site.skeleton_name, site.pace, site.deadline_ms) == (
        12.5,
        "coco18",
        0.5,
        300.0,
    )
    assert (site.loop.num_selected, site.loop.pipeline) == (1, "paper")
    assert [(c.id, c.source, c.threads) for c in site.camera] == [
        (camera_id, "usb:0", 2) for camera_id in rig.camera_ids
    ]
    assert path.read_text().startswith("# one\n# two\n")


def test_example_of_a_scene_is_its_owner_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(example, "SCENE", replace(example.SCENE, seconds=0.5))
    path = make_example(tmp_path / "try")
    assert path == tmp_path / "try" / SITE_FILE
    assert len(load_recording(tmp_path / "try" / "recording").rig) == example.SCENE.cameras
    assert (tmp_path / "try").stat().st_mode & 0o077 == 0
    (tmp_path / "file").write_text("mine")
    for taken in ("try", "file"):
        with pytest.raises(InputError, match="is there already"):
            make_example(tmp_path / taken)
    assert (tmp_path / "file").read_text() == "mine"


def test_port_is_free_and_none_of_outgoing_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    port = free_port()
    assert port in example.PORTS and max(example.PORTS) < 32768
    with socket.create_server(("127.0.0.1", port)):
        monkeypatch.setattr(example, "PORTS", range(port, port + 1))
        monkeypatch.setattr(example, "TRIES", 1)
        with pytest.raises(InputError, match=f"found none free in {port}"):
            free_port()


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


@each_case("change", [{"sha256": "0" * 64}, {"size_bytes": 399}, {"name": "videos/none.mp4"}])
def test_other_member_than_expected_is_refused(change: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "p.whl"
    (member,) = wheel(path, {"videos/a.mp4": b"film" * 100})
    with pytest.raises(InputError, match=r"p\.whl: videos/"):
        extract_members(path, (replace(member, **change),), tmp_path / "out")
    assert not (tmp_path / "out" / "a.mp4").exists()


@each_case("keep", [0, 30, 200])
def test_truncated_wheel_is_refused(keep: int, tmp_path: Path) -> None:
    path = tmp_path / "p.whl"
    members = wheel(path, {"videos/a.mp4": bytes(range(256)) * 9})
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InputError, match=r"p\.whl: not a readable wheel"):
        extract_members(path, members, tmp_path / "out")


def test_damaged_cache_is_no_clip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "cache" / "clips" / "pose2sim-0.10.49"
    folder.mkdir(parents=True)
    for member in (CALIBRATION, *VIDEOS):
        (folder / Path(member.name).name).write_bytes(b"0" * member.size_bytes)
    assert find_clip() is None
