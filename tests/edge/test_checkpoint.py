"""A loop that is cut, saved, loaded and continued is the loop that was never cut."""

from __future__ import annotations

import json
import tracemalloc
import zipfile
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.lib import format as npy
from tests.cases import each_case

from e3pose.base.clock import SlotTimes
from e3pose.base.errors import InputError
from e3pose.edge.checkpoint import (
    Checkpoint,
    flatten,
    load_checkpoint,
    read_arrays,
    save_checkpoint,
    write_arrays,
)
from e3pose.edge.pipeline_owner import skip_to, still_true, with_lead
from e3pose.edge.state_file import StateFile
from e3pose.pipeline import Pipeline, SlotRecord, SlotState, initial_state, step
from e3pose.recording import Recording
from e3pose.settings.loop import ReplaySettings
from e3pose.settings.parts import make_pipeline
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate

pytestmark = pytest.mark.slow

CUT, END = 30, 45


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(SceneSettings("ring", people=2, seconds=2.0, fps=25, cameras=3), seed=2)


def made(recording: Recording, pipeline: str) -> Pipeline:
    settings = ReplaySettings(
        pipeline=pipeline,
        num_selected=2,
        lead_slots=3,
        predictor="zero-velocity",
    )
    return make_pipeline(recording, settings)


def run(
    recording: Recording, pipeline: Pipeline, state: SlotState, end: int
) -> tuple[SlotState, list[SlotRecord]]:
    records = []
    while state.slot < end:
        views = {
            camera: view
            for camera, series in enumerate(recording.views)
            if (view := series.view(state.slot)) is not None
        }
        state, record = step(pipeline, state, views, np.ones(len(recording.rig), dtype=bool))
        records.append(record)
    return state, records


@pytest.fixture(scope="module")
def pipeline(recording: Recording) -> Pipeline:
    return made(recording, "memory")


@pytest.fixture(scope="module")
def begun(recording: Recording, pipeline: Pipeline) -> SlotState:
    """The state after some slots."""
    return run(recording, pipeline, initial_state(pipeline), 20)[0]


@pytest.mark.parametrize("name", ["paper", "memory"])
def test_continued_loop_is_the_same_loop(name: str, recording: Recording, tmp_path: Path) -> None:
    pipeline, path = made(recording, name), tmp_path / "state.npz"
    state, _ = run(recording, pipeline, initial_state(pipeline), CUT)
    save_checkpoint(path, Checkpoint(state, 12345, 3, 67890), pipeline)
    found = load_checkpoint(path, pipeline)
    assert (found.origin_ns, found.lead_slots, found.made_ns) == (12345, 3, 67890)
    kept, was = flatten(found.state), flatten(state)
    assert kept.keys() == was.keys()  # also what only some policies remember
    for name, array in was.items():
        np.testing.assert_array_equal(kept[name], array, name)
    _, expected = run(recording, pipeline, state, END)
    _, records = run(recording, pipeline, found.state, END)
    assert any(len(record.people.track_ids) for record in records)
    for one, other in zip(expected, records, strict=True):
        assert one.slot == other.slot
        np.testing.assert_array_equal(one.people.track_ids, other.people.track_ids)
        np.testing.assert_array_equal(one.people.joints_m, other.people.joints_m)
        np.testing.assert_array_equal(one.deficit, other.deficit)
        np.testing.assert_array_equal(one.next_selection, other.next_selection)


def test_checkpoint_of_another_site_is_refused(recording: Recording, tmp_path: Path) -> None:
    pipeline, path = made(recording, "memory"), tmp_path / "state.npz"
    save_checkpoint(path, Checkpoint(initial_state(pipeline), 1, 3, 2), pipeline)
    with pytest.raises(InputError, match="other cameras, joints or estimator"):
        load_checkpoint(path, made(recording, "paper"))
    with pytest.raises(InputError, match="other cameras, joints or estimator"):
        load_checkpoint(path, replace(pipeline, interval_s=0.1))


def test_damage_is_reported_and_never_half_believed(
    pipeline: Pipeline, begun: SlotState, tmp_path: Path
) -> None:
    path = tmp_path / "state.npz"
    save_checkpoint(path, Checkpoint(begun, 1, 3, 2), pipeline)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for length in rng.integers(0, len(whole), 20).tolist():
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"state\.npz"):
            load_checkpoint(path, pipeline)
    for place in rng.integers(0, len(whole), 60).tolist():
        damaged = bytearray(whole)
        damaged[place] ^= 0xFF
        path.write_bytes(bytes(damaged))
        try:  # a flipped byte in a file name of the archive's directory may do no harm
            found = load_checkpoint(path, pipeline)
        except InputError:
            continue
        for name, array in flatten(found.state).items():
            np.testing.assert_array_equal(array, flatten(begun)[name])


@each_case("change", ["missing", "shape", "kind", "uneven"])
def test_wrong_array_is_named(
    change: str, pipeline: Pipeline, begun: SlotState, tmp_path: Path
) -> None:
    path = tmp_path / "state.npz"
    save_checkpoint(path, Checkpoint(begun, 1, 3, 2), pipeline)
    about, arrays = read_arrays(path)
    name = "state.memory.belief.existence"
    if change == "missing":
        del arrays[name]
    elif change == "shape":
        arrays[name] = arrays[name][:, None]
    elif change == "kind":
        arrays[name] = arrays[name].astype("U4")
    else:
        arrays[name] = arrays[name][:-1]
    write_arrays(path, about, arrays)
    wrong = "no checkpoint .*belief" if change == "kind" else r"state\.memory\.belief"
    with pytest.raises(InputError, match=wrong):
        load_checkpoint(path, pipeline)


def test_longer_lead_repeats_the_last_decision(recording: Recording) -> None:
    state = initial_state(made(recording, "paper"))
    decided = np.array([[True, False, False], [False, True, False], [False, False, True]])
    state = replace(state, selections=decided)
    assert with_lead(state, 5).selections.tolist() == [
        *decided.tolist(),
        *[decided[-1].tolist()] * 2,
    ]
    assert with_lead(state, 1).selections.tolist() == decided[:1].tolist()


def test_slots_left_out_save_energy_and_wake_everybody(recording: Recording) -> None:
    state = initial_state(made(recording, "paper"))
    state = replace(
        state, slot=10, deficit=np.array([3.0, 0.5, 0.0]), selections=np.zeros((3, 3), dtype=bool)
    )
    later = skip_to(state, 14, np.full(3, 0.5))
    assert later.slot == 14 and later.selections.all()
    assert later.deficit.tolist() == [1.0, 0.0, 0.0]
    assert skip_to(state, 10, np.full(3, 0.5)) is state


@each_case(
    ("slot", "away_s", "why"),
    [
        (501, 0.0, ""),
        (100, 0.0, ""),  # away for a while
        (90_000, 0.0, "this machine's clock went back by 60 min"),
        (500, 130.0, "130.0 s since the last slot, by this machine's clock"),
        (500, 3600.0, "60 min since the last slot, by this machine's clock"),
        (500, 3650 * 86400.0, "10.0 years since the last slot, by this machine's clock"),
    ],
)
def test_slot_numbers_do_not_jump_by_a_clock(slot: int, away_s: float, why: str) -> None:
    times = SlotTimes(1000 * 10**9, 40_000_000)
    now_ns = times.middle_ns(500) + round(away_s * 1e9)
    moved, reported = still_true(times, slot, now_ns, 2)
    assert reported == why
    assert moved.slot_at(now_ns) == (slot - 3 if why else 500)  # the orders can still be in time


@pytest.mark.parametrize("name", ["paper", "memory"])
def test_forgotten_people_leave_what_was_learned_of_the_site(
    name: str, recording: Recording
) -> None:
    pipeline = made(recording, name)
    state, records = run(recording, pipeline, initial_state(pipeline), CUT)
    assert len(records[-1].people.track_ids)
    memory = pipeline.estimator.forget_people(state.memory)
    kept, was = flatten(memory), flatten(state.memory)
    kept_of_site = (
        "next_id", "failed_pairs", "detection_map", "noise", "time_s",
        "lasting.total", "lasting.seconds",
    )  # fmt: skip
    assert kept.keys() == was.keys()
    for part, array in kept.items():
        if part.endswith(kept_of_site):
            np.testing.assert_array_equal(array, was[part])
        elif part.endswith("factor"):
            assert array == 1.0
        elif part.endswith("looks.times_s"):
            assert not np.isfinite(array).any()
        else:
            assert array.size == 0, part
    state, (record,) = run(recording, pipeline, replace(state, memory=memory), CUT + 1)
    assert not set(record.people.track_ids.tolist()) & set(records[-1].people.track_ids.tolist())


Change = Callable[[dict[str, Any], dict[str, Any]], None]


def change_file(path: Path, change: Change) -> None:
    """Rewrite what a checkpoint says of itself, and its arrays."""
    about, arrays = read_arrays(path)
    change(about, arrays)
    write_arrays(path, about, arrays)


def header(**values: int) -> Change:
    def change(about: dict[str, Any], _: dict[str, Any]) -> None:
        about.update(values)

    return change


def every_integer(value: int) -> Change:
    def change(_: dict[str, Any], arrays: dict[str, Any]) -> None:
        for name, array in arrays.items():
            if array.dtype.kind == "i":
                arrays[name] = np.full_like(array, value)

    return change


def value(part: str, to: float) -> Change:
    def change(_: dict[str, Any], arrays: dict[str, Any]) -> None:
        name = f"state.{part}"
        arrays[name] = np.full_like(arrays[name], to)

    return change


HOSTILE = {
    "slot 2^62": value("slot", 2**62),
    "slot of a wrong clock": value("slot", 275_467_036_077),
    "slot -1": value("slot", -1),
    "run 10^30": header(run_ns=10**30),
    "run -1": header(run_ns=-1),
    "made 10^30": header(made_ns=10**30),
    "origin -10^300": header(origin_ns=-(10**300)),
    "every integer -1": every_integer(-1),
    "every integer 2^40": every_integer(2**40),
    "a camera there is none": value("memory.belief.leftovers.cameras", 3),
    "a track with an id to come": value("memory.belief.track_ids", 1000),
    "never tried again": value("silence.retry_slot", 2**40),
    "asleep for ever": value("asleep_until", 2**40),
    "looked in the future": value("last_views.0.slot", 2**40),
    "missed more than there were slots": value("silence.failures", 2**40),
    "queue of NaN": value("deficit", np.nan),
    "far beyond the universe": value("memory.belief.state", 1e200),
}


@each_case("name", HOSTILE)
def test_values_that_make_no_sense_begin_afresh(
    name: str, pipeline: Pipeline, begun: SlotState, tmp_path: Path
) -> None:
    path = tmp_path / "state.npz"
    leftovers = replace(
        begun.memory.belief.leftovers,
        times_s=np.zeros(1),
        cameras=np.zeros(1, dtype=np.int64),
        keypoints_px=np.full((1, 17, 2), 100.0),
        scores=np.ones((1, 17)),
    )
    belief = replace(begun.memory.belief, leftovers=leftovers)
    state = replace(begun, memory=replace(begun.memory, belief=belief))
    save_checkpoint(path, Checkpoint(state, 1, 3, 2), pipeline)
    reported: list[str] = []

    def taken_up() -> Checkpoint | None:
        return StateFile(
            pipeline, path, lambda kind, message: reported.append(message), 0
        ).take_up()

    assert taken_up() is not None and not reported
    change_file(path, HOSTILE[name])
    assert taken_up() is None
    assert len(reported) == 1 and "started without the saved state" in reported[0]
    assert not path.exists()


def test_state_that_the_loop_fails_on_begins_afresh(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipeline, path = made(recording, "memory"), tmp_path / "state.npz"
    save_checkpoint(path, Checkpoint(initial_state(pipeline), 1, 3, 2), pipeline)

    def fail(*_: object) -> None:
        raise ZeroDivisionError("one of many")

    monkeypatch.setattr("e3pose.edge.state_file.step", fail)
    reported: list[str] = []
    assert (
        StateFile(pipeline, path, lambda kind, message: reported.append(message), 0).take_up()
        is None
    )
    assert "the loop fails on" in reported[0] and "one of many" in reported[0]


@each_case(
    "layout",
    [
        [["state.slot", "<i8", [2**40]]], [["state.slot", "<i8", [-1]]], [["a", "|O", [1]]],
        [["a", "<i8", [1]], ["a", "<i8", [1]]], [["a", "V99999999999", [1]]], [["a"]], 7, "abc",
        [["a", "<f8,<f8", []]], [["a", "|u1", []]],
    ],
    ids=str,
)  # fmt: skip
def test_layout_that_does_not_fit_is_refused(
    layout: Any, pipeline: Pipeline, tmp_path: Path
) -> None:
    path = tmp_path / "state.npz"
    said = np.frombuffer(json.dumps({"version": 18, "layout": layout}).encode(), np.uint8)
    np.savez(path, about=said, values=np.zeros(16, np.uint8))
    with pytest.raises(InputError, match=r"state\.npz: found no checkpoint"):
        load_checkpoint(path, pipeline)


def test_zip_bomb_is_refused_before_it_is_unpacked(pipeline: Pipeline, tmp_path: Path) -> None:
    path = tmp_path / "state.npz"
    save_checkpoint(path, Checkpoint(initial_state(pipeline), 1, 3, 2), pipeline)
    with (
        zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive,
        archive.open("state.more.npy", "w", force_zip64=True) as member,
    ):
        head = {"descr": "<f8", "fortran_order": False, "shape": (2**25,)}
        npy.write_array_header_1_0(member, head)
        for _ in range(256):
            member.write(bytes(2**20))
    tracemalloc.start()
    with pytest.raises(InputError, match=r"state\.npz: found no checkpoint \(found packed"):
        load_checkpoint(path, pipeline)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16 * 2**20


def test_arrays_that_share_their_bytes_are_refused(pipeline: Pipeline, tmp_path: Path) -> None:
    path = tmp_path / "state.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", bytes(10_000))
        for number in range(1000):
            archive.filelist.append(copy(archive.filelist[0]))
            archive.filelist[-1].filename = f"{number}.npy"
    with pytest.raises(InputError, match="1001 arrays larger than the file"):
        load_checkpoint(path, pipeline)
