"""A set-up setup: the site's folder, its plan, and the jobs in the background."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError, reason_of
from e3pose.base.private import make_folder
from e3pose.base.quantities import shell
from e3pose.recording.calibration import load_rig
from e3pose.recording.writer import PARTIAL
from e3pose.settings.site_file import SITE_FILE, SiteTable, load_site
from e3pose.settings.sources import located, near, put_away
from e3pose.site.new_site import RIG_FILE
from e3pose.site.setup.plan import Plan, load_plan, save_plan
from e3pose.site.setup.tasks import Task, Tasks, interrupted
from e3pose.site.setup.thumbnails import Thumbnails
from e3pose.wire.topics import check_site

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
