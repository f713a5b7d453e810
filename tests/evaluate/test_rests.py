"""A replay with rests: sleeping cameras are not seen, joules are saved, people are kept."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.energy.modes import Rest
from e3pose.energy.profiles import load_profile
from e3pose.energy.rest_costs import RestCosts, rest_costs
from e3pose.evaluate.figures import as_json
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy, summarise
from e3pose.evaluate.waking import asleep_in, awake_again
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D
from e3pose.model.slot_record import SlotRecord
from e3pose.recording import Recording
from e3pose.settings.parts import watts_warning
from e3pose.simulate import SceneSettings, simulate

pytestmark = pytest.mark.slow

LEAD = 3


@cache
def scene() -> Recording:
    return simulate(SceneSettings("two-rooms", people=1, seconds=16.0, fps=10), seed=11)


def costs(recording: Recording, wake_sd_s: float = 0.1) -> RestCosts:
    n = len(recording.rig)
    suspended = Rest("suspended", 0.5, 0.2, 0.5, wake_sd_s)
    return rest_costs([12.5] * n, [6.25] * n, [suspended] * n)


def run(recording: Recording, **changes: object) -> list[SlotRecord]:
    settings = ReplaySettings(lead_slots=LEAD, predictor="constant-velocity")
    return list(replay(recording, replace(settings, **changes)))  # type: ignore[arg-type]


PATIENCE_S = 1.5  # of one room watched while the other sleeps


@cache
def resting() -> list[SlotRecord]:
    what = costs(scene())
    return run(scene(), rest="suspended", rest_costs=what, find_within_s=PATIENCE_S)


def drawn_w(records: list[SlotRecord], what: RestCosts) -> NDArray[np.float64]:
    """Return `(num_slots, num_cameras)` watts, falling asleep and waking included."""
    deep = what.deep(asleep_in(records, LEAD), scene().interval_s)
    return np.asarray(what.drawn_w(np.stack([record.selected for record in records]), deep))


def test_sleep_saves_joules() -> None:
    """Most where newcomers may be found late: within 1.5 s both rooms stay watched."""
    usual, sleepy, what = run(scene()), resting(), costs(scene())
    patient = run(scene(), rest="suspended", rest_costs=what, find_within_s=16.0)
    before, after, least = (drawn_w(records, what).mean() for records in (usual, sleepy, patient))
    assert asleep_in(sleepy, LEAD).any() and not asleep_in(usual, LEAD).any()
    assert least < 0.9 * before and least < after < 0.95 * before


@pytest.mark.nightly  # sixteen replays
def test_sleep_keeps_people() -> None:
    """One walk of 16 s loses or keeps two seconds by chance; eight tell."""
    lost = []
    for seed in range(11, 19):
        walk = simulate(SceneSettings("two-rooms", people=1, seconds=16.0, fps=10), seed=seed)
        usual, sleepy = run(walk), run(walk, rest="suspended", rest_costs=costs(walk))
        found, kept = (accuracy(walk, records).recall_500mm or 0.0 for records in (usual, sleepy))
        lost.append(found - kept)
    assert np.mean(lost) < 0.07  # 0.107 where each look of a camera counts as new


def test_a_sleeping_camera_is_neither_selected_nor_seen() -> None:
    records = resting()
    asleep = asleep_in(records, LEAD)
    selected = np.stack([record.selected for record in records])
    arrived = np.stack([record.arrived for record in records])
    assert not (asleep & (selected | arrived)).any()
    settled = slice(10 + LEAD, None)
    assert selected[settled].any(axis=1).all()


@pytest.mark.parametrize("share", [0.5, 0.7])
def test_the_site_draws_the_watts_that_it_may(share: float) -> None:
    what = costs(scene())
    watts = share * (2 * 12.5 + 6 * 6.25)
    records = run(scene(), rest="suspended", rest_costs=what, watts=watts)
    drawn = drawn_w(records, what).sum(axis=1)
    assert drawn[10 + LEAD :].mean() < 1.08 * watts  # of 15 s, over which no more is owed
    assert (accuracy(scene(), records).recall_500mm or 0.0) > 0.5


def test_watts_below_what_all_cameras_draw_at_rest_are_told() -> None:
    asked = ReplaySettings(rest="suspended", rest_costs=costs(scene()))
    least_w = costs(scene()).rest_w.sum()
    words = watts_warning(scene(), replace(asked, watts=0.9 * least_w))
    assert f"less than the {least_w:.3g} W that 8 cameras draw when all are suspended" in words
    assert watts_warning(scene(), replace(asked, watts=1.1 * least_w)) == ""
    assert watts_warning(scene(), asked) == watts_warning(scene(), ReplaySettings()) == ""


def test_a_view_of_a_camera_that_oversleeps_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("e3pose.energy.rest_costs.LATE_SIGMAS", -1.0)  # most alarms are too late
    late = costs(scene(), wake_sd_s=0.3)
    looked: dict[tuple[int, int], bool] = {}

    def read(slot: int, camera: int, expected: ExpectedView | None) -> Poses2D | None:
        looked[slot, camera] = True
        return scene().view(slot, camera)

    settings = ReplaySettings(
        lead_slots=LEAD, predictor="constant-velocity", rest="suspended", rest_costs=late
    )
    records = list(replay(scene(), settings, read_view=read))
    until = {r.slot + LEAD: r.asleep_until for r in records}
    missed = 0
    for record in records[LEAD:]:
        ready = awake_again(until[record.slot], late, scene().interval_s, 0)
        for camera in np.flatnonzero(record.selected & (ready > record.slot)).tolist():
            assert (record.slot, camera) not in looked and not record.arrived[camera]
            missed += 1
    assert missed > 0


def test_oversleeping_is_drawn_once_for_every_alarm() -> None:
    what, until = costs(scene(), wake_sd_s=1.0), np.array([0, 0, 50, 60, 70, 80, 90, 95])
    one, other = (awake_again(until, what, 0.1, seed=3) for _ in range(2))
    assert (one == other).all() and (one >= until).all() and one[0] == 0
    assert (awake_again(until, costs(scene(), 0.0), 0.1, seed=3) == until).all()


@each_case(
    ("changes", "thing"),
    [
        ({"watts": 20.0}, "watts"),
        ({"rest": "suspended", "policy": "round-robin"}, "rest"),
        ({"rest": "suspended"}, "rest"),  # the shipped profile states none
        ({"rest": "asleep", "find_within_s": 0.01}, "find_within"),
    ],
)
def test_settings_that_cannot_be_had_are_refused(changes: dict[str, object], thing: str) -> None:
    with pytest.raises(InputError, match=thing):
        run(scene(), **changes)


def test_figures_of_a_replay_with_rests_are_json_and_count_what_sleep_saved() -> None:
    recording, records = scene(), resting()
    settings = ReplaySettings(lead_slots=LEAD, rest="suspended", rest_costs=costs(recording))
    figures = as_json(summarise(recording, settings, records, load_profile("xavier-nx")))
    assert json.loads(json.dumps(figures))["settings"]["rest"] == "suspended"
    watts = [camera["mean_watts"] for camera in figures["energy"]["cameras"].values()]
    drawn = drawn_w(records, costs(recording)).mean()
    np.testing.assert_allclose(np.mean(watts), drawn, rtol=0.01)
    saved = figures["savings"]["whole_camera"]["percent"]
    active_w = load_profile("xavier-nx").watts("active")
    assert saved == pytest.approx(100 * (1 - np.mean(watts) / active_w))
    usual = as_json(summarise(recording, ReplaySettings(), records, load_profile("xavier-nx")))
    assert not {"rest", "find_within_s", "rest_costs", "watts"} & set(usual["settings"])
