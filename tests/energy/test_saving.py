"""The two savings, against sums made by hand."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.energy.saving import Savings, charged, every_slot_cpu_s, saving

LOOK_S, FRAME_S = 0.168, 0.015  # of a camera on two cores


def share(cpu_s: float, *work: float) -> float | None:
    every_s = every_slot_cpu_s(cpu_s, *work)  # type: ignore[arg-type]
    return None if every_s is None else 1 - cpu_s / every_s


def test_camera_that_looks_in_three_of_five_slots() -> None:
    cpu_s = 600 * LOOK_S + 1000 * FRAME_S
    saved = share(cpu_s, 600 * LOOK_S, 600, 1000, 1000)
    assert saved == pytest.approx(0.4 * LOOK_S / (LOOK_S + FRAME_S))
    assert saved == pytest.approx(0.367, abs=1e-3)


def test_camera_that_sleeps_two_fifths_of_the_time_saves_them() -> None:
    cpu_s = 600 * (LOOK_S + FRAME_S)
    assert share(cpu_s, 600 * LOOK_S, 600, 600, 1000, 0.4) == pytest.approx(0.4)


def test_camera_that_slept_all_the_time_saved_nearly_all() -> None:
    saved = share(5 * (LOOK_S + FRAME_S), 5 * LOOK_S, 5, 5, 100_000, 1.0)
    assert saved is not None and 0.99 < saved < 1.0


def test_camera_that_always_looks_saves_nothing() -> None:
    saved = share(100 * (LOOK_S + FRAME_S), 100 * LOOK_S, 100, 100, 90)
    assert saved == pytest.approx(0.0, abs=1e-9)


@each_case(("looks", "frames"), [(0, 1000), (4, 1000), (30, 3)])
def test_few_looks_or_frames_say_nothing(looks: int, frames: int) -> None:
    assert share(10.0, 5.0, looks, frames, 1000) is None


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
