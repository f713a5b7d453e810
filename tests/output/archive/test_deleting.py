"""What is deleted is nowhere: in the store, its file, an archive, by a pass that comes late."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from tests.cli.commands import run as run_verb
from tests.output.archive.days import BEGIN, DAY, FIRST_DAY, HOUR, PEOPLE, SECOND_DAY, fill

from e3pose.base.errors import InputError
from e3pose.output.archive import deleting, writing
from e3pose.output.archive.deleting import Deleted, delete_everywhere, left_there
from e3pose.output.archive.manifest import Entry, Manifest, check_archive, read_manifest
from e3pose.output.archive.places import Folder, Place
from e3pose.output.archive.writing import Hour, Written, archive_store, file_of
from e3pose.store import Store
from e3pose.store.forgetting import Forgotten, of_day

pytestmark = pytest.mark.slow

LATER = BEGIN + 10 * DAY
PERSON = Forgotten("hall", BEGIN, BEGIN, BEGIN, PEOPLE[0])


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("written") / "hall.db"
    fill(path, range(22, 26))
    return path


@pytest.fixture
def store(written: Path, tmp_path: Path) -> Path:
    shutil.copy(written, tmp_path)
    for name in ("a", "b"):
        archive_store(tmp_path / "hall.db", "hall", Folder(tmp_path / name), LATER)
    return tmp_path / "hall.db"


def test_day_is_deleted_everywhere_and_shown(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_verb("archive", "delete", store, "--day", FIRST_DAY) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        f"{store}: 364 rows deleted, 0 left",  # 120 slots, 240 poses, 4 events
        f"{tmp_path / 'a'}: 240 rows deleted, 0 left",
        f"{tmp_path / 'b'}: 240 rows deleted, 0 left",
    ]
    assert {row["slot"] for row in Store(store).rows("slots")} == set(range(24 * 60, 26 * 60))
    for track in Store(store).rows("tracks"):
        assert (track["first_slot"], track["last_slot"]) == (24 * 60, 26 * 60 - 1)
    assert not [*(tmp_path / "a" / "site=hall" / f"day={FIRST_DAY}").glob("*.parquet")]
    assert archive_store(store, "hall", Folder(tmp_path / "a"), LATER) == Written()
    found = check_archive(Folder(tmp_path / "a"))
    assert (found.days, found.deleted, found.problems, found.strays) == (2, 1, (), ())
    assert run_verb("archive", "delete", store, "--day", FIRST_DAY) == 0, "once more is no error"
    assert capsys.readouterr().out.splitlines()[-1].startswith("nothing of it was there")


def test_person_is_deleted_everywhere_and_others_stay(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = Store(store).query(track=PEOPLE[1])
    blob = Store(store).query(track=PEOPLE[0]).people.joints_m[0].tobytes()
    assert run_verb("people", "forget", store, PEOPLE[0], "--run", 1) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == f"{store}: 245 rows deleted, 0 left"  # 240 poses, a track, 4 events
    assert lines[2:] == [f"{tmp_path / n}: 240 rows deleted, 0 left" for n in "ab"]
    after = Store(store).query()
    assert set(after.people.track_ids.tolist()) == {PEOPLE[1]}
    assert after.people.joints_m.tobytes() == before.people.joints_m.tobytes()
    files = [store, *store.parent.glob("hall.db-*")]
    assert not any(blob in path.read_bytes() for path in files), "rows leave nothing in the file"
    manifest = read_manifest(Folder(tmp_path / "a"), "hall", SECOND_DAY)
    assert manifest is not None
    assert {entry.tracks for entry in manifest.files.values()} == {(PEOPLE[1],)}
    found = check_archive(Folder(tmp_path / "a"))
    assert (found.files, found.rows, found.problems) == (4, 240, ())


def test_archive_that_is_away_is_cleared_by_the_next_pass(
    store: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "b").rename(tmp_path / "away")
    (tmp_path / "b").write_text("not mounted")
    day = ("archive", "delete", store, "--day", FIRST_DAY)
    for words in (day, ("people", "forget", store, PEOPLE[0], "--run", 1)):
        assert run_verb(*words) == 1
        shown = capsys.readouterr().out
        assert "not everywhere" in shown and "b: found no archive where one was" in shown
    (tmp_path / "b").unlink()
    (tmp_path / "b").mkdir()  # where it is mounted
    assert run_verb("archive", store, tmp_path / "b") == 2
    assert "mount it" in capsys.readouterr().err
    (tmp_path / "b").rmdir()
    (tmp_path / "away").rename(tmp_path / "b")
    assert left_there(Folder(tmp_path / "b"), PERSON) == 240
    assert run_verb("archive", store, tmp_path / "b") == 0
    assert "360 rows deleted as asked" in capsys.readouterr().out
    for gone in (PERSON, of_day("hall", FIRST_DAY)):
        assert left_there(Folder(tmp_path / "b"), gone) == 0
    assert check_archive(Folder(tmp_path / "b")).problems == ()


def test_pass_that_read_a_person_before_the_deletion_leaves_nothing(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.rmtree(tmp_path / "a")
    asked = list[list[Deleted]]()

    def slow(opened: Store, hour: Hour) -> tuple[bytes, Entry]:
        made = file_of(opened, hour)
        if not asked:
            asked.append(delete_everywhere(store, PERSON))
        return made

    monkeypatch.setattr(writing, "file_of", slow)
    archive_store(store, "hall", Folder(tmp_path / "a"), LATER, new=True)
    assert len(asked) == 1 and left_there(Folder(tmp_path / "a"), PERSON) == 0
    assert check_archive(Folder(tmp_path / "a")).problems == ()


def test_killed_deletion_goes_on(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Killed(BaseException):
        pass

    calls, write = [0], vars(deleting)["write_manifest"]

    def stumble(place: Place, manifest: Manifest) -> None:
        calls[0] += 1
        if calls[0] == 2:
            raise Killed
        write(place, manifest)

    with monkeypatch.context() as patched:
        patched.setattr(deleting, "write_manifest", stumble)
        with pytest.raises(Killed):
            delete_everywhere(store, PERSON)
    assert check_archive(Folder(tmp_path / "a")).problems != ()
    found = delete_everywhere(store, PERSON)
    assert [one.left for one in found] == [0, 0, 0]
    for name in ("a", "b"):
        assert check_archive(Folder(tmp_path / name)).problems == ()


def test_what_cannot_be_deleted_is_refused(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in (
        ([], "missing --day"),
        (["--day", "2026-13-01"], "--day: found '2026-13-01'"),
        (["--day", "2096-01-01"], "a day that is over"),
    ):
        assert run_verb("archive", "delete", store, *words) == 2
        assert message in capsys.readouterr().err
    with pytest.raises(InputError, match="no such file"):
        delete_everywhere(store.with_name("none.db"), PERSON)
    fill(store, range(1), site="yard")
    assert run_verb("archive", "delete", store, "--day", FIRST_DAY) == 2
    assert "--site: not found, expected one of hall, yard" in capsys.readouterr().err


def test_other_sites_of_a_store_stay(store: Path) -> None:
    fill(store, range(22, 24), site="yard")
    delete_everywhere(store, of_day("hall", FIRST_DAY))
    assert len(Store(store).rows("slots", site="yard")) == 120
    assert len(Store(store).rows("slots", BEGIN + 24 * HOUR, site="hall")) == 120
