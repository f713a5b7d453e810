"""Who is forgotten is in no byte of any file of the site's folder, but for those that are named."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run as verb

from e3pose.base.lock import hold
from e3pose.edge.checkpoint import Checkpoint, flatten, load_checkpoint, save_checkpoint
from e3pose.edge.learn.ring_buffer import Gathering, Ring
from e3pose.pipeline import SlotRecord, initial_state, step
from e3pose.recording import save_recording
from e3pose.settings.resolved import resolve_site
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate
from e3pose.site.keep.jobs import Job
from e3pose.site.keep.request import ExportRequest
from e3pose.store import Run, StoreWriter
from e3pose.store.people import set_name, tracks_of

NAME = "Ada Lovelace"
SITE = """
format = "e3pose-site"
version = 1
name = "lab"
calibration = "calibration.toml"
fps = 25
learn = "learn"
[store]
path = "live.db"
[loop]
predictor = "zero-velocity"
"""
SLOTS = 50
AGO_NS = 3600 * 10**9  # before now, when the person was there


@pytest.fixture
def planted(tmp_path: Path) -> tuple[Path, list[bytes]]:
    """A site's folder with a person everywhere, and what is looked for afterwards."""
    scene = SceneSettings("ring", people=2, seconds=2.0, fps=25, cameras=3)
    recording = simulate(scene, seed=2)
    room = tmp_path / "room"
    room.mkdir()
    save_recording(recording, tmp_path / "walk")
    (room / "calibration.toml").write_bytes((tmp_path / "walk" / "calibration.toml").read_bytes())
    (room / "site.toml").write_text(SITE)
    site = resolve_site(room)
    pipeline, begun_ns = site.pipeline(), time.time_ns() - AGO_NS
    state, records = initial_state(pipeline), list[SlotRecord]()
    everybody = np.ones(3, dtype=bool)
    for slot in range(SLOTS):
        views = {at: series.view(slot) for at, series in enumerate(recording.views)}
        shown = {at: view for at, view in views.items() if view is not None}
        state, record = step(pipeline, state, shown, everybody)
        records.append(record)
    ada, other = records[-1].people.track_ids.tolist()[:2]
    joints, cameras = site.skeleton.joints, tuple(site.rig.camera_ids)
    stored_as = Run("lab", "lab", begun_ns, 0.04, site.skeleton.name, joints, cameras)
    with StoreWriter(room / "live.db", stored_as) as writer:
        for record in records:
            writer.append(record, time_ns=begun_ns + record.slot * 40_000_000, wait=True)
        assert writer.flush(30.0)
    set_name(room / "live.db", tracks_of(room / "live.db", str(ada)), NAME)
    save_checkpoint(
        room / "state.npz",
        Checkpoint(state, begun_ns, pipeline.lead_slots, begun_ns, begun_ns),
        pipeline,
    )
    (room / "state.npz.unusable").write_bytes((room / "state.npz").read_bytes())
    gathered = Gathering(begun_ns - 5)
    for record in records:
        gathered.add(record)
    Ring(room / "learn" / "poses", site.skeleton, 10**9).write(gathered.chunk())
    (room / "learn" / "versions").mkdir()
    job = Job("0" * 16, ExportRequest("csv", "Ada", begun_ns, begun_ns + 10**9), time.time())
    folder = room / "view-files" / job.number
    folder.mkdir(parents=True)
    done = replace(job, state="done", files=(("Ada.csv", 3),))
    (folder / "job.json").write_text(json.dumps(asdict(done)))
    (folder / "Ada.csv").write_text(NAME)
    belief_rows = [
        array[row].tobytes()
        for name, array in flatten(state).items()
        if name.rpartition(".")[2] in ("bones_m", "lengths_m", "place_m", "corrected_m")
        for row in range(len(array))
        if np.any(array[row])
    ]
    assert belief_rows
    poses = [
        record.people.joints_m[record.people.track_ids.tolist().index(ada)] for record in records
        if ada in record.people.track_ids
    ]  # fmt: skip
    assert len(poses) > 20 and ada != other
    stored = [pose.astype(kind).tobytes() for pose in poses for kind in (np.float32, np.float64)]
    return room, [NAME.encode(), *belief_rows, *stored]


def traces(room: Path, planted: list[bytes]) -> dict[str, int]:
    """Return how many of the planted bytes each file of a folder holds."""
    found = {}
    for path in sorted(each for each in room.rglob("*") if each.is_file()):
        content = path.read_bytes()
        if count := sum(secret in content for secret in planted):
            found[path.relative_to(room).as_posix()] = count
    return found


def test_nothing_of_a_person_is_left_in_the_folder_of_a_site(
    planted: tuple[Path, list[bytes]], capsys: pytest.CaptureFixture[str]
) -> None:
    room, secrets = planted
    before = traces(room, secrets)
    assert {"state.npz", "state.npz.unusable", "learn/poses/00000001.npz"} <= {*before}
    assert "view-files/0000000000000000/Ada.csv" in before and "live.db" in before
    learned = load_checkpoint(room / "state.npz", resolve_site(room).pipeline()).state
    assert verb("people", "forget", room, NAME) == 0
    said = capsys.readouterr().out
    assert traces(room, secrets) == {}
    for name in ("state.npz: people deleted", "unusable: deleted", "rows deleted", "Ada.csv: del"):
        assert name in said, said
    # What the edge learned of its cameras is there, and so is the other person's hour of learning.
    kept = load_checkpoint(room / "state.npz", resolve_site(room).pipeline()).state
    assert np.array_equal(kept.memory.belief.noise, learned.memory.belief.noise)
    assert kept.slot == learned.slot and len(kept.memory.belief) == 0
    assert (room / "learn" / "poses" / "00000001.npz").exists()


def test_what_cannot_be_forgotten_is_named(
    planted: tuple[Path, list[bytes]], capsys: pytest.CaptureFixture[str]
) -> None:
    room, _ = planted
    (room.parent / "walk").rename(room / "walk")
    (room / "live.db.corrupt-20260101T000000Z").write_bytes(b"x")
    (room / "state.npz.unusable").unlink()
    with hold(room / "state.npz"):  # an edge runs; whoever left an hour ago is in no memory
        assert verb("people", "forget", room, NAME) == 1
    said = capsys.readouterr().out
    assert "live.db.corrupt-20260101T000000Z: may have the person: delete it" in said
    assert "state.npz" not in said and "not everywhere" in said
    assert "walk: a recording of that time" not in said  # it was made an hour later
