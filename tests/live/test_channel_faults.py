"""Every program of a live site while its channels fail: output, descriptors, files, disk."""

from __future__ import annotations

import os
import resource
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.live.processes import COMPILE_S, LiveSite, as_root, e3pose, make_keys
from tests.live.test_full_disk import fill
from tests.live.test_outside import HUB
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.base.errors import Exit
from e3pose.recording import load_recording
from e3pose.site.example import write_recorded
from e3pose.wire.keys.folder import add_keys

STATE, STORE = "cannot save the state", "poses.db"


def hung() -> dict[str, Any]:
    """Return how to start a program whose output and errors wait for a reader that never reads."""
    _, end = os.pipe()  # the reader stays open, with us
    os.set_blocking(end, False)
    for size in (4096, 1):
        with suppress(BlockingIOError):
            while True:
                os.write(end, bytes(size))
    os.set_blocking(end, True)
    return {"stdin": subprocess.DEVNULL, "stdout": end, "stderr": end}


def shut() -> dict[str, Any]:
    """Return how to start a program with input, output and errors closed and no file that grows."""

    def close() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024))
        for number in range(3):
            os.close(number)

    # It would cut the bytecode that it keeps beside the source, which all others then read.
    return {"preexec_fn": close, "env": {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}}


FAULTS = {"hung": hung, "shut": shut}
# A hub has nothing but its database.
ENDED = {(name, "shut"): Exit.FAULT for name in ("hub run", "hub view")}
Works = dict[str, dict[str, Callable[[], bool]]]  # by fault and program, whether it works


@dataclass(eq=False)
class House(LiveSite):
    """A site whose programs are started under a fault; its edge has its files on a small disk.

    Attributes:
        running: by program and fault.
        fault: of the programs that are started next.
    """

    running: dict[tuple[str, str], subprocess.Popen[bytes]] = field(default_factory=dict)
    fault: str = "hung"

    def start(self, name: str, *command: str) -> subprocess.Popen[bytes]:
        options = FAULTS[self.fault]()
        program = subprocess.Popen(command, cwd=self.folder, start_new_session=True, **options)
        if "stdout" in options:
            os.close(options["stdout"])
        self.programs[f"{name}, {self.fault}"] = self.running[name, self.fault] = program
        return program

    @property
    def disk(self) -> Path:
        return self.folder / "disk"

    def works(self, each: Works) -> None:
        """Wait for some slots, and until all that runs beside them works."""
        self.flows(10)
        for fault, programs in each.items():
            for name, asked in programs.items():
                program, code = self.running[name, fault], ENDED.get((name, fault))
                if code is None:
                    assert eventually(asked) and program.poll() is None, (name, fault)
                else:
                    assert program.wait(30) == code


def answers(port: int, path: str = "") -> Callable[[], bool]:
    """Return what asks a page whether it is there."""

    def ask() -> bool:
        with suppress(httpx.TransportError):
            return httpx.get(f"http://127.0.0.1:{port}/{path}", timeout=5.0).is_success
        return False

    return ask


def listens(port: int) -> Callable[[], bool]:
    def ask() -> bool:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 5.0):
            return True
        return False

    return ask


def heard(port: int, stack: ExitStack) -> Callable[[], bool]:
    """Return what listens whether slots come by OSC."""
    listening = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    listening.bind(("127.0.0.1", port))
    listening.settimeout(0.5)

    def ask() -> bool:
        with suppress(OSError):
            return b"/e3pose/slot" in listening.recv(2000)
        return False

    return ask


def beside(house: House, stack: ExitStack) -> dict[str, Callable[[], bool]]:
    """Start what runs beside an edge and its cameras; return what shows that each works."""
    keys, path, folder = house.folder / "keys", str(house.path), house.folder / house.fault
    folder.mkdir(exist_ok=True)
    page, osc, router, hub = (free_port() for _ in range(4))
    text = HUB.format(port=hub, edge=house.port, keys=keys / "hubs" / "house", page="", site="lab")
    text = "\n".join(line for line in text.splitlines() if not line.startswith("page")) + "\n"
    (folder / "hub.toml").write_text(text)
    place = str(house.disk if house.fault == "hung" else folder)
    commands = {
        "view": ("view", path, "--listen", f"127.0.0.1:{page}", "--keys",
                 str(keys / "operators" / "desk")),
        "stream": ("stream", path, f"osc://127.0.0.1:{osc}", f"mcap:{place}/a.mcap"),
        "router": ("router", str(keys / "routers" / "hall"), "--endpoint",
                   f"tls/127.0.0.1:{router}", "--edge", house.endpoint),
        "hub run": ("hub", "run", str(folder)),
        "hub view": ("hub", "view", str(folder)),
    }  # fmt: skip
    works = {
        "view": answers(page), "stream": heard(osc, stack), "router": listens(router),
        "hub run": (folder / "hub.db").exists, "hub view": answers(hub),
    }  # fmt: skip
    for name, command in commands.items():
        house.start(name, *e3pose(*command))
    return works


@contextmanager
def house_of(tmp_path: Path, recording: Path) -> Iterator[House]:
    (tmp_path / "disk").mkdir()
    (tmp_path / "recording").symlink_to(recording)
    tables = ["[store]", f'path = "disk/{STORE}"']
    house = House(tmp_path, more=('state = "disk/state.npz"',), tables=tables)
    make_keys(house.folder / "keys")
    now, keys = datetime.now(timezone.utc), house.folder / "keys"
    add_keys(keys, "hall", now, kind="router")
    add_keys(keys, "house", now, kind="hub")
    house.write()
    try:
        yield house
    finally:
        house.close()


def test_every_program_outlasts_its_channels(tmp_path: Path, recording: Path) -> None:
    with ExitStack() as stack:
        house = stack.enter_context(house_of(tmp_path, recording))
        root = True
        try:
            as_root("mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(house.disk))
            stack.callback(subprocess.run, ["umount", "-l", str(house.disk)], check=False)
        except pytest.skip.Exception:
            root = False  # the rest of it
        house.start_edge()
        house.start_camera("cam0")
        house.watch()
        works = {house.fault: beside(house, stack)}
        assert eventually(lambda: house.online() == {"cam0"}, COMPILE_S), house.diagnostics()
        house.fault = "shut"
        house.start_camera("cam1")
        house.start("cameras", *e3pose("cameras", str(camera_file(house, "cam2"))))
        works[house.fault] = beside(house, stack)
        house.becomes("cam0", "cam1", "cam2")
        house.works(works)
        if root:
            disk_fills_up(house, works)
        for program in reversed(house.running.values()):
            program.send_signal(signal.SIGTERM)
        codes = {each: program.wait(30) for each, program in house.running.items()}
        assert codes == dict.fromkeys(codes, Exit.DONE) | ENDED


def disk_fills_up(house: House, works: Works) -> None:
    """Fill the disk of the edge, the stream and their like, and free it again."""
    assert eventually((house.disk / "state.npz").exists)
    since, lost = len(house.poses), house.status().slots_lost
    fill(house.disk / "filler")
    assert eventually(lambda: any(STATE in event for event in house.status().events))
    house.flows(40)
    house.works(works)
    said = house.status().events
    assert sum(STATE in event for event in said) == 1, said
    (house.disk / "filler").unlink()
    house.works(works)
    newest = house.poses[-1].slot
    house.stores(newest, f"disk/{STORE}")
    slots = [poses.slot for poses in house.poses[since:] if poses.slot <= newest]
    assert house.status().slots_lost == lost
    assert set(slots) <= set(house.stored(f"disk/{STORE}")), "the spool had the rest"


def camera_file(house: House, camera_id: str) -> Path:
    """Write the file of a camera."""
    path = house.folder / f"{camera_id}.toml"
    path.write_text(
        f'format = "e3pose-camera"\nversion = 1\nsite = "{house.name}"\ncamera = "{camera_id}"\n'
        f'source = "recorded:recording"\nendpoint = "{house.endpoint}"\nmeter = "model"\n'
        f'keys = "keys/cameras/{camera_id}"\n'
    )
    return path


@pytest.mark.nightly
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("verb", ["record", "up", "setup"])
def test_what_runs_a_site_of_its_own(
    verb: str, fault: str, tmp_path: Path, recording: Path
) -> None:
    path = write_recorded(tmp_path / "site", load_recording(recording), "lab")
    port = free_port()
    words = {
        "record": ("record", str(path), str(tmp_path / "walk"), "--for", "3"),
        "up": ("up", str(path), "--for", "5"),
        "setup": ("setup", str(tmp_path / "site"), "--listen", f"127.0.0.1:{port}", "--no-browser"),
    }[verb]
    with subprocess.Popen(e3pose(*words), cwd=tmp_path, **FAULTS[fault]()) as program:
        if verb == "setup":
            assert eventually(answers(port), 60)
            program.send_signal(signal.SIGTERM)
        begun_s = time.monotonic()
        code = program.wait(COMPILE_S)
        assert time.monotonic() - begun_s < COMPILE_S
    full = fault == "shut" and verb == "record"
    assert code == (Exit.FAULT if full else Exit.DONE)
