"""People of a running site move avatars, and its store keeps what smoothing needs."""

from __future__ import annotations

import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from tests.cli import commands
from tests.live.processes import COMPILE_S, e3pose, up
from tests.live.test_programs import write_site
from tests.site.streams.osc_reader import Messages, read_osc

from e3pose.output.exports.source import Asked, take_from_store

pytestmark = pytest.mark.live

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
    tmp_path: Path, recording: Path, sockets: list[socket.socket]
) -> None:
    path = write_site(tmp_path, recording)
    path.write_text(path.read_text() + '\n[store]\npath = "live.db"\n')
    for each in sockets:
        each.bind(("127.0.0.1", 0))
        each.settimeout(COMPILE_S)
    targets = [
        f"{kind}://127.0.0.1:{each.getsockname()[1]}"
        for kind, each in zip(("vmc", "vrchat"), sockets, strict=True)
    ]
    with up(path, signal.SIGINT):
        stream = subprocess.Popen(e3pose("stream", str(path), *targets))
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
    take = take_from_store(str(tmp_path / "live.db"), Asked())
    assert all(motion.dynamics is not None for motion in take.motions)
    dest = tmp_path / "walk.glb"
    assert commands.run("export", tmp_path / "live.db", dest, "--smooth", "rts") == 0
    assert dest.is_file()
