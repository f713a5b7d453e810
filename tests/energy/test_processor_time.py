"""What resting saves of processor time, against sums made by hand."""

import pytest

from e3pose.energy.processor_time import share_saved

LOOK_S, FRAME_S = 0.168, 0.015  # of a camera on two cores


def test_camera_that_looks_in_three_of_five_slots() -> None:
    cpu_s = 600 * LOOK_S + 1000 * FRAME_S
    saved = share_saved(cpu_s, 600 * LOOK_S, 600, 1000, 1000)
    assert saved == pytest.approx(0.4 * LOOK_S / (LOOK_S + FRAME_S))
    assert saved == pytest.approx(0.367, abs=1e-3)


def test_camera_that_sleeps_two_fifths_of_the_time_saves_them() -> None:
    cpu_s = 600 * (LOOK_S + FRAME_S)
    assert share_saved(cpu_s, 600 * LOOK_S, 600, 600, 1000, 0.4) == pytest.approx(0.4)


def test_camera_that_always_looks_saves_nothing() -> None:
    saved = share_saved(100 * (LOOK_S + FRAME_S), 100 * LOOK_S, 100, 100, 90)
    assert saved == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("looks", "frames"), [(0, 1000), (4, 1000), (30, 3)])
def test_few_looks_or_frames_say_nothing(looks: int, frames: int) -> None:
    assert share_saved(10.0, 5.0, looks, frames, 1000) is None
