"""A session of setting up: the site's folder, its plan, and the jobs in the background.

Thumbnails are of cameras that no program of a site has yet, with the frame rate measured. A source
is opened when somebody looks and closed when nobody does, or when a program of the site needs the
device. Pictures are held in memory and never stored.
"""

from __future__ import annotations

import base64
import json
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_bytes
from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError, reason_of
from e3pose.base.private import make_folder
from e3pose.base.quantities import shell
from e3pose.camera.base import LiveFrame, LiveSource
from e3pose.camera.frame_rate import rate_hz
from e3pose.camera.live_source import make_source
from e3pose.camera.orientation import Orientation
from e3pose.recording.calibration import load_rig
from e3pose.recording.writer import PARTIAL
from e3pose.settings.site_file import SITE_FILE, SiteTable, load_site
from e3pose.settings.sources import located, near, put_away
from e3pose.site.new_site import RIG_FILE
from e3pose.site.setup.plan import Plan, load_plan, save_plan
from e3pose.site.setup.tasks import Task, Tasks, interrupted
from e3pose.wire.topics import check_site

WIDTH, QUALITY = 480, 70
UNSEEN_S = 6.0  # after which a source that nobody looks at is closed
COUNT_S = 4.0  # of frames of which the rate is measured
STALE_S = 3.0  # after which a picture is said to be old
END_S = 8.0
MAX_FRAMES = 2000

Open = Callable[[str], LiveSource]


@dataclass(frozen=True, slots=True, eq=False)
class Thumbnail:
    """The newest picture of a camera, or the reason for none.

    Attributes:
        jpeg: as base64; None where there is no picture.
        size: `(width, height)` of the frame in pixels.
        fps: measured, frames per second; None while too few came.
        why: there is no picture, in words.
    """

    jpeg: str | None = None
    size: tuple[int, int] = (0, 0)
    fps: float | None = None
    why: str = ""


class Thumbnails:
    """The sources on view, each read on its own thread."""

    def __init__(self, opened: Open | None = None) -> None:
        """Begin with none.

        Args:
            opened: makes a source of its name, not open yet; by default a real one.
        """
        self._make = opened or (lambda name: make_source(name, "", WallClock(), None))
        self._readers: dict[str, _Reader] = {}
        self._lock = threading.Lock()

    def look(self, source: str, rotation: int = 0) -> Thumbnail:
        """Return the newest picture of a source, and open it at the first look.

        Args:
            source: what a camera sees.
            rotation: degrees clockwise by which the picture is turned.
        """
        with self._lock:
            self._forget()
            reader = self._readers.get(source)
            if reader is None:
                reader = self._readers[source] = _Reader(source, self._make)
        return reader.thumbnail(rotation)

    def close(self, *sources: str) -> None:
        """Close some sources, or all, and wait until their devices are free."""
        with self._lock:
            named = sources or tuple(self._readers)
            ended = [self._readers.pop(name) for name in named if name in self._readers]
        for reader in ended:
            reader.stop.set()
        for reader in ended:
            reader.thread.join(END_S)

    def _forget(self) -> None:
        for name in [n for n, each in self._readers.items() if not each.thread.is_alive()]:
            if self._readers[name].stop.is_set():
                del self._readers[name]


class _Reader:
    """Reads one source until it is off view."""

    def __init__(self, source: str, make: Open) -> None:
        self.source, self.stop = source, threading.Event()
        self._make, self._seen_s, self._why = make, time.monotonic(), ""
        self._frame: LiveFrame | None = None
        self._times_ns: deque[int] = deque(maxlen=MAX_FRAMES)
        self._came, self._came_s = threading.Event(), 0.0
        self.thread = threading.Thread(target=self._run, name="setup-thumbnail", daemon=True)
        self.thread.start()

    def thumbnail(self, rotation: int) -> Thumbnail:
        self._seen_s = time.monotonic()
        self._came.wait(1.0)  # for the first frame
        frame = self._frame
        if frame is None:
            return Thumbnail(why=self._why or "waiting for its first picture")
        old_s = time.monotonic() - self._came_s
        why = self._why or (f"no picture for {old_s:.0f} s" if old_s > STALE_S else "")
        rate = None if why else self._rate()
        return Thumbnail(_jpeg(frame.image(), rotation), frame.image_size, rate, why)

    def _rate(self) -> float | None:
        times = [t for t in tuple(self._times_ns) if t > self._times_ns[-1] - COUNT_S * 1e9]
        found = rate_hz(times)
        return None if found is None else round(found, 1)

    def _run(self) -> None:
        try:
            source = self._make(self.source)
            source.open()
        except (InputError, OSError) as error:
            self._why = str(error)
            self._came.set()
            self._linger()
            return
        try:
            while not self.stop.is_set() and time.monotonic() - self._seen_s < UNSEEN_S:
                if (frame := source.read()) is not None:
                    self._frame = frame.shared()
                    self._times_ns.append(frame.captured_ns)
                    self._came_s = time.monotonic()
                    self._came.set()
        except (InputError, OSError) as error:
            self._why = str(error)
            self._linger()
        finally:
            self.stop.set()
            source.close()

    def _linger(self) -> None:
        """Keep the reason while the source is on view, then allow another try."""
        self.stop.wait(UNSEEN_S)
        self.stop.set()


def _jpeg(image: Any, rotation: int) -> str | None:
    """Return an image made small, as a JPEG in base64; None where a source shows no images."""
    import cv2

    if not (isinstance(image, np.ndarray) and image.ndim == 3):
        return None
    turned = Orientation.from_degrees(rotation).apply(image)
    height, width = turned.shape[:2]
    scale = min(1.0, WIDTH / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(turned, size, interpolation=cv2.INTER_AREA)
    coded: Any = cv2.imencode(".jpg", small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return base64.b64encode(coded[1].tobytes()).decode()


RESULTS_FILE = "setup-results.json"  # what the steps found, beside the plan
MAX_RESULTS_BYTES = 2**22
AT_WORK = "at_work"  # of the results: the task that runs, so that a restart knows of it
MOST_SITES = 200
BEFORE = ".before"  # after the name of a file that was replaced


@dataclass(eq=False)
class SetupSession:
    """The set-up of one site; methods may be called on any thread.

    Attributes:
        root: folder in which sites lie and films are looked for.
        name: of the site's folder in it; empty while none was chosen.
        tasks: the work in the background.
        thumbnails: of cameras.
        found: cameras that the network told of, the last time somebody asked to look.
        offered: addresses of their streams, with a password, by how the page shows them.
        times: by network and number of cameras, its speed here in words.
        lock: held while the plan is changed.
    """

    root: Path
    name: str = ""
    tasks: Tasks = field(default_factory=Tasks)
    thumbnails: Thumbnails = field(default_factory=Thumbnails)
    found: list[dict[str, Any]] = field(default_factory=list)
    offered: dict[str, str] = field(default_factory=dict)
    times: dict[tuple[str, int], str] = field(default_factory=dict)
    lock: threading.RLock = field(default_factory=threading.RLock)

    @property
    def folder(self) -> Path:
        """The site's; raise `InputError` while none was chosen."""
        if not self.name:
            raise InputError("site", "none", "one: choose or name it first")
        return self.root / self.name

    @property
    def site_file(self) -> Path:
        """Where the site file is, or will be."""
        return self.folder / SITE_FILE

    @property
    def has_site(self) -> bool:
        """Whether there is a site file."""
        return bool(self.name) and self.site_file.exists()

    def site(self) -> SiteTable:
        """Load the site file; raise `InputError` without one."""
        return load_site(self.folder)

    @property
    def calibration(self) -> Path:
        """Where the calibration is, or will be."""
        return self.site().calibration if self.has_site else self.folder / RIG_FILE

    def placed(self) -> bool:
        """Return whether it is known where the cameras stand."""
        if not self.name or not self.calibration.exists():
            return False
        with suppress(InputError):
            return load_rig(self.calibration).placed
        return False

    def plan(self) -> Plan:
        """Return the choices so far."""
        return load_plan(self.folder) if self.name else Plan()

    def chosen_plan(self) -> Plan:
        """Return the choices so far; raise `InputError` before a site is chosen."""
        return load_plan(self.folder)

    def change(self, changed: Callable[[Plan], Plan]) -> Plan:
        """Change the plan and keep it; errors of `changed` leave it as it is.

        Passwords of cameras go to private files of the site's folder.
        """
        with self.lock:
            plan = changed(self.plan())
            make_folder(self.folder)
            place = partial(near, self.folder.resolve())
            cameras = tuple(
                replace(c, source=located(put_away(c.source, self.folder, c.id), place))
                for c in plan.cameras
            )
            plan = replace(plan, cameras=cameras)
            save_plan(self.folder, plan)
            return plan

    def choose(self, name: str, new: bool = False) -> None:
        """Turn to another site, or begin a new one.

        Args:
            name: of its folder in the root.
            new: whether it is to be made.

        Raises:
            InputError: for a name that is none, a folder that is none, or work that goes on.
        """
        check_site(name)
        self.tasks.check_free()
        folder = self.root / name
        known = (folder / SITE_FILE).exists()
        if new and folder.exists() and any(folder.iterdir()):
            raise InputError(f"{folder}: folder exists and is not empty, expected a new name")
        if not new and not known and not (folder / "setup.toml").exists():
            raise InputError(f"{folder}: found no site, expected one of the list, or a new name")
        self.thumbnails.close()
        self.name = name
        if new:
            self.change(lambda plan: plan)
        self.plan()  # an error of it is said here
        if isinstance(cut_off := self.results().get(AT_WORK), dict):
            kind = str(cut_off.get("kind"))
            self.tasks.newest = interrupted(kind, str(cut_off.get("title")))
            for begun in folder.glob(f"{kind}*{PARTIAL}") if kind in ("walk", "second") else ():
                shutil.rmtree(begun, ignore_errors=True)  # a walk that nobody finished
            self.keep_result(AT_WORK, None)

    def sites(self) -> list[dict[str, Any]]:
        """Return the sites in the root: name, and whether there is a site file yet."""
        found = []
        try:
            folders = sorted(path for path in self.root.iterdir() if path.is_dir())
        except OSError as error:
            raise InputError(f"{self.root}: {reason_of(error).lower()}") from None
        for path in folders[: 50 * MOST_SITES]:
            made = (path / SITE_FILE).exists()
            with suppress(InputError):  # a name that cannot be chosen
                if made or (path / "setup.toml").exists():
                    found.append({"name": check_site(path.name), "made": made})
        return found[:MOST_SITES]

    def shown(self, path: Path) -> str:
        """Return a path as a person types it in the root, quoted for a shell if need be."""
        with suppress(ValueError):
            return shell(path.relative_to(self.root).as_posix())
        return shell(path)

    def start(self, task: Task, work: Callable[[Task], object]) -> None:
        """Begin work in the background; see `Tasks.start`."""

        def noted(running: Task) -> None:
            try:
                work(running)
            finally:
                self.keep_result(AT_WORK, None)

        if not self.name:
            self.tasks.start(task, work)
            return
        self.tasks.check_free()
        # Before the answer: whoever was told that it runs is told if it was cut off.
        self.keep_result(AT_WORK, {"kind": task.kind, "title": task.title})
        self.tasks.start(task, noted)

    def results(self) -> dict[str, Any]:
        """Return the results by step; empty if they cannot be read."""
        path = self.folder / RESULTS_FILE
        with suppress(InputError, ValueError):
            table = json.loads(read_bytes(path, MAX_RESULTS_BYTES))
            return table if isinstance(table, dict) else {}
        return {}

    def keep_result(self, step: str, result: dict[str, Any] | None) -> None:
        """Keep the result of a step; None removes it."""
        with self.lock:
            table = {**self.results(), step: result}
            write_file(self.folder / RESULTS_FILE, json.dumps(table) + "\n", private=True)

    def free_folder(self, stem: str) -> str:
        """Return a name in the site's folder that nothing has yet."""
        names = (stem, *(f"{stem}-{number}" for number in range(2, 1000)))
        ends = ("", PARTIAL)
        return next(n for n in names if not any((self.folder / (n + end)).exists() for end in ends))


def keep_before(path: Path) -> None:
    """Keep the present content of a file beside it, before it is replaced."""
    if not path.exists():
        return
    content = path.read_bytes()
    write_file(path.with_name(path.name + BEFORE), content, private=True)
