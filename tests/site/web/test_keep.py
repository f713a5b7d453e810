"""Clips, files and recordings by the API: made, found again, bounded, and nothing beside them."""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from tests.cases import each_case
from tests.site.web.watched import SLOTS, STARTED_NS, Watched, watched_site
from tests.waiting import eventually

import e3pose.site.keep.jobs as limits
from e3pose.base.errors import InputError
from e3pose.model.zone_event import ZoneEvent
from e3pose.site.keep.jobs import CUT_OFF, KEPT_S, Jobs
from e3pose.site.keep.making import make
from e3pose.site.keep.request import FORMS, ExportRequest
from e3pose.store import Event, Run, Store, StoreWriter

END_NS = STARTED_NS + 1_200_000_000
BOUNDS = {"start_ns": STARTED_NS, "end_ns": END_NS}
RECORDING = 'format = "e3pose-recording"\nversion = 3\nname = "a"\nfps = 25.0\nnum_slots = 250\n'


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    folder = tmp_path_factory.mktemp("site")
    parts = folder / "recordings"
    for name in ("20261118T100640Z", "20261118T101640Z"):
        (parts / name).mkdir(parents=True)
        (parts / name / "recording.toml").write_text(RECORDING)
    (folder / "outside").mkdir()
    (folder / "outside" / "recording.toml").write_text(RECORDING)
    (parts / "link").symlink_to(folder / "outside")
    (parts / "broken").mkdir()
    (parts / "broken" / "recording.toml").write_text("fps = [")
    with watched_site(folder) as made:
        run = Run("lab", "lab", STARTED_NS, 1 / 25, "coco17", (), ())
        with StoreWriter(folder / "lab.db", run) as writer:
            writer.zone(ZoneEvent("enter", "bed", 10, 1, 0.0, 3, STARTED_NS + 10**8))
            writer.event(
                Event(STARTED_NS + 2 * 10**8, "fall", "Person 10 fell (bed) at 10:06", track_id=10,
                      zone="bed", phase="begun", start_ns=STARTED_NS + 10**8, score=0.9)
            )  # fmt: skip
        yield made


@pytest.fixture
def operator(watched: Watched) -> Iterator[httpx.Client]:
    with watched.client(watched.view.tokens.write) as made:
        yield made


def made(client: httpx.Client, **body: Any) -> dict[str, Any]:
    """Ask for files and wait until they are there, or cannot be."""
    answer = client.post("/api/control/jobs", json={"name": "walk", **BOUNDS, **body})
    assert answer.status_code == 200, answer.text
    number = answer.json()["number"]

    def job() -> dict[str, Any]:
        jobs = client.get("/api/jobs").json()["jobs"]
        return dict(next(one for one in jobs if one["number"] == number))

    assert eventually(lambda: job()["state"] in ("done", "failed"), 60.0)
    return job()


def content(client: httpx.Client, job: dict[str, Any], index: int = 0) -> bytes:
    answer = client.get(f"/api/jobs/{job['number']}/{job['files'][index]['name']}")
    assert answer.status_code == 200
    assert "attachment" in answer.headers["content-disposition"]
    assert len(answer.content) == job["files"][index]["bytes"]
    return answer.content


@pytest.fixture(scope="module")
def job(watched: Watched) -> dict[str, Any]:
    """What a program of its own made, under a name that is a path."""
    with watched.client(watched.view.tokens.write) as client:
        return made(client, form="csv", tracks=[11], name="../../etc/passwd")


def test_clips_are_marked_named_noted_and_removed(operator: httpx.Client) -> None:
    clip = operator.post("/api/control/clips", json={"name": "walk", **BOUNDS}).json()
    changes = {"name": "<i>run</i>", "note": "two\nlines"}
    changed = operator.post(f"/api/control/clips/{clip['number']}", json=changes).json()
    assert (changed["name"], changed["note"]) == ("<i>run</i>", "two\nlines")
    listed = operator.get("/api/clips").json()
    assert listed == [{**changed, "stored": True}]
    assert operator.delete(f"/api/control/clips/{clip['number']}").json() == {"said": "Removed."}
    assert operator.get("/api/clips").json() == []
    assert operator.delete(f"/api/control/clips/{clip['number']}").status_code == 422


def test_what_is_stored_of_a_clip_is_deleted_if_asked_for(tmp_path: Path) -> None:
    said: list[str] = []
    with (
        watched_site(tmp_path, report=said.append) as own,
        own.client(own.view.tokens.write) as client,
    ):
        clip = client.post("/api/control/clips", json={"name": "x", **BOUNDS}).json()
        answer = client.delete(f"/api/control/clips/{clip['number']}", params={"stored": True})
        assert "rows of its time deleted" in answer.json()["said"]
        slots = [row["slot"] for row in Store(own.folder / "lab.db").rows("slots")]
        assert slots == list(range(31, SLOTS))
    assert said[0] == f"page: 127.0.0.1 marked clip {clip['number']}"
    assert said[1].startswith(f"page: 127.0.0.1 deleted what was stored of clip {clip['number']}")


def make_in(folder: Path, watched: Watched, form: str, **more: Any) -> list[Path]:
    """Make files as the program of a job does; return them."""
    request = ExportRequest(form, **{"name": "walk", **BOUNDS, **more})
    names, _ = make(request, watched.folder / "site.toml", folder, lambda doing, share: None)
    return [folder / name for name in names]


FIRST = {
    "c3d": b"\x02\x50", "gltf": b"glTF", "bvh": b"HIERARCHY", "csv": b"slot,", "parquet": b"PAR1",
    "mcap": b"\x89MCAP0\r\n", "report": b"<!doctype html>", "trc": b"PathFileType",
}  # fmt: skip


@each_case("form", sorted(FORMS))
def test_every_form_is_made(watched: Watched, tmp_path: Path, form: str) -> None:
    files = make_in(tmp_path, watched, form)
    assert {file.name for file in files} == (
        {f"walk-track{track}{FORMS[form].suffix}" for track in (10, 11)}
        if form in ("trc", "bvh")
        else {f"walk{FORMS[form].suffix}"}
    )
    assert files[0].read_bytes().startswith(FIRST[form])


def test_poses_are_smoothed_and_an_empty_time_is_told(watched: Watched, tmp_path: Path) -> None:
    (file,) = make_in(tmp_path, watched, "csv", tracks=(11,))
    one = file.read_text()
    (file,) = make_in(tmp_path, watched, "csv", tracks=(11,), smooth=True)
    assert file.read_text() != one
    with pytest.raises(InputError, match=r"no slot of site lab was"):
        make_in(tmp_path, watched, "report", start_ns=1, end_ns=2)


def test_mcap_holds_slots_zones_and_events(watched: Watched, tmp_path: Path) -> None:
    from mcap.reader import make_reader

    (path,) = make_in(tmp_path, watched, "mcap", tracks=(10,))
    seen: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            seen.setdefault(channel.topic, []).append(message)
    assert len(seen["/poses"]) == len(seen["/scene"]) == 31
    poses = json.loads(seen["/poses"][0].data)
    assert [one["track"] for one in poses["people"]] == [10]
    (event,) = [json.loads(one.data) for one in seen["/events"]]
    assert event["says"] == "fell" and event["kind"] == "fall"
    assert len(seen["/zones"]) == 1
    times = [message.log_time for topic in seen.values() for message in topic]
    assert min(times) == STARTED_NS


def test_file_of_chosen_people_is_in_the_folder_of_its_job(
    operator: httpx.Client, watched: Watched, job: dict[str, Any]
) -> None:
    assert job["state"] == "done", job
    assert [file["name"] for file in job["files"]] == ["etc-passwd.csv"]
    lines = content(operator, job).decode().splitlines()
    assert len(lines) == 1 + 31 and all(line.split(",")[3] == "11" for line in lines[1:])
    assert job["until_s"] == pytest.approx(time.time() + KEPT_S, abs=300)
    (file,) = watched.folder.rglob("*passwd*")
    assert file.parent == watched.folder / "view-files" / job["number"]


def test_job_that_finds_nobody_says_so(operator: httpx.Client) -> None:
    nobody = made(operator, form="csv", tracks=[99])
    assert nobody["state"] == "failed" and "no poses that fit" in nobody["doing"]
    assert nobody["files"] == [] and "/" not in nobody["doing"]


@each_case(
    "name",
    [
        *("../../etc/passwd", "..", "/", "a/b\\c", "C:\\x", "-rf", "con.", "\u202egnp.exe"),
        *(" ", "é" * 90),
    ],
)
def test_no_name_is_a_path(name: str) -> None:
    file = ExportRequest("csv", name, STARTED_NS, END_NS).file_name
    assert re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_-]*\.csv", file)


def test_only_files_that_jobs_made_are_served(operator: httpx.Client, job: dict[str, Any]) -> None:
    for path in (
        "job.json", "../job.json", "..%2f..%2flab.db", "%2e%2e/lab.db", "etc-passwd.csv%00.txt",
        "..%5c..%5clab.db", "", "%2fetc%2fpasswd",
    ):  # fmt: skip
        answer = operator.get(f"/api/jobs/{job['number']}/{path}")
        assert answer.status_code in (404, 422), (path, answer.text)
    for number in ("0" * 16, "..", "%2e%2e", job["number"].upper() + "x"):
        answer = operator.get(f"/api/jobs/{number}/etc-passwd.csv")
        assert answer.status_code in (404, 422), number


@each_case(
    ("body", "words"),
    [
        ({"form": "exe"}, "form: found 'exe'"),
        ({"form": "csv", "end_ns": STARTED_NS}, "the earlier time first"),
        ({"form": "csv", "start_ns": 0, "end_ns": 2**62}, "at most 24"),
        ({"form": "csv", "end_ns": 2**80}, "end_ns"),
        ({"form": "csv", "start_ns": -1}, "start_ns"),
        ({"form": "csv", "tracks": [1] * 201}, "tracks"),
        ({"form": "csv", "tracks": ["x"]}, "tracks"),
        ({"form": "csv", "name": ""}, "name"),
        ({"form": "csv", "name": "x" * 200}, "name"),
        ({"form": "mcap", "smooth": True}, "smooth"),
        ({"form": "csv", "dest": "/tmp/x"}, "dest"),
    ],
)
def test_what_cannot_be_made_is_refused_at_once(
    operator: httpx.Client, body: dict[str, Any], words: str
) -> None:
    before = len(operator.get("/api/jobs").json()["jobs"])
    answer = operator.post("/api/control/jobs", json={"name": "walk", **BOUNDS, **body})
    assert answer.status_code == 422 and words in answer.json()["detail"], answer.text
    assert len(operator.get("/api/jobs").json()["jobs"]) == before


def test_viewers_see_and_download_and_change_nothing(
    watched: Watched, operator: httpx.Client, job: dict[str, Any]
) -> None:
    clip = operator.post("/api/control/clips", json={"name": "walk", **BOUNDS}).json()
    for token, status in (("", 401), (watched.view.tokens.read, 403), ("y" * 32, 401)):
        with watched.client(token) as client:
            asks = {"name": "walk", "form": "csv", **BOUNDS}
            assert client.post("/api/control/jobs", json=asks).status_code == status
            assert client.post("/api/control/clips", json=asks).status_code == status
            for path in (
                f"jobs/{job['number']}",
                f"clips/{clip['number']}?stored=true",
                "recordings/20261118T100640Z",
            ):
                assert client.delete(f"/api/control/{path}").status_code == status, path
    with watched.client(watched.view.tokens.read) as client:
        assert content(client, job)
        assert [one["number"] for one in client.get("/api/clips").json()] == [clip["number"]]
    assert len(Store(watched.folder / "lab.db").rows("slots")) == SLOTS
    operator.delete(f"/api/control/clips/{clip['number']}")


def test_recordings_are_deleted_by_their_names(watched: Watched, operator: httpx.Client) -> None:
    names = [one["name"] for one in operator.get("/api/recordings").json()]
    assert names == ["20261118T101640Z", "20261118T100640Z"]
    first = operator.get("/api/recordings").json()[1]
    assert first["start_ns"] == 1_794_996_400 * 10**9 and first["seconds"] == 10.0
    for name in ("link", "..", "%2e%2e%2foutside", "..%2foutside", "broken/../../outside", ""):
        assert operator.delete(f"/api/control/recordings/{name}").status_code in (404, 405, 422)
    assert (watched.folder / "outside" / "recording.toml").is_file()
    assert operator.delete("/api/control/recordings/20261118T100640Z").status_code == 200
    assert [one["name"] for one in operator.get("/api/recordings").json()] == names[:1]


# ---- jobs across programs, disks and days; a script is in place of the program that makes files

MAKES = """#!/bin/sh
cat > "$3/walk.csv"
echo '{"doing": "reading", "share": null}'
echo '{"files": ["walk.csv"], "note": "1 row"}'
"""
WORKS_ON = MAKES.splitlines()[0] + '\ncat > "$3/walk.csv"\nexec sleep 60\n'
WISH = ExportRequest("csv", "walk", STARTED_NS, END_NS)


@dataclass
class Desk:
    """A folder of jobs, and what makes their files."""

    folder: Path
    program: Path
    now_s: float = 1000.0
    opened: list[Jobs] = field(default_factory=list)

    def open(self) -> Jobs:
        jobs = Jobs(self.folder, self.folder / "site.toml", now_s=lambda: self.now_s)
        self.opened.append(jobs)
        return jobs

    def runs(self, script: str) -> None:
        self.program.write_text(script)
        self.program.chmod(0o700)

    def done(self, jobs: Jobs) -> str:
        """Have a file made; return its number."""
        number = jobs.add(WISH).number
        assert until(jobs, number, "done")
        return number


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    made = Desk(tmp_path / "files", tmp_path / "program")
    made.runs(MAKES)
    monkeypatch.setattr(limits, "sys", SimpleNamespace(executable=str(made.program)))
    yield made
    for jobs in made.opened:
        jobs.close()


def state_of(jobs: Jobs, number: str) -> str:
    return next((job.state for job in jobs.all() if job.number == number), "gone")


def until(jobs: Jobs, number: str, state: str) -> bool:
    return eventually(lambda: state_of(jobs, number) == state)


def test_jobs_are_there_for_the_next_program_which_says_what_was_cut_off(desk: Desk) -> None:
    jobs = desk.open()
    done = desk.done(jobs)
    desk.runs(WORKS_ON)
    cut = [jobs.add(WISH).number for _ in range(3)]
    assert until(jobs, cut[0], "working")
    jobs.close()
    again = desk.open()
    found = {job.number: job for job in again.all()}
    assert found[done].state == "done" and again.file(done, "walk.csv").is_file()
    for one in cut:
        assert (found[one].state, found[one].doing) == ("failed", CUT_OFF)
        assert [path.name for path in (desk.folder / one).iterdir()] == ["job.json"]


def test_files_go_after_a_day_and_a_second_program_is_told(
    desk: Desk,
) -> None:
    jobs = desk.open()
    done = desk.done(jobs)
    second = desk.open()
    assert second.all() == [] and "jobs" in second.why
    with pytest.raises(InputError):
        second.add(WISH)
    second.close()
    assert jobs.file(done, "walk.csv").is_file()
    # Files go a day after they were made.
    desk.now_s += KEPT_S - 1
    assert jobs.file(done, "walk.csv").is_file()
    desk.now_s += 2
    assert jobs.all() == [] and not (desk.folder / done).exists()
    with pytest.raises(InputError, match="expected one that a job made"):
        jobs.file(done, "walk.csv")


def test_a_job_is_removed_while_it_works_and_the_next_one_is_made(desk: Desk) -> None:
    desk.runs(WORKS_ON)
    jobs = desk.open()
    first = jobs.add(WISH).number
    assert eventually((desk.folder / first / "walk.csv").is_file)
    desk.runs(MAKES)
    second = jobs.add(WISH).number
    jobs.remove(first)
    assert not (desk.folder / first).exists()
    assert until(jobs, second, "done")
    assert state_of(jobs, first) == "gone"
    assert eventually(lambda: not (desk.folder / first).exists())
    with pytest.raises(InputError, match="job: found"):
        jobs.remove("../..")


@each_case(
    ("limit", "value", "words"),
    [
        ("MOST_BYTES", 10, "remove some"),
        ("LEAST_FREE", 10**18, r"the disk has \d+ MB left"),
        ("MOST_JOBS", 1, "remove some, or wait"),
    ],
)
def test_folder_disk_and_queue_are_bounded(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, limit: str, value: int, words: str
) -> None:
    jobs = desk.opened[0] if desk.opened else desk.open()
    if not jobs.all():
        desk.done(jobs)
    monkeypatch.setattr(limits, limit, value)
    with pytest.raises(InputError, match=words):
        jobs.add(WISH)


def test_what_grows_too_large_is_ended(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "LOOK_S", 0.001)
    desk.runs(WORKS_ON)
    jobs = desk.open()
    number = jobs.add(WISH).number
    assert until(jobs, number, "working")
    monkeypatch.setattr(limits, "LEAST_FREE", 10**18)
    assert until(jobs, number, "failed")
    (found,) = jobs.all()
    assert "MB left" in found.doing and found.files == ()
    assert os.listdir(desk.folder / number) == ["job.json"]


def test_a_folder_that_cannot_be_written_is_told(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    jobs = desk.open()
    monkeypatch.setattr(limits, "make_folder", full)
    with pytest.raises(InputError, match="No space left on device") as refused:
        jobs.add(WISH)
    assert str(desk.folder) not in str(refused.value)
    assert jobs.all() == []


def test_what_lies_among_jobs_and_is_none_is_left_alone(desk: Desk) -> None:
    odd: dict[str, Callable[[dict[str, Any]], object]] = {
        "0" * 16: lambda job: {**job, "files": [["../../lab.db", 1]]},
        "1" * 16: lambda job: {**job, "request": {**job["request"], "form": "exe"}},
        "2" * 16: lambda job: [],
        "not-a-job": lambda job: job,
    }
    jobs = desk.open()
    made = desk.done(jobs)
    jobs.close()
    told = json.loads((desk.folder / made / "job.json").read_text())
    for name, change in odd.items():
        (desk.folder / name).mkdir()
        (desk.folder / name / "job.json").write_text(json.dumps(change(told)))
    (desk.folder / ("3" * 16)).mkdir()
    (desk.folder / ("3" * 16) / "job.json").write_bytes(b"\xff" * 100)
    assert [job.number for job in desk.open().all()] == [made]
    assert all((desk.folder / name / "job.json").is_file() for name in odd)
