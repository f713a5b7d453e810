"""What `e3pose check` finds: each thing that can be wrong, by itself."""

from __future__ import annotations

import datetime
import os
import socket
import sqlite3
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case
from tests.ports import free_port
from tests.postgres import Server
from tests.rigs import looking
from tests.site.tables import resolved_site, write_site

from e3pose.model.camera import Camera, Rig
from e3pose.site.check.finding import Finding
from e3pose.site.check.link import CLOCK_MS, clock_problems, link_problems
from e3pose.site.check.parts import rig_problems
from e3pose.site.check.places import place_problems, server_problem, store_problems
from e3pose.site.check.site import running_problems
from e3pose.site.check.sources import source_problems
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, init_keys
from e3pose.wire.site_messages import CameraStatus, Status

NOW = datetime.datetime.now(datetime.timezone.utc)
RIG = looking((4, 0), (0, 4))


def wrong(findings: Iterable[Finding]) -> list[Finding]:
    """Return what is not as it should be; each says what to do about it."""
    found = [finding for finding in findings if finding.level != "ok"]
    assert all(finding.found for finding in found)
    return found


def moved(camera: Camera, camera_id: str, shift_m: tuple[float, float, float]) -> Camera:
    T = np.linalg.inv(camera.T_world_camera)
    centre = camera.T_world_camera[:3, 3] + shift_m
    R = T[:3, :3]
    return Camera.from_world_to_camera(camera_id, camera.image_size, camera.K, R, -R @ centre)


def placed(folder: Path, rig: Rig) -> list[Finding]:
    """Return what is found of a rig."""
    folder.mkdir()
    return wrong(rig_problems(resolved_site(folder, rig, "")))


def test_what_is_wrong_with_a_calibration_is_named(tmp_path: Path) -> None:
    (a, b) = RIG.cameras
    assert placed(tmp_path / "good", looking((4, 0), (0, 4), (-4, 0))) == []
    (alone,) = placed(tmp_path / "alone", looking((4, 0)))
    assert alone.level == "problem"
    (twins,) = placed(tmp_path / "twins", Rig((a, b, moved(a, "twin", (0, 0, 0.05)))))
    assert twins.level == "warning"
    assert all(word in twins.found for word in ("c0", "twin", "5 cm"))
    assert not placed(tmp_path / "near", Rig((a, b, moved(a, "near", (0, 0, 0.15)))))
    found = placed(tmp_path / "centimetres", looking((400, 0), (0, 400)))
    assert ["metres" in one.found for one in found if one.level == "problem"] == [True]
    found = placed(tmp_path / "apart", looking((4, 0), (-4, 0), away=True))
    assert [(one.level, one.found.split()[0]) for one in found] == [
        ("warning", "c0"), ("warning", "c1"),
    ]  # fmt: skip
    low = Rig((moved(a, "c0", (0, 0, -2.0)), moved(b, "c1", (0, 0, -2.0))))
    below = [one for one in placed(tmp_path / "low", low) if "below the floor" in one.found]
    assert [one.level for one in below] == ["warning"]


def linked(tmp_path: Path, link: str, rig: Rig = RIG) -> list[Finding]:
    return list(link_problems(resolved_site(tmp_path, rig, f"[link]\n{link}\n")))


def test_plain_tcp_beyond_this_machine_is_to_be_asked_for(tmp_path: Path) -> None:
    assert linked(tmp_path, 'endpoint = "tcp/127.0.0.1:7001"') == []
    for asked, level in (("", "problem"), ("insecure = true", "warning")):
        (found,) = wrong(linked(tmp_path, f'endpoint = "tcp/0.0.0.0:7001"\n{asked}'))
        assert (found.level, found.what) == (level, "link")


def test_tls_without_certificates_names_the_command_that_makes_them(tmp_path: Path) -> None:
    for keys, missing in (("", True), ('keys = "keys"', False)):
        (found,) = linked(tmp_path, f'endpoint = "tls/0.0.0.0:7001"\n{keys}')
        assert found.level == "problem"
        assert f"e3pose keys init lab --out {tmp_path / 'keys'}" in found.advice
        assert ("keys = 'keys'" in found.advice) is missing


def test_certificates_are_looked_at_one_by_one(tmp_path: Path) -> None:
    init_keys(tmp_path / "keys", "lab", [], NOW)
    add_keys(tmp_path / "keys", "c0", NOW)
    found = linked(tmp_path, 'endpoint = "tls/127.0.0.1:7001"\nkeys = "keys"')
    by_what = {finding.what: finding for finding in found}
    assert "certificate c0" not in by_what
    assert by_what["certificate c1"].level == "problem"
    assert f"e3pose keys add c1 --keys {tmp_path / 'keys'}" in by_what["certificate c1"].advice
    assert [f.level for f in found if f.what == "link"] == ["warning"]  # this machine alone


def sources(tmp_path: Path, **keys: str) -> list[Finding]:
    """Return what is found of a camera with these keys."""
    table = "\n".join(f'{key} = "{value}"' for key, value in keys.items())
    site = resolved_site(tmp_path, RIG, f'[[camera]]\nid = "c0"\n{table}\n')
    return list(source_problems(site))


def test_of_cameras_that_run_elsewhere_only_a_turn_is_told(tmp_path: Path) -> None:
    """It needs to be in its own file."""
    assert sources(tmp_path) == sources(tmp_path, record="keypoints") == []
    site = resolved_site(tmp_path, RIG, '[[camera]]\nid = "c1"\nrotation = 90\n')
    (found,) = source_problems(site)
    assert (found.level, found.what) == ("warning", "camera c1")
    assert found.advice == "rotation = 90 in its camera file"


@each_case("source", ["walk.mp4", "recorded:walk", "usb:987"])
def test_source_that_is_not_there_is_a_problem(tmp_path: Path, source: str) -> None:
    found = wrong(sources(tmp_path, source=source, model="net.onnx"))
    assert {finding.what for finding in found} == {"camera c0"}
    assert found[0].level == "problem" and source.partition(":")[2] in found[0].found


def test_videos_need_images_and_a_folder_on_the_camera(tmp_path: Path) -> None:
    (keypoints,) = wrong(sources(tmp_path, source="recorded:.", record="both"))
    assert keypoints.level == "problem" and keypoints.advice == 'record = "keypoints"'
    (elsewhere,) = wrong(sources(tmp_path, record="video"))
    assert elsewhere.level == "warning" and 'videos = "videos"' in elsewhere.advice
    assert sources(tmp_path, source="recorded:.") == [], "keypoints need no network"


def test_network_that_is_missing_or_unknown_is_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    (tmp_path / "walk.mp4").mkdir()  # of images
    (missing,) = wrong(sources(tmp_path, source="walk.mp4"))
    assert missing.advice == "e3pose models pull movenet-multipose"
    (unknown,) = wrong(sources(tmp_path, source="walk.mp4", detector="eyes"))
    assert "eyes" in unknown.found and "movenet-multipose" in unknown.advice
    (lost,) = wrong(sources(tmp_path, source="walk.mp4", model="net.onnx"))
    assert str(tmp_path / "net.onnx") in lost.found
    (tmp_path / "net.onnx").touch()
    assert not wrong(sources(tmp_path, source="walk.mp4", model="net.onnx"))


def on_path(folder: Path, name: str, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a program of that name, and no other, on the path."""
    program = folder / name
    program.write_text(f"#!/bin/sh\necho '{says}'\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))


FOLLOWS = "A1B2C3D4,192.0.2.7,3,1700000000.1,0.000012,0.00001,0.00002,1,0,0,0.01,0.002,64,Normal"
NOBODY = "00000000,0.0.0.0,0,0.0,0.0,0.0,0.0,0,0,0,1,1,0,Not synchronised"


@each_case(
    ("name", "says", "level", "message"),
    [
        ("chronyc", FOLLOWS, "ok", "192.0.2.7"),
        ("chronyc", NOBODY, "warning", "chrony"),
        ("chronyc", "", "warning", "chrony"),
        ("timedatectl", "NTP=yes\nNTPSynchronized=yes", "ok", "timesyncd"),
        ("timedatectl", "NTP=no\nNTPSynchronized=no", "warning", "not synchronised"),
        ("nothing", "", "warning", "no time synchronisation"),
    ],
)
def test_what_keeps_the_clock_right_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, says: str, level: str, message: str
) -> None:
    assert os.access("/bin/sh", os.X_OK)
    on_path(tmp_path, name, says, monkeypatch)
    (found,) = clock_problems(read_endpoint("tls/0.0.0.0:7447"))
    assert (found.level, found.what) == (level, "clock") and message in found.found
    assert bool(found.advice) == (level == "warning")


def test_one_machine_needs_no_synchronised_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_path(tmp_path, "timedatectl", "NTP=no\nNTPSynchronized=no", monkeypatch)
    assert not list(clock_problems(read_endpoint("tcp/127.0.0.1:7447")))


def test_edge_that_does_not_answer_is_a_warning() -> None:
    endpoint = read_endpoint(f"tcp/127.0.0.1:{free_port()}")
    (found,) = running_problems(None, endpoint)
    assert (found.level, found.what) == ("warning", "edge")
    assert "not running at tcp/127.0.0.1:" in found.found and "e3pose edge" in found.advice
    with socket.create_server(("127.0.0.1", endpoint.port)):
        (found,) = running_problems(None, endpoint)
    assert found.level == "warning" and "but no edge of this site answers" in found.found
    assert f"sport = :{endpoint.port}" in found.advice


def running(*cameras: CameraStatus, **more: Any) -> list[Finding]:
    """Return what is found of a running edge with these cameras."""
    status = Status("lab", 417, 20.0, 3, 0, cameras, **more)
    return list(running_problems(status, read_endpoint("tcp/127.0.0.1:7001")))


def test_cameras_of_a_running_edge_are_looked_at_one_by_one() -> None:
    cameras = (
        CameraStatus("cam0", True, clock_offset_ms=CLOCK_MS - 0.5, unchanged=0.4),
        CameraStatus("cam1", True, clock_offset_ms=-CLOCK_MS - 0.5),
        CameraStatus("cam2", False, why="never seen"),
    )
    found = running(*cameras)
    assert [finding.level for finding in found] == ["ok", "ok", "warning", "problem"]
    assert "417" in found[0].found and "+4.5 ms" in found[1].found and "-5.5 ms" in found[2].found
    assert "image unchanged in 40% of its looks" in found[1].found
    assert found[3].what == "camera cam2" and found[3].found == "never seen"


def test_blind_slots_overload_and_short_cameras_of_a_running_edge_are_warnings() -> None:
    cameras = (CameraStatus("cam0", True, why="its source brings 12.5 frames per second"),)
    overload = "edge overloaded, computing takes 130% of a slot"
    found = running(*cameras, blind={"views-missing": 200}, blind_share=0.5, overload=overload)
    assert [finding.level for finding in found] == ["ok", "warning", "warning", "warning"]
    assert "130%" in found[1].found and "fps" in found[1].advice
    assert found[2].found == "50% of the last minute's slots blind"
    assert "200 views missing" in found[2].advice
    assert found[3].what == "camera cam0" and "12.5" in found[3].found


@each_case(
    ("camera", "level", "advice"),
    [
        (CameraStatus("c", True, turned_deg=2.0), "warning",
         "e3pose calibrate extrinsics SITE --only c"),
        (CameraStatus("c", False, why="battery empty", battery=0.0), "problem", "battery.json"),
        (CameraStatus("c", False, why="battery empty", battery=0.0, gauge=True), "problem",
         "see its log"),
    ],
)  # fmt: skip
def test_what_mends_a_camera_is_told(camera: CameraStatus, level: str, advice: str) -> None:
    found = running(camera)[-1]
    assert found.level == level and advice in found.advice
    assert camera.turned_deg is None or "turned by 2.0 degrees" in found.found


def found(folder: Path) -> dict[str, str]:
    """Return the level of what is found, by its name; the worst of each."""
    worst: dict[str, str] = {}
    site = write_site(folder, '[store]\npath = "live.db"\n')
    for finding in wrong((*place_problems(site), *store_problems(site))):
        if worst.get(finding.what) != "problem":
            worst[finding.what] = finding.level
    return worst


def make_database(path: Path) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE slots (slot INTEGER, joints BLOB)")
        connection.executemany(
            "INSERT INTO slots VALUES (?, ?)", [(i, bytes(99)) for i in range(999)]
        )
    connection.close()
    path.chmod(0o600)


def test_damaged_store_is_a_problem_and_one_set_aside_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    make_database(path)
    (tmp_path / "state.npz").touch(0o600)
    assert found(tmp_path) == {}
    path.chmod(0o644)
    (tmp_path / "state.npz").chmod(0o640)
    assert found(tmp_path) == {"store": "warning"}, "others may read it"
    with path.open("r+b") as file:
        file.seek(8192)
        file.write(b"\xff" * 20_000)
    assert found(tmp_path)["store-corrupt"] == "problem"
    path.rename(tmp_path / "live.db.corrupt-20261122T070000Z")
    (tmp_path / "live.db.corrupt-20261122T070000Z-wal").touch()
    make_database(path)
    assert found(tmp_path)["store-corrupt"] == "warning"


def test_what_a_kill_may_take_from_the_store_is_stated(tmp_path: Path) -> None:
    def said(publish: str) -> list[str]:
        site = write_site(tmp_path, f'[store]\npath = "live.db"\npublish = "{publish}"\n')
        return [finding.line for finding in place_problems(site) if finding.level == "ok"]

    (line,) = said("at-once")
    assert "up to 13 published slots may be missing" in line and 'publish = "stored"' in line
    assert said("stored") == ["store: poses are published once they are stored: a kill costs none"]


def test_place_that_is_no_folder_and_a_site_that_keeps_nothing_are_reported(tmp_path: Path) -> None:
    site = write_site(tmp_path, 'state = "missing/state.npz"\n')
    state, store = wrong((*place_problems(site), *store_problems(site)))
    assert (state.level, state.what) == ("problem", "state")
    assert state.advice == f"mkdir -p {tmp_path / 'missing'}"
    assert (store.level, store.what) == ("warning", "store")
    site = write_site(tmp_path, 'state = ""\n[store]\npath = "postgresql:///poses?host=/nowhere"\n')
    (store,) = wrong((*place_problems(site), *store_problems(site)))
    assert (store.level, store.what) == ("problem", "store")


def test_database_server_that_does_not_answer_is_named(
    postgres: Server,
) -> None:
    found = server_problem(postgres.new_store())
    assert (found.level, found.found) == ("ok", "postgresql://e3pose@/postgres: empty")
    found = server_problem("postgresql://me:hunter2@/lab?host=/nowhere")
    assert found.level == "problem"
    assert "postgresql://me:***@/lab: cannot be read (" in found.found
    assert "hunter2" not in found.found and "spool" in found.advice
