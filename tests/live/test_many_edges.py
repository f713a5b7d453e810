"""Several sites in one edge process: what happens to one of them is its own."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.live.processes import CAMERAS, COMPILE_S, HERE, LiveSite, as_root, make_keys
from tests.live.test_full_disk import SIZE, fill
from tests.waiting import eventually

pytestmark = pytest.mark.timed

NAMES = ("lab", "hall")
MORE = ('state = "disk/state.npz"',)
TABLES = ("[store]", 'path = "disk/poses.db"')
ENDED_S = 15.0


def not_overloaded(site: LiveSite) -> bool:
    return not site.status().overload


@dataclass(eq=False)
class House:
    """Two sites with an edge process for both."""

    folder: Path
    sites: dict[str, LiveSite]
    edge: subprocess.Popen[bytes] | None = None
    before: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def log(self) -> Path:
        return self.folder / "house.log"

    def start(self) -> None:
        places = [str(site.folder) for site in self.sites.values()]
        command = [sys.executable, str(HERE / "odd_house.py"), *places]
        with self.log.open("ab") as output:
            self.edge = subprocess.Popen(
                command, stdout=output, stderr=output, start_new_session=True
            )

    def send(self, number: signal.Signals) -> None:
        assert self.edge is not None
        self.edge.send_signal(number)

    def events(self, name: str, kind: str = "") -> list[dict[str, Any]]:
        """Return what was logged of a site, oldest first."""
        lines = [json.loads(x) for x in self.log.read_text().splitlines() if x.startswith("{")]
        mine = [line for line in lines if line.get("site") == str(self.sites[name].folder)]
        return [line for line in mine if not kind or line.get("kind") == kind]

    def begin(self) -> None:
        """Remember where all sites are."""
        for name, site in self.sites.items():
            self.before[name] = len(site.poses), site.status().slots_lost

    def unhurt(self, *names: str, slots: int = 60) -> None:
        """Assert that sites have had all their slots since `begin`, and go on."""
        for name in names:
            self.sites[name].flows(slots)
        for name in names:
            site, (count, lost) = self.sites[name], self.before[name]
            site.unbroken([poses.slot for poses in site.poses[count:]], lost)
            assert site.status().slots_lost == lost, self.said(name)
            # A machine that is busy meanwhile overloads an edge for some seconds.
            assert eventually(partial(not_overloaded, site), 120), self.said(name)
            assert site.online() == set(CAMERAS), self.said(name)

    def waits(self, name: str, seconds: float) -> None:
        """Wait for the first slots of a site."""
        site = self.sites[name]
        assert eventually(lambda: len(site.poses) > 20, seconds), self.said(name)

    def resumes(self, name: str) -> None:
        """Wait until a site goes on from its state."""
        assert eventually(lambda: self.events(name, "resumed"), 60.0), self.said(name)

    def said(self, name: str) -> str:
        return f"{self.sites[name].diagnostics()}\n{self.log.read_text()[-4000:]}"


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[House]:
    folder, sites = tmp_path_factory.mktemp("house"), dict[str, LiveSite]()
    for name in NAMES:
        place = folder / name
        (place / "disk").mkdir(parents=True)
        (place / "recording").symlink_to(recording)
        together = name == "lab"
        sites[name] = LiveSite(place, name=name, more=MORE, tables=TABLES, together=together)
        make_keys(place / "keys", site=name)
        sites[name].write()
    made, disk = House(folder, sites), folder / "hall" / "disk"
    mount = ("mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(disk))
    mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    with ExitStack() as stack:
        if mounted:
            stack.callback(
                subprocess.run, ["umount", "-l", str(disk)], capture_output=True, check=False
            )
        made.start()
        for site in sites.values():
            stack.callback(site.close)
            site.start_cameras()
            site.watch()
        try:
            for name, site in sites.items():
                made.waits(name, COMPILE_S)
                site.becomes(*CAMERAS)
            yield made
        finally:
            assert made.edge is not None
            made.edge.kill()
            made.edge.wait()


@pytest.mark.nightly
def test_keys_of_one_site_are_worth_nothing_at_another(house: House) -> None:
    lab, hall = house.sites["lab"], house.sites["hall"]
    hall.without("cam2")
    keys = lab.folder / "keys" / "cameras" / "cam2"
    own = hall.folder / "keys" / "cameras" / "cam2"
    own.rename(own.with_name("own"))
    own.symlink_to(keys)  # that of the other site, for a camera of the same name
    try:
        hall.start_camera("cam2")
        house.begin()
        house.unhurt("lab")
        assert hall.online() == {"cam0", "cam1"}, house.said("hall")
        assert hall.programs["cam2"].poll() is None  # it goes on trying
        hall.send("cam2", signal.SIGKILL)
        hall.wait("cam2")
    finally:
        own.unlink()
        own.with_name("own").rename(own)
    hall.whole()


def test_full_disk_of_one_site_is_its_own(house: House) -> None:
    disk = house.sites["hall"].folder / "disk"
    if not os.path.ismount(disk):
        as_root("mount", "--make-private", str(disk))  # skips: nobody may mount here
    house.begin()
    fill(disk / "filler")
    assert eventually(
        lambda: any("cannot save the state" in e["event"] for e in house.events("hall"))
    ), house.said("hall")
    house.unhurt(*NAMES, slots=40)
    assert not house.events("lab", "checkpoint")
    (disk / "filler").unlink()
    assert eventually(
        lambda: any("saving the state again" in e["event"] for e in house.events("hall"))
    ), house.said("hall")
    house.sites["hall"].stores(house.sites["hall"].poses[-1].slot, "disk/poses.db")


def test_site_that_fails_is_started_again_and_its_neighbours_lose_nothing(house: House) -> None:
    hall = house.sites["hall"]
    house.begin()
    last = hall.poses[-1].slot
    house.send(signal.SIGUSR1)
    assert eventually(lambda: house.events("hall", "restarted")), house.said("hall")
    said = next(e for e in house.events("hall") if e["event"].startswith("site stopped"))
    assert "KeyError: 'poisoned'" in said["error"] and "step" in said["where"]
    assert eventually(lambda: house.events("hall", "resumed")), house.said("hall")
    hall.becomes(*CAMERAS)
    hall.flows(20)
    assert hall.poses[-1].slot > last  # the numbers go on
    house.unhurt("lab", slots=20)
    assert not house.events("lab", "restarted")


def test_sigterm_saves_all_sites_and_each_goes_on(house: House) -> None:
    assert house.edge is not None
    sent_s = time.monotonic()
    house.send(signal.SIGTERM)
    assert house.edge.wait(60) == 0
    assert time.monotonic() - sent_s < ENDED_S
    text = house.log.read_text()
    assert "Traceback" not in text
    for name, site in house.sites.items():
        assert re.search(rf"{name}: \d+ slots, ", text), text[-3000:]
        last = site.poses[-1].slot
        assert max(site.stored("disk/poses.db")) >= last - 1, name
        assert not list((site.folder / "disk").glob(".*.lock")), name
    house.log.unlink()
    house.start()
    for name in NAMES:
        house.resumes(name)
        house.sites[name].flows(10)
