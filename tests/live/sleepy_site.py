"""A site of real processes whose cameras sleep by turns, behind a router."""

from __future__ import annotations

import datetime
import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from tests.live.processes import HERE, LiveSite, e3pose
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.wire.keys.folder import add_keys

MOVED = HERE.parents[1] / "lab" / "benchmarks" / "moved_clock.py"
LATE_S = 3.5  # by which the machine of one camera wakes after its alarm
# Suspends nothing, says for how long it was asked to, and wakes late.
RTCWAKE = f"""#!{sys.executable}
import sys, time
seconds = int(sys.argv[sys.argv.index("-s") + 1])
assert sys.argv[1:3] == ["-m", "mem"], sys.argv
with open({{log!r}}, "a") as log:
    print(seconds, file=log, flush=True)
time.sleep(seconds + {LATE_S})
"""


@dataclass(eq=False)
class SleepySite(LiveSite):
    """A site whose cameras sleep by turns, behind a router.

    Attributes:
        movable: whether the clocks of edge and cameras can be moved.
        moved: by program, seconds added to its steady clock, and to its machine's time of day.
    """

    movable: bool = False
    moved: dict[str, tuple[float, float]] = field(default_factory=dict)

    def start_edge(self) -> None:
        self._start_moved("edge", sys.executable, str(HERE / "sleepy_edge.py"), str(self.path))
        if "hall" not in self.programs:
            self.start_router()

    def start_router(self) -> None:
        keys, edge = self.folder / "keys", f"tls/localhost:{self.port}"
        if not (keys / "routers" / "hall").exists():
            add_keys(keys, "hall", datetime.datetime.now(datetime.timezone.utc), kind="router")
        listen = f"tls/127.0.0.1:{self.camera_port}"
        command = ("router", str(keys / "routers" / "hall"), "--endpoint", listen, "--edge", edge)
        self.start("hall", *e3pose(*command))

    def start_camera(self, camera_id: str, *options: str) -> None:
        if camera_id == "cam1":
            options = ("--sleep", "suspend", *options)
        self._start_moved(camera_id, *self.camera_command(camera_id, *options))

    def _start_moved(self, name: str, python: str, *command: str) -> None:
        """Start a program, with clocks that can be moved where that is asked for."""
        if self.movable:
            words = command[2:] if command[:2] == ("-m", "e3pose") else command
            command = str(MOVED), str(self._offsets(name)), *words
        self.start(name, python, *command)

    def _offsets(self, name: str) -> Path:
        return self.folder / f"{name}.offsets"

    def move(self, name: str, steady_s: float = 0.0, system_s: float = 0.0) -> None:
        """Move the clocks of a program, by so much more than they were moved before."""
        before = self.moved.get(name, (0.0, 0.0))
        self.moved[name] = before[0] + steady_s, before[1] + system_s
        self._offsets(name).write_text("{} {}".format(*self.moved[name]))

    def asleep(self, camera_id: str) -> bool:
        camera = self.camera(camera_id)
        return not camera.online and camera.why.startswith("asleep for")

    def falls_asleep(self, camera_id: str) -> None:
        assert eventually(lambda: self.camera(camera_id).online), self.diagnostics()
        assert eventually(lambda: self.asleep(camera_id)), self.diagnostics()

    def comes_back(self, camera_id: str) -> None:
        """Wait until a camera is online, and until views of it are in the poses."""
        assert eventually(lambda: self.camera(camera_id).online), self.diagnostics()
        count = len(self.poses)
        assert eventually(lambda: any(camera_id in p.arrived for p in self.poses[count:]))

    def overslept(self, camera_id: str) -> list[str]:
        said = [str(e["event"]) for e in self.events("camera-overslept")]
        return [line for line in said if line.startswith(f"{camera_id} overslept by")]

    def said_lost(self, camera_id: str) -> list[str]:
        return [e["event"] for e in self.events("camera-lost") if e.get("camera") == camera_id]


@contextmanager
def sleepy_site(folder: Path, recording: Path, movable: bool = False) -> Iterator[SleepySite]:
    """Run a site in a folder, whose machines have a `rtcwake` that suspends nothing."""
    (folder / "recording").symlink_to(recording)
    program = folder / "bin" / "rtcwake"
    program.parent.mkdir()
    program.write_text(RTCWAKE.format(log=str(folder / "rtcwake.txt")))
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    more = ('state = "state.npz"',)
    made = SleepySite(folder, more=more, camera_port=free_port(), movable=movable)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
        with made.at_work():
            yield made
