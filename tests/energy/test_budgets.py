"""The two savings and what budgets pay for, against sums made by hand."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.energy.budgets import (
    FOREVER_S,
    Budget,
    Supply,
    allowance_j,
    common_lifetime,
    parse_budget,
    slot_shares,
)
from e3pose.energy.queues import advance_deficit
from e3pose.energy.saving import Savings, charged, every_slot_cpu_s, saving
from e3pose_lab.reproduce.depletion import BatteryCamera, deplete

HOME = timezone(timedelta(hours=1))
NOW = datetime(2026, 11, 21, 14, 30, tzinfo=HOME)
ACTIVE_W, IDLE_W = 10.0, 4.0
SLOT_S = 0.04


@each_case(
    ("words", "kind", "value"),
    [
        ("0.6", "duty", 0.6),
        ("60%", "duty", 0.6),
        ("100%", "duty", 1.0),
        ("0.3J", "joules", 0.3),
        ("300 mJ", "joules", 0.3),
        ("4.5W", "watts", 4.5),
        ("until 18:00", "until", datetime(2026, 11, 21, 18, tzinfo=HOME).timestamp()),
        ("until 23:30", "until", datetime(2026, 11, 21, 23, 30, tzinfo=HOME).timestamp()),
        ("until 14:30", "until", NOW.timestamp() + 86_400),  # the next one
        ("until 09:15", "until", datetime(2026, 11, 22, 9, 15, tzinfo=HOME).timestamp()),
        ("until 2026-11-22T06:00Z", "until", datetime(2026, 11, 22, 7, tzinfo=HOME).timestamp()),
        ("for 8h", "until", NOW.timestamp() + 8 * 3600),
        ("together", "together", 0.0),
    ],
)
def test_spellings(words: str, kind: str, value: float) -> None:
    budget = parse_budget(words, NOW)
    assert budget.kind == kind
    assert budget.value == pytest.approx(value, rel=1e-12)  # seconds of 1.7e9


@each_case(
    "words", ["", "0", "1.5", "150%", "-2W", "4", "until 25:00", "until 2020-01-01", "for 3", "all"]
)
def test_anything_else_is_refused(words: str) -> None:
    with pytest.raises(InputError, match="budget: found"):
        parse_budget(words, NOW)


def shares_of(budget: Budget, supply: Supply, now_s: float = 0.0) -> float:
    active_j, idle_j = [ACTIVE_W * SLOT_S], [IDLE_W * SLOT_S]
    allowed = allowance_j([budget], [supply], active_j, idle_j, SLOT_S, now_s, 1)
    return float(slot_shares(allowed, active_j, idle_j)[0])


@each_case(
    ("budget", "supply", "share"),
    [
        (Budget("duty", 0.35), Supply(), 0.35),
        (Budget("joules", 0.28), Supply(), 0.5),  # 7 W on average
        (Budget("watts", 5.5), Supply(), 0.25),
        (Budget("watts", 50.0), Supply(), 1.0),
        (Budget("watts", 2.0), Supply(), 1e-3),  # less than an idle camera draws
        (Budget("until", 3600.0), Supply(7.0 * 3600), 0.5),
        (Budget("until", 3600.0), Supply(7.0 * 3600, 1.5), 0.75),  # the sun raises it
        (Budget("until", 3600.0), Supply(0.0, 10.0), 1.0),
        (Budget("until", 3600.0), Supply(), 1.0),  # on mains
    ],
)
def test_share_that_a_budget_pays_for(budget: Budget, supply: Supply, share: float) -> None:
    assert shares_of(budget, supply) == pytest.approx(share)


def test_nothing_is_saved_once_the_time_has_come() -> None:
    assert shares_of(Budget("until", 3600.0), Supply(10.0), now_s=3600.0) == 1.0


def test_battery_lasts_exactly_until_its_time() -> None:
    """Follow the share, updated every minute, and the battery is empty at the time named."""
    battery_j, now_s, end_s = 6.3 * 7200, 0.0, 7200.0
    while battery_j > 0 and now_s < 2 * end_s:
        share = shares_of(Budget("until", end_s), Supply(battery_j), now_s)
        battery_j -= 60 * (IDLE_W + share * (ACTIVE_W - IDLE_W))
        now_s += 60
    assert now_s == pytest.approx(end_s, abs=60)


def test_queue_keeps_the_joules_that_were_allowed() -> None:
    """The paper's queue with that share spends the allowance, over many slots."""
    active_j, idle_j = np.array([0.4, 0.5]), np.array([0.1, 0.2])
    budgets = [Budget("joules", 0.22), Budget("watts", 0.35 / SLOT_S)]
    allowed = allowance_j(budgets, [Supply()] * 2, active_j, idle_j, SLOT_S, 0.0, 1)
    shares = slot_shares(allowed, active_j, idle_j)
    deficit, spent_j = np.zeros(2), np.zeros(2)
    for _ in range(5000):
        selected = deficit < 1.0
        deficit = advance_deficit(deficit, shares, selected)
        spent_j += np.where(selected, active_j, idle_j)
    np.testing.assert_allclose(spent_j / 5000, [0.22, 0.35], rtol=0.01)


@settings(max_examples=80)
@given(
    st.lists(
        st.tuples(st.floats(1e3, 1e6), st.floats(1.0, 5.0), st.floats(0.5, 10.0), st.floats(0, 6)),
        min_size=1,
        max_size=8,
    ),
    st.floats(0.5, 4.0),
)
def test_common_lifetime_is_the_longest(
    cameras: list[tuple[float, float, float, float]], num_selected: float
) -> None:
    supplies = [Supply(battery_j, sun_w) for battery_j, _, _, sun_w in cameras]
    idle_w = np.array([idle for _, idle, _, _ in cameras])
    active_w = idle_w + [extra for _, _, extra, _ in cameras]
    shares, seconds = common_lifetime(supplies, active_w, idle_w, num_selected)
    wanted = min(num_selected, len(cameras))
    assert ((shares >= 0) & (shares <= 1 + 1e-9)).all()
    assert shares.sum() == pytest.approx(wanted, rel=1e-6)
    for supply, share, active, idle in zip(supplies, shares, active_w, idle_w, strict=True):
        spent_w = idle + share * (active - idle) - supply.charging_w
        lasts_s = supply.battery_j / spent_w if spent_w > 0 else np.inf
        if share > 1e-6:  # one that may not even be idle so long gets nothing
            assert lasts_s >= seconds * (1 - 1e-6)
        if 1e-6 < share < 1 - 1e-6 and seconds < FOREVER_S:
            assert lasts_s == pytest.approx(seconds, rel=1e-6)


def test_those_with_budgets_of_their_own_count() -> None:
    active_j, idle_j = np.full(3, 0.4), np.full(3, 0.1)
    budgets = [Budget("duty", 0.9), Budget("together"), Budget("together")]
    supplies = [Supply(), Supply(36_000.0), Supply(36_000.0)]
    allowed = allowance_j(budgets, supplies, active_j, idle_j, SLOT_S, 0.0, 2.0)
    np.testing.assert_allclose(slot_shares(allowed, active_j, idle_j), [0.9, 0.55, 0.55])


def test_unequal_batteries_run_out_together_instead_of_one_by_one() -> None:
    """36 to 60 Wh: the paper's equal budgets lose the first camera long before the last."""
    cameras = [BatteryCamera(wh / 10, 12.5, 6.25) for wh in (36, 42, 50, 55, 60)]
    equal = deplete(cameras, 3, "equal")
    together = deplete(cameras, 3, "together")
    # 243 Wh/10 for 3 active and 2 idle cameras of 50 W in all: no policy can do better than this.
    ideal_h = 24.3 / 50
    np.testing.assert_allclose(together.empty_h, ideal_h, rtol=0.02)
    assert together.full_h == pytest.approx(ideal_h, rel=0.02)
    assert equal.full_h < 0.8 * ideal_h
    assert np.ptp(equal.empty_h) > 10 * np.ptp(together.empty_h)
    assert np.all(np.diff(together.duty) > 0), "who has more does more"


LOOK_S, FRAME_S = 0.168, 0.015  # of a camera on two cores


def share(cpu_s: float, *work: float) -> float | None:
    every_s = every_slot_cpu_s(cpu_s, *work)  # type: ignore[arg-type]
    return None if every_s is None else 1 - cpu_s / every_s


def test_a_camera_saves_the_looks_and_frames_that_it_leaves_out() -> None:
    saved = share(600 * LOOK_S + 1000 * FRAME_S, 600 * LOOK_S, 600, 1000, 1000)
    assert saved == pytest.approx(0.4 * LOOK_S / (LOOK_S + FRAME_S))
    assert saved == pytest.approx(0.367, abs=1e-3)
    asleep = share(600 * (LOOK_S + FRAME_S), 600 * LOOK_S, 600, 600, 1000, 0.4)
    assert asleep == pytest.approx(0.4)
    nearly_all = share(5 * (LOOK_S + FRAME_S), 5 * LOOK_S, 5, 5, 100_000, 1.0)
    assert nearly_all is not None and 0.99 < nearly_all < 1.0
    nothing = share(100 * (LOOK_S + FRAME_S), 100 * LOOK_S, 100, 100, 90)
    assert nothing == pytest.approx(0.0, abs=1e-9)
    for looks, frames in ((0, 1000), (4, 1000), (30, 3)):
        assert share(10.0, 5.0, looks, frames, 1000) is None  # few say nothing


def test_saving_is_of_all_cameras_together() -> None:
    found = saving([1.0, 9.0], [10.0, 10.0], measured=True)  # not the mean of 90 and 10 %
    assert found is not None and found.percent == pytest.approx(50.0)
    assert (found.spent, found.always, found.basis) == (10.0, 20.0, "measured")
    assert str(saving(70.6, 100.0, measured=False)) == "29 % (modelled)"
    assert str(saving(100.2, 100.0, measured=False)) == "0 % (modelled)"
    for spent in (87.5, 87.5 * (1 - 1e-9), 87.5 * (1 + 1e-9)):
        assert str(saving(spent, 100.0, measured=False)) == "13 % (modelled)"


@each_case(("spent", "always"), [(0.0, 0.0), (np.nan, 1.0), (1.0, np.inf), ([], [])])
def test_without_figures_there_is_no_saving(spent: object, always: object) -> None:
    assert saving(spent, always, measured=True) is None  # type: ignore[arg-type]


def test_both_are_named_in_one_sentence_of_which_one_may_be_unknown() -> None:
    said = Savings(saving(3.0, 4.0, measured=False)).sentence()
    assert said == (
        "Saved, compared with all cameras active in every slot: whole camera 25 % (modelled), "
        "processor time not measured"
    )


def test_slots_are_compared_with_active_ones_at_the_cost_that_they_are_charged_with() -> None:
    selected = np.array([[True, False], [False, False], [True, False]])
    charged_j = np.array([[0.8, 0.3], [0.3, 0.3], [0.35, 0.3]])  # the last one gated, learned 8 W
    spent_j, always_j = charged(
        selected, charged_j, np.array([1.25, 1.0]), np.array([2.0, 1.0, 1.0])
    )
    np.testing.assert_allclose(spent_j, [2.25, 1.2])
    # The first by its own slots, and not by its profile; the second was never active.
    np.testing.assert_allclose(always_j, [4 * 0.8, 4 * 1.0])
    nothing = charged(selected[:0], charged_j[:0], np.ones(2))
    assert [part.tolist() for part in nothing] == [[0, 0], [0, 0]]
