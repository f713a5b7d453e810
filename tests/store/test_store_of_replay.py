"""What a replay stored is what the store answers, and enough to smooth it later."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run
from tests.cli.one_person import one_person

from e3pose.energy.queues import load_profile
from e3pose.estimate.smooth import SmoothSettings, smoothed
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.skeleton import COCO17
from e3pose.model.take import Take
from e3pose.output.exports.source import Asked, take_from_store
from e3pose.recording import Recording, save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.store import Run, Store, StoreWriter

pytestmark = pytest.mark.slow

NUM_SLOTS = 30


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One person walking, seen exactly by three cameras."""
    path = tmp_path_factory.mktemp("store") / "walk"
    save_recording(replace(one_person([0.2, 2.3, 4.4], NUM_SLOTS, truth=False), name="walk"), path)
    return path


def test_store_answers_what_the_replay_wrote(recording: Path, tmp_path: Path) -> None:
    store, poses = tmp_path / "walk.db", tmp_path / "poses.csv"
    code = run(
        "replay", str(recording), "--policy", "round-robin", "--cameras", "2",
        "--profile", "tx2", "--store", str(store), "--poses", str(poses),
    )  # fmt: skip
    assert code == 0
    rows = list(csv.DictReader(poses.read_text().splitlines()))
    found = Store(store).query("0", "10")
    assert len(found) > NUM_SLOTS - 5
    assert found.slots.tolist() == [int(row["slot"]) for row in rows[:: len(COCO17)]]
    stored_m = np.array([[float(row[axis]) for axis in "xyz"] for row in rows])
    np.testing.assert_allclose(found.people.joints_m.reshape(-1, 3), stored_m, atol=1e-5)
    slots = Store(store).rows("slots")
    assert [slot["selected"].count("1") for slot in slots] == [3] * 10 + [2] * 20
    device = load_profile("tx2")
    watts = {"1": device.watts("active"), "0": device.watts("power-saving")}
    expected = [[watts[flag] / 25 for flag in slot["selected"]] for slot in slots]
    np.testing.assert_allclose([slot["energy_j"] for slot in slots], expected, rtol=1e-6)
    (one,) = Store(store).runs()
    assert one.run.site == "walk"
    assert one.run.cameras == ("c0", "c1", "c2")


def test_a_layout_has_the_same_columns_from_every_verb(recording: Path, tmp_path: Path) -> None:
    dates = {"run", "time", "time_ns"}  # of a store alone, or in its form
    for layout in ("long", "wide"):
        store, first, second = (tmp_path / f"{layout}.{end}" for end in ("db", "csv", "too.csv"))
        replayed = ("--poses", first, "--layout", layout, "--store", store, "--policy", "all")
        assert run("replay", recording, *replayed) == 0
        assert run("export", store, second, "--layout", layout) == 0
        tables = [list(csv.DictReader(path.read_text().splitlines())) for path in (first, second)]
        if layout == "long":
            assert run("export", store, tmp_path / "rows.csv", "--what", "poses") == 0
            tables.append(list(csv.DictReader((tmp_path / "rows.csv").read_text().splitlines())))
        shown = [[{k: v for k, v in row.items() if k not in dates} for row in t] for t in tables]
        assert len(shown[0]) >= (NUM_SLOTS - 5) * (len(COCO17) if layout == "long" else 1)
        for other in shown[1:]:
            assert [list(row) for row in other] == [list(row) for row in shown[0]]
            for ours, theirs in zip(shown[0], other, strict=True):
                for name in ours:
                    if name in ("joint", "measured") or name.endswith("_origin"):
                        assert ours[name] == theirs[name]
                    elif ours[name] or theirs[name]:
                        assert float(ours[name]) == pytest.approx(float(theirs[name]), abs=2e-3)


NEAR_M = 0.5


def error_mm(take: Take, recording: Recording) -> float:
    """Return the mean distance of joints from those of the nearest person of the truth."""
    assert recording.truth is not None
    found = []
    for motion in take.motions:
        truth = recording.truth.joints_m[motion.first : motion.first + len(motion)]
        apart = np.linalg.norm(truth - motion.joints_m[:, None], axis=-1)
        with np.errstate(invalid="ignore"):
            whole = np.nanmean(np.where(motion.known[:, None], apart, np.nan), axis=-1)
        nearest = np.nanargmin(whole, axis=1)
        own = apart[np.arange(len(motion)), nearest]
        found.append(own[motion.known & (own < NEAR_M)])
    return 1000 * float(np.concatenate(found).mean())


@pytest.mark.parametrize(("cameras", "gain"), [(1, 0.15), (5, 0.0)])
def test_a_store_is_smoothed_nearly_as_well_as_a_replay(
    tmp_path: Path, cameras: int, gain: float
) -> None:
    recording = simulate(SceneSettings(scene="ring", people=2, seconds=12, fps=12.5), 1003)
    started_ns, interval_s = 1_700_000_000_000_000_000, recording.interval_s
    names = tuple(camera.camera_id for camera in recording.rig.cameras)
    skeleton = recording.skeleton
    run = Run("lab", "r", started_ns, interval_s, skeleton.name, skeleton.joints, names)
    with StoreWriter(str(tmp_path / "live.db"), run) as writer:
        settings = ReplaySettings(num_selected=cameras, seed=1, phase=1)
        for record in replay(recording, settings):
            writer.append(record, wait=True)
    take = take_from_store(str(tmp_path / "live.db"), Asked())
    before, after = (
        error_mm(each, recording) for each in (take, smoothed(take, SmoothSettings("rts")))
    )
    assert after < (1 - gain) * before, (before, after)
