"""What `e3pose check camera.toml` finds on the machine of a camera."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cases import each_case
from tests.cli.commands import run
from tests.ports import free_port
from tests.rigs import looking

from e3pose.base.clock import WallClock
from e3pose.camera.probe import examine
from e3pose.edge.gather import Gather
from e3pose.edge.inbox import Inbox
from e3pose.model.skeleton import COCO17
from e3pose.recording import save_recording
from e3pose.settings.camera_file import NodeTable
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.check.camera import check_camera, suspended
from e3pose.site.check.finding import Finding
from e3pose.wire.access import Link
from e3pose.wire.endpoint import Endpoint, read_endpoint
from e3pose.wire.keys.folder import add_keys, init_keys
from e3pose.wire.network import open_network

NOW = datetime.datetime.now(datetime.timezone.utc)


@pytest.fixture
def node(tmp_path: Path) -> NodeTable:
    save_recording(simulate(SceneSettings(people=1, seconds=0.3, cameras=2), 0), tmp_path / "walk")
    return NodeTable(
        "e3pose-camera", 1, site="lab", camera="cam0", source=f"recorded:{tmp_path / 'walk'}",
        endpoint=read_endpoint(f"tcp/127.0.0.1:{free_port()}"), path=tmp_path / "camera.toml",
    )  # fmt: skip


@contextmanager
def edge(endpoint: Endpoint) -> Iterator[None]:
    """Answer cameras c0 and c1 that ask for the time, as an edge does."""
    transport = open_network(Link("edge", "lab", endpoint))
    clock = WallClock()
    inbox = Inbox(
        "lab", looking((4, 0), (0, 4)), COCO17.joints, 0.05, Gather(2), clock,
        lambda beat: None,
    )  # fmt: skip
    inbox.listen(transport)
    try:
        yield
    finally:
        transport.close()


def found(node: NodeTable, timeout_s: float = 0.0) -> dict[str, Finding]:
    return {finding.what: finding for finding in check_camera(node, timeout_s)}


def test_source_is_opened_and_the_edge_is_missed(node: NodeTable) -> None:
    findings = found(node)
    assert findings["source"].level == "ok" and "frames per second" in findings["source"].found
    assert findings["edge"].level == "problem"
    assert findings["edge"].found.startswith("nothing listens at 127.0.0.1:")


def test_edge_is_asked_for_the_time(node: NodeTable) -> None:
    with edge(node.endpoint):
        answered = found(replace(node, camera="c0", source="missing.mp4"), timeout_s=20.0)
        assert answered["edge"].level in ("ok", "warning")
        assert "ms there and back" in answered["edge"].found
        assert answered["source"].level == "problem"
        assert answered["source"].found.endswith("missing.mp4: found no file, expected a video")
        stranger = found(node)["edge"]
        assert stranger.level == "problem" and "does not answer this camera" in stranger.found


def test_certificate_is_looked_at(node: NodeTable, tmp_path: Path) -> None:
    init_keys(tmp_path / "keys", "lab", [], NOW)
    add_keys(tmp_path / "keys", "cam0", NOW - datetime.timedelta(days=1000))
    tls = replace(
        node, endpoint=replace(node.endpoint, protocol="tls"), keys=tmp_path / "keys/cameras/cam0"
    )
    assert "certificate expired" in found(tls)["certificate"].found
    assert found(replace(tls, keys=tmp_path / "none"))["certificate"].level == "problem"


def test_network_and_device_that_are_missing_are_reported(node: NodeTable) -> None:
    findings = found(replace(node, source="usb:987", detector="missing.onnx"))
    assert findings["source"].advice == "connect the camera"
    assert findings["network"].level == "problem" and "no such file" in findings["network"].found


def test_command_tells_a_camera_file_from_a_site_file(
    node: NodeTable, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "camera.toml"
    file.write_text(
        'format = "e3pose-camera"\nversion = 1\nsite = "lab"\ncamera = "cam0"\n'
        f'source = "recorded:walk"\nendpoint = "{node.endpoint}"\n'
    )
    assert run("check", file, "--timeout", "0") == 1
    said = capsys.readouterr()
    assert "nothing listens at" in said.out and "Not ready: 1 problem" in said.err


@each_case(
    ("states", "command", "program", "level", "said"),
    [
        ("freeze mem disk", (), True, "ok", "rtcwake -m mem -s {seconds}"),
        ("freeze", (), True, "problem", "no suspend to RAM (states: freeze)"),
        (None, (), True, "problem", "states: none"),
        ("mem", (), False, "problem", "no program rtcwake"),
        (None, ("rtcwake", "{seconds}"), True, "ok", "suspended by rtcwake {seconds}"),
    ],
)
def test_machine_that_may_be_suspended_can_be(
    node: NodeTable,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    states: str | None,
    command: tuple[str, ...],
    program: bool,
    level: str,
    said: str,
) -> None:
    folder = tmp_path / "bin"
    folder.mkdir()
    if program:
        (folder / "rtcwake").write_text("#!/bin/sh\n")
        (folder / "rtcwake").chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))
    listed = tmp_path / "state"
    if states is not None:
        listed.write_text(states + "\n")
    asks = replace(node, sleep="suspend", suspend_command=command)
    (finding,) = suspended(asks, examine(asks, listed))
    assert finding.level == level and said in finding.found, finding
