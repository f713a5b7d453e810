"""A disk that fills up under a running edge, and has room again."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live.processes import LiveSite, as_root
from tests.waiting import eventually

pytestmark = pytest.mark.live

SIZE = "48m"  # the store sets 32 MiB aside


@pytest.fixture
def small_site(tmp_path: Path, recording: Path) -> Iterator[LiveSite]:
    disk = tmp_path / "disk"
    disk.mkdir()
    as_root("mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(disk))
    (tmp_path / "recording").symlink_to(recording)
    tables = ("[store]", 'path = "disk/poses.db"')
    made = LiveSite(tmp_path, more=('state = "disk/state.npz"',), tables=tables)
    try:
        with made.at_work():
            yield made
    finally:
        subprocess.run(["umount", "-l", str(disk)], capture_output=True, check=False)


def fill(path: Path) -> None:
    """Leave no byte free."""
    with path.open("wb", buffering=0) as file:
        for size in (2**20, 4096, 1):
            try:
                while True:
                    file.write(b"x" * size)
            except OSError:
                continue


def test_full_disk_is_reported_and_stops_nobody(small_site: LiveSite) -> None:
    site, disk = small_site, small_site.folder / "disk"
    state = disk / "state.npz"
    assert eventually(state.exists)
    fill(disk / "filler")
    # The state is written beside the old one, which stays as it was until there is room.
    assert eventually(lambda: "cannot save the state" in site.log("edge").read_text()), (
        site.diagnostics()
    )
    kept = state.read_bytes()
    assert eventually(lambda: site.events("store-full")), site.diagnostics()
    count, lost = len(site.poses), site.status().slots_lost
    site.flows(40)
    site.unbroken([poses.slot for poses in site.poses[count:]], lost)
    assert kept and state.read_bytes() == kept
    lines = [line for line in site.events("checkpoint") if "cannot save the state" in line["event"]]
    assert len(lines) == 1  # not once a second
    os.unlink(disk / "filler")
    assert eventually(lambda: "saving the state again" in site.log("edge").read_text())
    site.flows(30)
    site.stores(site.poses[-1].slot, "disk/poses.db")
    site.unbroken(site.stored("disk/poses.db"), 0)  # the spool had the rest
