"""An archive has every closed hour once, whatever is killed, full or late, and its hashes hold."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from tests.cli.commands import run as run_verb
from tests.live.processes import as_root
from tests.output.archive.days import BEGIN, DAY, FIRST_DAY, HOUR, PEOPLE, SECOND_DAY, fill
from tests.store.conftest import record as make_record
from tests.store.conftest import run as make_run
from tests.waiting import eventually

from e3pose.base.errors import Exit, InputError
from e3pose.output.archive.deleting import delete_everywhere
from e3pose.output.archive.manifest import Checked, Manifest, check_archive, days_of, read_manifest
from e3pose.output.archive.places import Bucket, Folder, Place, place_of
from e3pose.output.archive.writing import CLOSED_NS, Written, archive_store
from e3pose.output.exports.wide import read_wide
from e3pose.store import Store, StoreWriter
from e3pose.store.forgetting import of_day

pytestmark = pytest.mark.slow

LATER = BEGIN + 10 * DAY


def archived(
    store: Path, place: Place | Path, now_ns: int = LATER, keep_s: float | None = None
) -> Written:
    place = Folder(place) if isinstance(place, Path) else place
    return archive_store(store, "hall", place, now_ns, keep_s)


def checked(folder: Path) -> Checked:
    found = check_archive(Folder(folder))
    assert (found.problems, found.strays) == ((), ())
    return found


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("written") / "hall.db"
    fill(path, range(21, 28))  # three hours of a day, four of the next
    return path


@pytest.fixture
def store(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(written, tmp_path))


@pytest.fixture(params=["folder", "bucket"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Place:
    if request.param == "folder":
        return Folder(tmp_path / "archive")
    return Bucket(f"memory://{tmp_path.name}/poses")


def test_closed_hours_are_archived_once_as_the_store_has_them(store: Path, place: Place) -> None:
    done = archived(store, place)
    assert (done.hours, done.rows) == (7, 7 * 60 * 2)
    assert archived(store, place) == Written()
    assert days_of(place) == [("hall", FIRST_DAY), ("hall", SECOND_DAY)]
    manifest = read_manifest(place, "hall", SECOND_DAY)
    assert manifest is not None and [e.hour for e in manifest.files.values()] == [0, 1, 2, 3]
    name, entry = next(iter(manifest.files.items()))
    assert (entry.slots, entry.rows, entry.tracks) == (60, 120, PEOPLE)
    content = place.read(f"{manifest.folder}/{name}")
    assert content is not None and len(content) == entry.bytes
    take = read_wide(Path(name), parquet.ParquetFile(io.BytesIO(content)), 10**6)
    stored = Store(store).query(BEGIN + DAY, BEGIN + DAY + HOUR - 1, track=11)
    assert take.motions[1].first == stored.slots[0] == 24 * 60
    np.testing.assert_allclose(take.motions[1].joints_m, stored.people.joints_m, atol=0.0005)
    assert check_archive(place).rows == done.rows


def test_open_hour_waits_and_late_rows_are_archived_again(store: Path, tmp_path: Path) -> None:
    over = BEGIN + 25 * HOUR
    assert archived(store, tmp_path / "a", over + CLOSED_NS - 1).hours == 3
    assert archived(store, tmp_path / "a", over + CLOSED_NS).hours == 1
    (tmp_path / "late.db").write_bytes(store.read_bytes())
    fill(store, range(20, 21))
    before = checked(tmp_path / "a").rows
    assert archived(store, tmp_path / "a", over + CLOSED_NS).hours == 1
    assert checked(tmp_path / "a").rows == before + 120


def test_hour_of_which_a_part_came_late_is_archived_again(tmp_path: Path) -> None:
    path = tmp_path / "hall.db"
    fill(path, range(1))
    assert archived(path, tmp_path / "a", BEGIN + 2 * HOUR).rows == 120
    with StoreWriter(path, make_run("hall", BEGIN)) as writer:
        writer.append(make_record(60), time_ns=BEGIN + HOUR - 1, wait=True)
    assert archived(path, tmp_path / "a", BEGIN + 2 * HOUR).rows == 122
    assert checked(tmp_path / "a").files == 1


def test_hour_without_anybody_has_no_file(tmp_path: Path) -> None:
    path = tmp_path / "hall.db"
    with StoreWriter(path, make_run("hall", BEGIN)) as writer:
        writer.append(make_record(0, 0), time_ns=BEGIN, wait=True)
    assert [archived(path, tmp_path / "a").hours for _ in range(2)] == [1, 0]
    assert checked(tmp_path / "a").files == 0


def test_old_days_are_removed_and_not_archived_again(store: Path, place: Place) -> None:
    archived(store, place)
    done = archived(store, place, LATER, keep_s=9 * 86400)
    assert (done.removed, days_of(place)) == (1, [("hall", SECOND_DAY)])
    assert archived(store, place, LATER, keep_s=9 * 86400) == Written()


def test_killed_in_the_middle_it_goes_on_as_if_it_never_was(store: Path, tmp_path: Path) -> None:
    code = "from e3pose.cli import main; main()"
    command = [sys.executable, "-c", code, "archive", str(store), str(tmp_path / "killed")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as program:
        assert eventually(lambda: len([*(tmp_path / "killed").rglob("*.parquet")]) >= 2, 60)
        program.send_signal(signal.SIGKILL)
    assert run_verb("archive", store, tmp_path / "killed") == 0
    assert run_verb("archive", store, tmp_path / "whole") == 0
    assert checked(tmp_path / "killed") == checked(tmp_path / "whole")
    for name in Folder(tmp_path / "whole").names():
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_full_disk_is_told_and_goes_on_where_there_is_room(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    as_root("mount", "-t", "tmpfs", "-o", "size=100k", "tmpfs", str(disk))
    try:
        assert run_verb("archive", store, disk / "a") == Exit.FAULT
        assert "no space left" in capsys.readouterr().err
        there = check_archive(Folder(disk / "a"))
        assert there.problems == () and 0 < there.files < 7
        subprocess.run(["mount", "-o", "remount,size=10m", str(disk)], check=True)
        assert run_verb("archive", store, disk / "a") == 0
        assert checked(disk / "a").files == 7
    finally:
        subprocess.run(["umount", "-l", str(disk)], capture_output=True, check=False)


def test_verify_names_what_is_changed_missing_or_of_nobody(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "a"
    archived(store, folder)
    assert run_verb("archive", "verify", folder) == 0
    assert "2 days: 7 good files, 840 rows" in capsys.readouterr().out
    assert not any(path.stat().st_mode & 0o077 for path in folder.rglob("*")), "its owner's alone"
    first, second, *_ = sorted(folder.rglob("*.parquet"))
    first.write_bytes(first.read_bytes()[:-1] + b"?")
    second.unlink()
    (second.parent / "other.parquet").write_bytes(b"")
    assert run_verb("archive", "verify", folder) == 1
    shown = capsys.readouterr().out
    assert "other bytes, expected those written" in shown and "found no file" in shown
    assert "other.parquet: in no manifest" in shown and "2 problems" in shown


@pytest.mark.parametrize("bad", ["file", "manifest", "day", "pipe"])
def test_no_link_is_followed_and_one_bad_file_hides_no_other(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], bad: str
) -> None:
    """A link leads to what the person who checks, and who wrote it not, may read."""
    folder, secret = tmp_path / "a", tmp_path / "secret"
    archived(store, folder)
    first = folder / Manifest("hall", FIRST_DAY).folder
    path = {"day": first, "manifest": first / "manifest.json"}.get(
        bad, min(first.glob("*.parquet"))
    )
    path.rename(secret)
    if bad == "pipe":
        os.mkfifo(path)  # would be waited for without end
    else:
        path.symlink_to(secret)
    assert run_verb("archive", "verify", folder) == 1
    shown = capsys.readouterr().out
    assert f"{path}: found a {'pipe' if bad == 'pipe' else 'link'}" in shown
    assert path.relative_to(folder).as_posix() in shown
    assert f"{ {'file': 6, 'pipe': 6}.get(bad, 4) } good files" in shown
    before = secret.stat() if bad != "day" else None
    if bad in ("manifest", "day"):
        for other in (folder / Manifest("hall", SECOND_DAY).folder).iterdir():
            other.unlink()
        done = archived(store, folder)
        assert done.hours == 4 and f"{path}: found a link" in done.problems[0]
    found = delete_everywhere(store, of_day("hall", FIRST_DAY))
    assert found[0].rows, "the store forgets all the same"
    assert ("found a link" in found[1].problem) is (bad in ("manifest", "day"))
    assert before is None or secret.stat() == before, "what a link leads to stays"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "found no manifest"),
        (b"[]", "found no manifest"),
        ({"version": 2}, "version 2 of hall"),
        ({"site": "yard"}, "of yard"),
        ({"files": {"../x.parquet": None}}, "found no manifest|outside"),
    ],
)
def test_manifest_of_nobody_is_refused(
    store: Path, tmp_path: Path, content: bytes | dict[str, object], message: str
) -> None:
    folder = tmp_path / "a"
    archived(store, folder)
    path = folder / Manifest("hall", FIRST_DAY).folder / "manifest.json"
    found = json.loads(path.read_text())
    if isinstance(content, dict):
        if "files" in content:
            content = {"files": {"../x.parquet": next(iter(found["files"].values()))}}
        content = json.dumps({**found, **content}).encode()
    path.write_bytes(content)
    for other in (folder / Manifest("hall", SECOND_DAY).folder).iterdir():
        other.unlink()
    done = archived(store, folder)
    assert len(done.problems) == 1 and re.search(message, done.problems[0])
    assert done.hours == 4, "the other day is archived"
    assert len(check_archive(Folder(folder)).problems) == 1


def test_places_that_cannot_be_used_are_told(store: Path, tmp_path: Path) -> None:
    for address in ("nowhere://x/y", "s3://"):
        with pytest.raises(InputError, match="cannot be used"):
            archived(store, place_of(address))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        archived(store, tmp_path / "file" / "a")
    with pytest.raises(InputError, match="found no archive"):
        check_archive(Folder(tmp_path / "nothing"))
    with pytest.raises(InputError, match="site"):
        archive_store(store, "yard", Folder(tmp_path / "a"), LATER)
