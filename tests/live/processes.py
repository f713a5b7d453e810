"""A site of real processes over TLS, for tests of faults."""

from __future__ import annotations

import datetime
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from tests.ports import free_port
from tests.rigs import looking
from tests.waiting import WAIT_S, eventually

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.recording import save_recording
from e3pose.recording.calibration import save_rig
from e3pose.settings.site_file import load_site
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.follow import Follower, viewer_link
from e3pose.store import Store
from e3pose.wire.keys.folder import add_keys, init_keys
from e3pose.wire.network import NetworkTransport, open_network
from e3pose.wire.site_messages import CameraStatus, Poses, Status

HERE = Path(__file__).parent
CAMERAS = ("cam0", "cam1", "cam2")
FPS = 20.0
COMPILE_S = 240.0  # what a machine that never ran this may take


def make_recording(folder: Path) -> Path:
    """Save what three cameras see of two people, for some seconds."""
    scene = SceneSettings("ring", people=2, seconds=6.0, fps=FPS, cameras=len(CAMERAS))
    save_recording(simulate(scene, seed=4), folder)
    return folder


def make_keys(folder: Path, hosts: Sequence[str] = (), site: str = "lab") -> Path:
    now = datetime.datetime.now(datetime.timezone.utc)
    init_keys(folder, site, list(hosts), now)
    for camera_id in CAMERAS:
        add_keys(folder, camera_id, now)
    add_keys(folder, "wall", now, kind="viewer")
    add_keys(folder, "desk", now, kind="operator")
    return folder


@dataclass(eq=False)
class LiveSite:
    """An edge, three cameras and somebody who watches.

    Attributes:
        folder: of the site, with `site.toml`, `recording` and `keys`.
        host: where the edge listens.
        port: where the edge listens.
        camera_port: where cameras find it, if elsewhere.
        more: lines of the site file before its tables.
        tables: lines of further tables.
        inside: command that runs cameras elsewhere, such as in another network namespace.
        camera_options: of all cameras.
        name: of the site.
        together: whether all cameras run in one program, which costs less; else each in its own.
        fps: slots per second.
        statuses: everything that the edge said of itself, and when it came.
        poses: what it published.
    """

    folder: Path
    host: str = "127.0.0.1"
    port: int = field(default_factory=free_port)
    camera_port: int = 0
    more: Sequence[str] = ()
    tables: Sequence[str] = ()
    inside: Sequence[str] = ()
    camera_options: Sequence[str] = ()
    name: str = "lab"
    together: bool = False
    fps: float = FPS
    programs: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    statuses: list[tuple[float, Status]] = field(default_factory=list)
    poses: list[Poses] = field(default_factory=list)
    _viewer: NetworkTransport | None = None

    @property
    def path(self) -> Path:
        """The site file."""
        return self.folder / "site.toml"

    @property
    def endpoint(self) -> str:
        """Where cameras find the edge."""
        host = "localhost" if self.host == "127.0.0.1" else self.host
        return f"tls/{host}:{self.camera_port or self.port}"

    def write(self) -> None:
        """Write the site file."""
        lines = [
            'format = "e3pose-site"', "version = 1", f'name = "{self.name}"', f"fps = {self.fps}",
            'calibration = "recording/calibration.toml"', *self.more,
            "[link]", f'endpoint = "tls/{self.host}:{self.port}"', 'keys = "keys"',
            "[loop]", 'policy = "round-robin"', "cameras = 2", 'predictor = "zero-velocity"',
            *self.tables,
        ]  # fmt: skip
        for camera_id in CAMERAS if self.together else ():
            lines += ["[[camera]]", f'id = "{camera_id}"', 'source = "recorded:recording"']
        self.path.write_text("\n".join(lines) + "\n")

    def start(self, name: str, *command: str) -> subprocess.Popen[bytes]:
        """Start a program of the site; its output is appended to its log."""
        with self.log(name).open("ab") as output:
            program = subprocess.Popen(
                command,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self.programs[name] = program
        return program

    def start_edge(self) -> None:
        self.start("edge", *e3pose("edge", str(self.path), "--json-logs"))

    def start_cameras(self) -> None:
        """Start all cameras."""
        if self.together:
            self.start("cameras", *e3pose("cameras", str(self.path)))
        for camera_id in () if self.together else CAMERAS:
            self.start_camera(camera_id)

    def start_camera(self, camera_id: str, *options: str) -> None:
        self.start(camera_id, *self.camera_command(camera_id, *options))

    def camera_command(self, camera_id: str, *options: str) -> list[str]:
        """Return the command that runs a camera."""
        keys = self.folder / "keys" / "cameras" / camera_id
        return [
            *self.inside, *e3pose(
                "camera", "--site", self.name, "--name", camera_id, "--endpoint", self.endpoint,
                "--keys", str(keys), "--source", f"recorded:{self.folder / 'recording'}",
                "--meter", "model", *self.camera_options, *options,
            ),
        ]  # fmt: skip

    def start_view(self) -> str:
        """Start the page with an operator's certificate; return its address."""
        listen = f"127.0.0.1:{free_port()}"
        desk = self.folder / "keys" / "operators" / "desk"
        self.start("view", *e3pose("view", str(self.path), "--listen", listen, "--keys", str(desk)))
        assert eventually(lambda: "Control the site" in self.log("view").read_text())
        return f"http://{listen}/"

    def watch(self) -> None:
        """Follow what the edge says."""
        follower = Follower(self.name)
        self._viewer = open_network(viewer_link(load_site(self.path), None))
        follower.listen(self._viewer, self.poses.append, self._take)

    def _take(self, status: Status) -> None:
        self.statuses.append((time.monotonic(), status))

    def log(self, name: str) -> Path:
        return self.folder / f"{name}.log"

    def events(self, kind: str) -> list[dict[str, Any]]:
        """Return what the edge logged of a kind, oldest first."""
        lines = self.log("edge").read_text().splitlines()
        parsed = [json.loads(line) for line in lines if line.startswith("{")]
        return [line for line in parsed if line.get("kind") == kind]

    def status(self) -> Status:
        return self.statuses[-1][1]

    def camera(self, camera_id: str) -> CameraStatus:
        return next(c for c in self.status().cameras if c.camera_id == camera_id)

    def online(self) -> set[str]:
        if not self.statuses:
            return set()
        return {camera.camera_id for camera in self.status().cameras if camera.online}

    def cameras_since(self, since: int) -> list[CameraStatus]:
        """Return what was said of all cameras from a status on."""
        return [camera for _, status in self.statuses[since:] for camera in status.cameras]

    def becomes(self, *camera_ids: str) -> None:
        """Wait until exactly these cameras are online."""
        assert eventually(lambda: self.online() == set(camera_ids)), self.diagnostics()

    def longest_silence_s(self, camera_id: str, since: int) -> float:
        """Return how long at most nothing had come from a camera that was called online.

        That is by the edge's own clock, and so the same on a machine that is busy.

        Args:
            camera_id: which.
            since: the first status to look at.
        """
        cameras = [c for c in self.cameras_since(since) if c.online]
        silences_s = [c.last_seen_s for c in cameras if c.camera_id == camera_id]
        return max((s for s in silences_s if s is not None), default=0.0)

    def unbroken(self, slots: Sequence[int], lost: int) -> None:
        """Assert that slots follow each other, but for those the edge says it gave up.

        What a busy machine or network did not pass on counts as computed if the store has it.

        Args:
            slots: numbers, as they came.
            lost: slots that were given up when the first of them came, or before.
        """
        assert len(slots) > 1 and all(b > a for a, b in pairwise(slots))
        missing = set(range(slots[0], slots[-1] + 1)) - set(slots)
        assert len(missing) < 0.1 * len(slots) + self.status().slots_lost - lost

        def appeared() -> bool:
            given_up = self.status().slots_lost - lost
            if len(missing) <= given_up:
                return True
            return len(missing - set(self.stored())) <= given_up

        assert eventually(appeared, 3.0), self.diagnostics()

    def stored(self, database: str = "poses.db") -> list[int]:
        """Return the slots in the store, oldest first; none while there is no store."""
        try:
            return [row["slot"] for row in Store(self.folder / database).rows("slots")]
        except InputError:
            return []

    def stores(self, slot: int, database: str = "poses.db") -> None:
        """Wait until the store has a slot or a later one."""
        assert eventually(lambda: max(self.stored(database), default=-1) >= slot), (
            self.diagnostics()
        )

    def whole(self) -> None:
        """Start cameras that do not run, and wait for all."""
        for camera_id in CAMERAS:
            if camera_id not in self.programs:
                self.start_camera(camera_id)
        self.becomes(*CAMERAS)

    def without(self, camera_id: str) -> None:
        """End a camera if it runs, and wait for the others."""
        if camera_id in self.programs:
            self.send(camera_id, signal.SIGKILL)
            self.wait(camera_id)
        self.becomes(*(c for c in CAMERAS if c != camera_id))

    def flows(self, slots: int = 10) -> None:
        """Wait for so many slots more."""
        count = len(self.poses)
        assert eventually(lambda: len(self.poses) >= count + slots), self.diagnostics()

    def send(self, name: str, number: signal.Signals) -> float:
        """Send a signal to a program; return the time."""
        os.kill(self.programs[name].pid, number)
        return time.monotonic()

    def wait(self, name: str, seconds: float = WAIT_S) -> int:
        """Wait for the end of a program; return its exit code."""
        return self.programs.pop(name).wait(seconds)

    def diagnostics(self) -> str:
        """Return what all programs said, for the one who looks into a failure."""
        why = {c.camera_id: c.why for c in self.status().cameras} if self.statuses else {}
        logs = "\n".join(
            f"--- {p.name}\n{p.read_text()[-1500:]}" for p in self.folder.glob("*.log")
        )
        return f"{why}\n{logs}"

    @contextmanager
    def at_work(self, *hosts: str) -> Iterator[LiveSite]:
        """Wait until all cameras are online and slots flow; afterwards, no fault may be reported.

        Args:
            hosts: other names of the edge, for its certificate.
        """
        make_keys(self.folder / "keys", hosts, self.name)
        self.write()
        self.start_edge()
        self.start_cameras()
        self.watch()
        try:
            assert eventually(lambda: len(self.poses) > 20, COMPILE_S), self.diagnostics()
            self.becomes(*CAMERAS)
            yield self
            for log in self.folder.glob("*.log"):
                assert "Traceback" not in log.read_text(), log.read_text()[-3000:]
        finally:
            self.close()

    def close(self) -> None:
        """End everybody, whatever state they are in."""
        if self._viewer is not None:
            self._viewer.close()
        for program in self.programs.values():
            if program.poll() is None:
                program.kill()
            program.wait()


def e3pose(*words: str) -> list[str]:
    """Return the command line of a verb."""
    return [sys.executable, "-m", "e3pose", *words]


@contextmanager
def running(
    site_file: Path,
    log: Path,
    *options: str,
    heard: Callable[[Status], object] = lambda status: None,
) -> Iterator[tuple[subprocess.Popen[bytes], Follower]]:
    """Run a site with `up`, its output in a file, and follow it; end it with Ctrl-C.

    Args:
        site_file: of the site.
        log: what the program says.
        options: of `up`.
        heard: called with every status.
    """
    site = load_site(site_file)
    follower = Follower(site.name)
    with log.open("wb") as output, closing(open_network(viewer_link(site, None))) as transport:
        follower.listen(transport, None, heard)
        command = e3pose("up", str(site_file), *options)
        up = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True, umask=0o022
        )
        try:
            yield up, follower
        finally:
            up.send_signal(signal.SIGINT)
            up.wait(60)
    assert "Traceback" not in log.read_text()


EYES = """
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

class Eyes:
    skeleton = COCO17

    def detect(self, image):
        return Poses2D.empty(17)
"""


def small_cameras(folder: Path, *places: tuple[float, float]) -> Rig:
    """Write what a site of small network cameras needs: `calib.toml` and a detector, `eyes.py`.

    Args:
        folder: to write to.
        places: of the cameras, which have 64 x 48 pixels, as `network_camera` sends them.
    """
    (folder / "eyes.py").write_text(EYES)
    K = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    rig = Rig(tuple(replace(c, image_size=(64, 48), K=K) for c in looking(*places).cameras))
    save_rig(rig, folder / "calib.toml")
    return rig


@contextmanager
def up(path: Path, number: signal.Signals, *options: str) -> Iterator[list[str]]:
    """Run a site with `up` until slots flow, and end it with a signal: nothing of it may stay.

    Yields:
        The lines that `up` printed, once it has ended.
    """
    site, lines = load_site(path), list[str]()
    names = {"edge", *(camera.id for camera in site.camera), *({"view"} & {o[2:] for o in options})}
    program = subprocess.Popen(
        e3pose("up", str(path), *options),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        umask=0o022,
    )
    follower, transport = Follower(site.name), open_network(viewer_link(site, None))
    try:
        follower.listen(transport)
        assert eventually(lambda: follower.status and follower.status.slot > 10, COMPILE_S)
        children = psutil.Process(program.pid).children(recursive=True)
        assert len(children) == len(names)
        yield lines
        begun_s = time.monotonic()
        program.send_signal(number)
        said, _ = program.communicate(timeout=60)
        assert time.monotonic() - begun_s < 10.0  # one or two, on a machine that does nothing else
    finally:
        transport.close()
        program.kill()
        program.wait()
    assert program.returncode == 0
    assert "Traceback" not in said
    lines += said.splitlines()
    assert not any(child.is_running() for child in children)
    logs = path.parent / "logs"
    assert {log.stem for log in logs.iterdir()} == names
    for log in logs.iterdir():
        assert "Traceback" not in log.read_text(), log.read_text()
    said = (logs / "edge.log").read_text()
    assert "cam0: stopped; active in" in said and "not connected" not in said, said


def run(*words: str, seconds: float = 30.0) -> tuple[int, str, str]:
    """Run a verb to its end; return exit code, standard output and error."""
    done = subprocess.run(
        e3pose(*words), capture_output=True, text=True, timeout=seconds, check=False
    )
    return done.returncode, done.stdout, done.stderr


def as_root(*command: str) -> None:
    """Run a command that only root may; skip the test where it may not be run."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    except OSError as error:
        pytest.skip(f"{command[0]}: {error}")
    if done.returncode:
        pytest.skip(f"{' '.join(command)}: {done.stderr.strip()[:200]}")
