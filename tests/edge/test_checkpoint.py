"""A loop that is cut, saved, loaded and continued is the loop that was never cut."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from e3pose.clock import SlotTimes
from e3pose.edge.amend import skip_to, still_true, with_lead
from e3pose.edge.checkpoint import Checkpoint, load_checkpoint, save_checkpoint, take_apart
from e3pose.errors import InputError
from e3pose.evaluate.settings import ReplaySettings, make_pipeline
from e3pose.pipeline import Pipeline, SlotRecord, SlotState, initial_state, step
from e3pose.recording import Recording
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate

CUT, END = 30, 45


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(SceneSettings("ring", people=2, seconds=2.0, fps=25, cameras=3), seed=2)


def made(recording: Recording, pipeline: str) -> Pipeline:
    settings = ReplaySettings(
        pipeline=pipeline,
        num_selected=2,
        lead_slots=3,
        backend="reference",
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


@pytest.mark.parametrize("name", ["paper", "memory"])
def test_continued_loop_is_the_same_loop(name: str, recording: Recording, tmp_path: Path) -> None:
    pipeline, path = made(recording, name), tmp_path / "state.npz"
    state, _ = run(recording, pipeline, initial_state(pipeline), CUT)
    save_checkpoint(path, Checkpoint(state, 12345, 3, 67890), pipeline)
    found = load_checkpoint(path, pipeline)
    assert (found.origin_ns, found.lead_slots, found.made_ns) == (12345, 3, 67890)
    kept, was = take_apart(found.state), take_apart(state)
    assert kept.keys() == was.keys()  # also what only some policies remember
    for name, array in was.items():
        np.testing.assert_array_equal(kept[name], array, name)
    _, expected = run(recording, pipeline, state, END)
    _, records = run(recording, pipeline, found.state, END)
    assert any(len(record.track_ids) for record in records)
    for one, other in zip(expected, records, strict=True):
        assert one.slot == other.slot
        np.testing.assert_array_equal(one.track_ids, other.track_ids)
        np.testing.assert_array_equal(one.poses.joints_m, other.poses.joints_m)
        np.testing.assert_array_equal(one.deficit, other.deficit)
        np.testing.assert_array_equal(one.next_selection, other.next_selection)


def test_checkpoint_of_another_site_is_refused(recording: Recording, tmp_path: Path) -> None:
    pipeline, path = made(recording, "memory"), tmp_path / "state.npz"
    save_checkpoint(path, Checkpoint(initial_state(pipeline), 1, 3, 2), pipeline)
    with pytest.raises(InputError, match="other cameras, joints or estimator"):
        load_checkpoint(path, made(recording, "paper"))
    with pytest.raises(InputError, match="other cameras, joints or estimator"):
        load_checkpoint(path, replace(pipeline, interval_s=0.1))


def test_damage_is_told_and_never_half_believed(recording: Recording, tmp_path: Path) -> None:
    pipeline, path = made(recording, "memory"), tmp_path / "state.npz"
    state, _ = run(recording, pipeline, initial_state(pipeline), 12)
    save_checkpoint(path, Checkpoint(state, 1, 3, 2), pipeline)
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
        for name, array in take_apart(found.state).items():
            np.testing.assert_array_equal(array, take_apart(state)[name])


@pytest.mark.parametrize("change", ["missing", "shape", "kind", "uneven"])
def test_wrong_array_is_named(change: str, recording: Recording, tmp_path: Path) -> None:
    pipeline, path = made(recording, "memory"), tmp_path / "state.npz"
    state, _ = run(recording, pipeline, initial_state(pipeline), 20)
    save_checkpoint(path, Checkpoint(state, 1, 3, 2), pipeline)
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = "state.memory.belief.existence"
    if change == "missing":
        del arrays[name]
    elif change == "shape":
        arrays[name] = arrays[name][:, None]
    elif change == "kind":
        arrays[name] = arrays[name].astype("U4")
    else:
        arrays[name] = arrays[name][:-1]
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=r"state\.memory\.belief"):
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


def test_slots_move_only_with_a_clock_that_went_back() -> None:
    times = SlotTimes(1000 * 10**9, 40_000_000)
    now_ns = times.middle_ns(500)
    assert still_true(times, 501, now_ns, 2) == times
    assert still_true(times, 100, now_ns, 2) == times  # away for a while
    moved = still_true(times, 90_000, now_ns, 2)
    assert moved.slot_at(now_ns) == 90_000 - 3  # the orders can still be in time
