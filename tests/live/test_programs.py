"""The programs as a person starts and ends them: all at once, wrongly, or two sites together."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from tests.cases import each_case
from tests.cli import commands
from tests.live.processes import COMPILE_S, LiveSite, e3pose, run, up
from tests.ports import free_port
from tests.site.streams.osc_reader import Messages, read_osc
from tests.waiting import eventually

from e3pose.output.exports.source import Asked, take_from_store
from e3pose.recording.calibration import load_rig
from e3pose.settings.site_file import load_site
from e3pose.site.connect import LiveSlot, connect
from e3pose.site.follow import Follower, viewer_link
from e3pose.wire.network import open_network

SITE = """
format = "e3pose-site"
version = 1
name = "{name}"
calibration = "{recording}/calibration.toml"
fps = 20
[link]
endpoint = "tcp/127.0.0.1:{port}"
{upstream}
[loop]
policy = "round-robin"
cameras = 2
predictor = "zero-velocity"
"""
CAMERA = """
[[camera]]
id = "{id}"
source = "{source}"
"""


def write_site(
    folder: Path, recording: Path, name: str = "lab", upstream: str = "", **sources: str
) -> Path:
    """Write a site on plain tcp whose cameras play a recording."""
    path = folder / "site.toml"
    content = SITE.format(name=name, recording=recording, port=free_port(), upstream=upstream)
    for camera_id in load_rig(recording / "calibration.toml").camera_ids:
        source = sources.get(camera_id, f"recorded:{recording}")
        content += CAMERA.format(id=camera_id, source=source)
    path.write_text(content)
    return path


def test_up_goes_on_without_a_camera_that_cannot_start(tmp_path: Path, recording: Path) -> None:
    (tmp_path / "broken.mp4").write_bytes(b"no video")
    path = write_site(tmp_path, recording, cam1="broken.mp4")
    code, out, err = run("up", str(path), "--for", "12", seconds=120)
    assert code == 0 and "cam1" in err and "broken.mp4" in err, err
    said = " ".join(out.split())
    assert said.count("the others go on") == 1 and "cam1: " in said, out
    assert re.search(r"\b[1-9]\d* slots\b", (tmp_path / "logs" / "edge.log").read_text()), out


def test_up_says_why_no_camera_can_start(tmp_path: Path, recording: Path) -> None:
    (tmp_path / "broken.mp4").write_bytes(b"no video")
    cameras = load_rig(recording / "calibration.toml").camera_ids
    path = write_site(tmp_path, recording, **dict.fromkeys(cameras, "broken.mp4"))
    code, _, err = run("up", str(path), "--quiet", "--for", "60", seconds=90)
    assert code == 2
    assert err.count("\n") == 1 and cameras[0] in err and "broken.mp4" in err, err


def test_port_that_is_taken_is_one_line(
    tmp_path: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_site(tmp_path, recording)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", int(path.read_text().split("127.0.0.1:")[1].split('"')[0])))
        taken.listen()
        code = commands.run("edge", path)
    out, err = capsys.readouterr()
    assert (code, out) == (2, "")
    assert err.splitlines()[-1].startswith("e3pose: ") and "Traceback" not in err, err


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[Path]:
    """The file of a site that `up` runs, and Ctrl-C ends: nobody keeps what it wrote in.

    It runs quietly, with a page, and so prints where to look and nothing else.
    """
    path = write_site(tmp_path_factory.mktemp("running"), recording)
    text = path.read_text().replace("fps = 20", "fps = 20\nsmooth_delay_ms = 100")
    page = f"127.0.0.1:{free_port()}"
    path.write_text(f'{text}\n[store]\npath = "live.db"\n[view]\nlisten = "{page}"\n')
    with up(path, signal.SIGINT, "--quiet", "--view") as lines:
        yield path
    see, control = lines
    assert see == f"See the site:     http://{page}/"
    assert control.startswith(f"Control the site: http://{page}/#token=")
    assert not list(path.parent.glob(".*.lock"))


def test_second_edge_of_a_site_names_the_first(
    running: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also that nobody but the owner may read what they write."""
    folder = running.parent
    other, alone = folder / "other.toml", folder / "alone.toml"
    other.write_text(running.read_text().replace(str(port_of(running)), str(free_port())))
    alone.write_text(other.read_text().replace("fps", 'state = ""\nfps', 1))
    written = [folder / name for name in ("state.npz", "live.db", "live.db-wal")]
    assert eventually(lambda: all(file.exists() for file in written), COMPILE_S)
    for file in (*written, folder / "live.db-shm", *(folder / "logs").glob("*")):
        assert file.stat().st_mode & 0o777 == 0o600, file
    assert (folder / "logs").stat().st_mode & 0o777 == 0o700
    for site, what in ((other, "state.npz"), (alone, "live.db")):
        assert commands.run("edge", site) == 2
        error = capsys.readouterr().err
        assert f"{what}: process " in error and "(e3pose edge" in error
        assert "writes there already" in error


def test_smoothed_poses_come_later_and_are_streamed(running: Path, tmp_path: Path) -> None:
    dest = tmp_path / "late.mcap"
    with (
        connect(running, wait_s=COMPILE_S) as now,
        connect(running, wait_s=COMPILE_S, delayed=True) as late,
    ):
        at_once = {slot.slot: slot for slot in (now.next() for _ in range(60)) if slot is not None}
        words = ("stream", str(running), f"mcap:{dest}", "--delayed", "--for", "3")
        code, out, err = run(*words, seconds=60)
        smoothed = [slot for slot in (late.next() for _ in range(40)) if slot is not None]
    assert code == 0 and out.startswith("Streaming smoothed poses of site lab"), err
    shared = [(at_once[slot.slot], slot) for slot in smoothed if slot.slot in at_once]
    assert len(shared) > 20
    for first, later in shared:
        assert (first.delay_ms, later.delay_ms) == (0.0, 100.0)
        assert later.people.track_ids.tolist() == first.people.track_ids.tolist()
    # An edge that catches up publishes several slots at once: the median.
    assert np.median([b.published_ns - a.published_ns for a, b in shared]) > 50_000_000
    moved = [np.abs(b.people.joints_m - a.people.joints_m) for a, b in shared if len(a)]
    assert moved and max(float(np.nanmax(m)) for m in moved) > 1e-4  # not the same again
    assert _sigma([b for _, b in shared]) < _sigma([a for a, _ in shared])
    with dest.open("rb") as file:
        told = [
            json.loads(message.data)
            for _, channel, message in make_reader(file).iter_messages()
            if channel.topic == "/poses"
        ]
    assert told and {slot["delay_ms"] for slot in told} == {100.0}


def _sigma(slots: list[LiveSlot]) -> float:
    return float(np.nanmean(np.concatenate([slot.people.sigma_m.ravel() for slot in slots])))


PACKETS = 40  # of a person, two seconds


def received(listening: socket.socket, address: str, count: int) -> list[Messages]:
    """Return so many packets that have a message of an address."""
    found: list[Messages] = []
    while len(found) < count:
        packet = read_osc(listening.recv(65_536))
        if any(place == address for place, _ in packet):
            found.append(packet)
    return found


@pytest.fixture
def sockets() -> Iterator[list[socket.socket]]:
    with ExitStack() as stack:
        opened = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        yield [stack.enter_context(each) for each in opened]


def test_people_of_a_site_move_avatars_and_are_smoothed_later(
    running: Path, tmp_path: Path, sockets: list[socket.socket]
) -> None:
    for each in sockets:
        each.bind(("127.0.0.1", 0))
        each.settimeout(COMPILE_S)
    targets = [
        f"{kind}://127.0.0.1:{each.getsockname()[1]}"
        for kind, each in zip(("vmc", "vrchat"), sockets, strict=True)
    ]
    stream = subprocess.Popen(e3pose("stream", str(running), *targets))
    try:
        slots = received(sockets[0], "/VMC/Ext/Bone/Pos", PACKETS)
        trackers = received(sockets[1], "/tracking/trackers/1/position", PACKETS)
    finally:
        stream.send_signal(signal.SIGINT)
        assert stream.wait(30) == 0
    hips = np.array([v[1:4] for m in slots for a, v in m if v[0] == "Hips"])
    assert hips.shape == (PACKETS, 3)
    assert ((hips[:, 1] > 0.6) & (hips[:, 1] < 1.3)).all()  # metres above the floor
    steps_m = np.linalg.norm(np.diff(hips, axis=0), axis=1)
    assert np.sort(steps_m)[-2] < 0.5  # the cameras' recording may have begun anew once
    feet = np.array([v for m in trackers for a, v in m if a == "/tracking/trackers/3/position"])
    assert (feet[:, 1] < 0.5).all()
    store = running.parent / "live.db"
    take = take_from_store(str(store), Asked())
    assert all(motion.dynamics is not None for motion in take.motions)
    dest = tmp_path / "walk.glb"
    assert commands.run("export", store, dest, "--smooth", "rts") == 0
    assert dest.is_file()


def test_top_of_a_site_that_does_not_run(
    tmp_path: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_site(tmp_path, recording)
    code = commands.run("top", path, "--once", "--timeout", "0.5")
    err = capsys.readouterr().err
    assert code == 2 and err.count("\n") == 1 and "the edge of site lab does not answer" in err


@pytest.mark.nightly  # tests/wire/test_network_access.py has it without programs
def test_two_sites_share_one_router(tmp_path: Path, recording: Path) -> None:
    """The cameras of the second site know only the router, which is the edge of the first."""
    paths: list[Path] = []
    for name in ("lab", "hall"):
        folder = tmp_path / name
        folder.mkdir()
        upstream = f'upstream = ["tcp/127.0.0.1:{port_of(paths[0])}"]' if paths else ""
        paths.append(write_site(folder, recording, name, upstream))
    programs = LiveSite(tmp_path)
    followers, transports = [], []
    try:
        for path, name in zip(paths, ("lab", "hall"), strict=True):
            programs.start(f"edge-{name}", *e3pose("edge", str(path)))
        for name in ("lab", "hall"):
            for camera_id in ("cam0", "cam1"):
                programs.start(
                    f"{name}-{camera_id}", *e3pose(
                        "camera", "--site", name, "--name", camera_id, "--meter", "model",
                        "--endpoint", f"tcp/127.0.0.1:{port_of(paths[0])}",
                        "--source", f"recorded:{recording}",
                    ),
                )  # fmt: skip
        for path, name in zip(paths, ("lab", "hall"), strict=True):
            follower = Follower(name)
            transports.append(open_network(viewer_link(load_site(path), None)))
            follower.listen(transports[-1])
            followers.append(follower)

        def both() -> bool:
            return all(
                f.status is not None and [c.online for c in f.status.cameras] == [True, True, False]
                for f in followers
            )

        assert eventually(both, COMPILE_S), programs.diagnostics()
        # Each knows its own: a camera of one that ends is no loss to the other.
        programs.send("lab-cam0", signal.SIGKILL)
        assert eventually(lambda: not both())
        assert followers[1].status is not None
        assert [c.online for c in followers[1].status.cameras] == [True, True, False]
    finally:
        for transport in transports:
            transport.close()
        programs.close()


def port_of(path: Path) -> int:
    return int(path.read_text().split('endpoint = "tcp/127.0.0.1:')[1].split('"')[0])


Change = Callable[[Path], object]


def replaced(old: str, new: str) -> Change:
    def change(path: Path) -> None:
        content = path.read_text()
        assert old in content
        path.write_text(content.replace(old, new, 1))

    return change


@each_case(
    ("change", "message"),
    [
        (lambda path: path.unlink(), "site.toml"),
        (lambda path: path.write_bytes(b"\xff\xfe"), "site.toml"),
        (lambda path: path.write_text("x = ["), "site.toml"),
        (replaced("version = 1", "version = 9"), "version"),
        (replaced('format = "e3pose-site"', 'format = "other"'), "format"),
        (replaced("fps = 20", "fps = 0"), "fps"),
        (replaced("fps = 20", "fps = nan"), "fps"),
        (replaced("fps = 20", 'fps = "20"'), "fps"),
        (replaced("fps = 20", "fps = 20\nfsp = 3"), "fsp"),
        (replaced("fps = 20", "fps = 20\nlead = 0"), "lead"),
        (replaced("fps = 20", 'fps = 20\nlead = "soon"'), "lead"),
        (replaced("fps = 20", "fps = 20\nmetrics_port = 70000"), "metrics_port"),
        (replaced("fps = 20", 'fps = 20\nbudget = "much"'), "budget"),
        (replaced("fps = 20", 'fps = 20\nskeleton = "octopus"'), "skeleton"),
        (replaced('name = "lab"', 'name = "../lab"'), "site"),
        (replaced("calibration.toml", "nowhere.toml"), "nowhere.toml"),
        (replaced("tcp/127.0.0.1", "tcp/0.0.0.0"), "plain tcp beyond this machine"),
        (replaced("tcp/127.0.0.1", "udp/127.0.0.1"), "expected tls/HOST:PORT"),
        (replaced("tcp/127.0.0.1", "tls/127.0.0.1"), "certificates"),
        (replaced('"round-robin"', '"best"'), "policy"),
        (replaced("cameras = 2", "cameras = 9"), "cameras"),
        (replaced("cameras = 2", "cameras = 2\ncolour = 3"), "colour"),
        (replaced('id = "cam1"', 'id = "cam0"'), "cam0"),
        (replaced('id = "cam1"', 'id = "cam9"'), "cam9"),
        (replaced('id = "cam1"', 'id = "cam1"\nbudget = "until 25:00"'), "cam1"),
        (replaced('id = "cam1"', 'id = "cam1"\nmeter = "guess"'), "meter"),
        (replaced('id = "cam1"', 'id = "cam1"\nbattery_wh = -1'), "battery_wh"),
    ],
)
def test_wrong_site_files_are_one_line_that_says_what(
    tmp_path: Path,
    recording: Path,
    capsys: pytest.CaptureFixture[str],
    change: Change,
    message: str,
) -> None:
    from e3pose.cli import main

    shutil.copy(recording / "calibration.toml", tmp_path)
    path = write_site(tmp_path, recording)
    path.write_text(path.read_text().replace(f"{recording}/calibration", "calibration"))
    change(path)
    for verb in ("edge", "up"):
        handler = signal.getsignal(signal.SIGTERM)
        with pytest.raises(SystemExit) as ended:
            main([verb, str(path)])
        signal.signal(signal.SIGTERM, handler)
        err = capsys.readouterr().err
        assert ended.value.code == 2, err
        assert err.count("\n") == 1 and message in err and err.startswith("e3pose: "), err
    assert sorted(os.listdir(tmp_path)) in (["calibration.toml", "site.toml"], ["calibration.toml"])
