"""How long compiling still takes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from tests.cases import each_case
from tests.manual_clock import ManualClock

from e3pose.base.compiling import Compiling, left_s, progress_text


@each_case(
    ("done", "total", "spent_s", "rest_s"),
    [(0, 100, 0, None), (2, 100, 1, None), (25, 100, 10, 30), (100, 100, 40, 0), (0, 0, 0, None)],
)
def test_rest_is_at_the_pace_so_far(
    done: float, total: float, spent_s: float, rest_s: float | None
) -> None:
    assert left_s(done, total, spent_s) == rest_s


def test_rest_is_told_in_steps_of_five_seconds() -> None:
    assert progress_text(None) == "compiling for this machine, once"
    assert progress_text(41.3) == "compiling: 40 s left"
    assert progress_text(0.2) == "compiling: 5 s left"


def test_work_between_two_kernels_does_not_count() -> None:
    clock = ManualClock()
    compiling = Compiling(lambda: clock.time_ns / 1e9)
    kernels = [lambda: 1, lambda: 2, lambda: 3, lambda: 4]
    for kernel in kernels:
        compiling.expect(kernel)

    def compile_one(kernel: Any) -> None:
        about = {"dispatcher": SimpleNamespace(py_func=kernel)}
        compiling.notify(SimpleNamespace(data=about, is_end=False))
        clock.advance(10.0)
        compiling.notify(SimpleNamespace(data=about, is_end=True))

    compile_one(kernels[0])
    assert compiling.left_s() == pytest.approx(30.0)
    clock.advance(3600.0)  # of replays, which need no other kernel
    assert compiling.left_s() == pytest.approx(30.0)
    compile_one(kernels[1])
    assert compiling.left_s() == pytest.approx(20.0)
    compiling.skip(__name__, 30.0)
    assert compiling.left_s() == 0.0
