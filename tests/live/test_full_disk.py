"""A disk that fills up under a running edge, and has room again."""

from __future__ import annotations

import os
import re
import resource
import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.live.processes import COMPILE_S, as_root, e3pose
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.base.errors import Exit
from e3pose.recording import load_recording
from e3pose.recording.writer import PARTIAL
from e3pose.settings.site_file import load_site
from e3pose.site.example import make_example, write_recorded
from e3pose.site.follow import Follower, viewer_link
from e3pose.store import Store
from e3pose.wire.network import open_network

pytestmark = pytest.mark.nightly

SIZE = "48m"  # the store sets 32 MiB aside


def fill(path: Path) -> None:
    """Leave no byte free; what was written before stays."""
    with path.open("ab", buffering=0) as file:
        for size in (2**20, 4096, 1):
            try:
                while True:
                    file.write(b"x" * size)
            except OSError:
                continue


def test_record_keeps_what_a_disk_took_before_it_was_full(tmp_path: Path, recording: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    as_root("mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk))
    try:
        path = write_recorded(tmp_path / "site", load_recording(recording), "lab")
        path.write_text(re.sub(r"(tcp/127\.0\.0\.1):\d+", rf"\1:{free_port()}", path.read_text()))
        dest = disk / "walk"
        lines = disk / f"walk{PARTIAL}" / "keypoints" / "cam0.jsonl"
        command = e3pose("record", str(tmp_path / "site"), str(dest), "--for", "300")
        log = tmp_path / "record.log"
        with (
            log.open("wb") as output,
            subprocess.Popen(
                command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
            ) as program,
        ):
            try:
                assert eventually(
                    lambda: (
                        program.poll() is not None
                        or (lines.exists() and lines.stat().st_size > 30_000)
                    ),
                    COMPILE_S,
                )
                assert program.poll() is None, log.read_text()
                fill(disk / "filler")
                assert program.wait(60) == Exit.FAULT
            finally:
                program.kill()
        (line,) = log.read_text().splitlines()[-1:]
        assert "walk: no space left on device after" in line and "recorded until then" in line
        found = load_recording(dest)
        assert all(len(series.slots) > 20 for series in found.views)
    finally:
        subprocess.run(["umount", "-l", str(disk)], capture_output=True, check=False)


@contextmanager
def up_at_work(folder: Path, words: Sequence[str] = (), **options: Any) -> Iterator[Follower]:
    """Run a whole site with `up` until slots flow; at the end it is told to end, and does."""
    path = folder / "try" / "site.toml"
    site, follower = load_site(path), Follower(load_site(path).name)
    command = [*words, *e3pose("up", str(path), "--quiet")]
    with closing(open_network(viewer_link(site, None))) as transport:
        follower.listen(transport)
        program = subprocess.Popen(command, cwd=folder, start_new_session=True, **options)
        try:
            assert eventually(lambda: follower.status and follower.status.slot > 10, COMPILE_S)
            yield follower
            program.send_signal(signal.SIGTERM)
            assert program.wait(60) == Exit.DONE
        finally:
            program.kill()
            program.wait()


def flows(follower: Follower, slots: int = 50) -> None:
    """Wait for so many slots more."""
    assert follower.status is not None
    newest = follower.status.slot
    assert eventually(lambda: follower.status and follower.status.slot > newest + slots)


def test_up_runs_where_no_file_can_grow_and_nothing_can_be_said(tmp_path: Path) -> None:
    make_example(tmp_path / "try")

    def nothing() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024))
        for number in range(3):
            os.close(number)

    # Bytecode would be cut, too, which all others then read.
    plain = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    with up_at_work(tmp_path, preexec_fn=nothing, env=plain) as follower:
        flows(follower)
        assert follower.status is not None
        said = [event for event in follower.status.events if "cannot save the state" in event]
        assert len(said) == 1 and all(camera.online for camera in follower.status.cameras)
    assert all(log.stat().st_size <= 1024 for log in (tmp_path / "try" / "logs").iterdir())


@pytest.mark.parametrize("fault", ["full", "read-only"])
def test_up_outlasts_a_disk_that_is_full_or_read_only(tmp_path: Path, fault: str) -> None:
    disk, image = tmp_path / "disk", tmp_path / "image"
    disk.mkdir()
    image.touch()
    os.truncate(image, 100 * 2**20)
    as_root("mkfs.ext4", "-q", "-m", "0", str(image))
    as_root("mount", "-o", "loop", str(image), str(disk))
    try:
        make_example(disk / "try")
        with up_at_work(disk) as follower:
            assert eventually((disk / "try" / "state.npz").exists)
            if fault == "full":
                fill(disk / "filler")
            else:
                as_root("mount", "-o", "remount,abort", str(disk))
            flows(follower, 300)
            assert follower.status is not None and follower.status.slots_lost == 0
            newest = follower.status.slot
            if fault == "full":
                os.unlink(disk / "filler")
                store = Store(disk / "try" / "live.db")
                assert eventually(lambda: max(r["slot"] for r in store.rows("slots")) > newest)
        if fault == "full":
            slots = [row["slot"] for row in Store(disk / "try" / "live.db").rows("slots")]
            assert slots == list(range(slots[0], slots[-1] + 1)), "the spool had the rest"
    finally:
        subprocess.run(["umount", "-l", str(disk)], capture_output=True, check=False)
