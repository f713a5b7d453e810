"""Kernels: kept on disk, called by others, constants as one pointer, what is left to compile."""

from __future__ import annotations

import gc
import math
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba.core.caching import FunctionCache
from numpy.typing import NDArray
from tests.cases import each_case
from tests.manual_clock import ManualClock

from e3pose.base import kernel_cache
from e3pose.base.arrays import Floats
from e3pose.base.compiling import Compiling, left_s, progress_text
from e3pose.base.dispatcher import Part, Whole
from e3pose.base.kernel import INTERPRETING, kernel
from e3pose.base.kernel_arguments import Held
from e3pose.base.kernel_cache import KernelCache, sources_of, stamp_of
from e3pose.estimate.filter import bias, step
from e3pose.estimate.per_slot import fuse
from e3pose.predict.kernels import prediction
from e3pose.select.kernels import foresight


@kernel
def thrice(values: Any) -> float:
    return 3 * float(values.sum())


@each_case(
    ("declared", "taken_over"),
    [
        (step, {"step.py", "update.py", "undistort.py", "triangulate.py", "outliers.py"}),
        (fuse, {"fuse.py", "pairs.py", "triangulate.py", "undistort.py", "distortion.py"}),
        (foresight, {"foresight.py", "bias.py", "carry.py", "projection.py"}),
        (prediction, {"network.py", "layers.py", "history.py"}),
    ],
)
def test_kernel_on_disk_is_stamped_with_all_that_it_takes_over(
    declared: Any, taken_over: set[str]
) -> None:
    sources = {path.name for path in sources_of(Path(declared.__file__).resolve())}
    assert {*taken_over, "kernel.py", "dispatcher.py", "kernel_cache.py"} <= sources
    others = {path.name for path in sources_of(Path(bias.__file__).resolve())}
    assert not {"foresight.py", "step.py"} & others, "which it does not import"


def test_a_changed_source_makes_another_stamp(tmp_path: Path) -> None:
    path = tmp_path / "law.py"
    stamps = set()
    for text in ("A = 1\n", "A = 2\n", "from e3pose.estimate.filter import bias\nA = 2\n"):
        path.write_text(text)
        for cached in (kernel_cache._imported, sources_of, stamp_of):
            cached.cache_clear()
        stamps.add(stamp_of(path))
    assert len(stamps) == 3


def test_numba_keeps_a_kernel_under_its_stamp() -> None:
    kept = step.step_slot.compiled._cache  # type: ignore[attr-defined]
    assert isinstance(kept, KernelCache)
    assert kept._cache_file._source_stamp == stamp_of(Path(step.__file__).resolve())


def test_index_on_disk_of_another_version_is_stale_and_no_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    thrice(np.ones(2))
    dispatcher: Any = thrice.compiled  # type: ignore[attr-defined]
    kept, (types,) = dispatcher._cache, dispatcher.overloads
    assert kept.is_filled() and kept.load_overload(types, dispatcher.targetctx) is not None

    def broken() -> dict[object, str]:
        raise AttributeError("Can't get attribute 'Scratch'")

    monkeypatch.setattr(kept._cache_file, "_load_index", broken)
    assert not kept.is_filled() and kept.load_overload(types, dispatcher.targetctx) is None
    kept.save_overload(types, dispatcher.overloads[types])  # as beside a program of that version
    monkeypatch.undo()
    assert not kept.is_filled()  # emptied, so that the next one can be kept


def test_declaring_a_kernel_imports_no_compiler() -> None:
    code = "import sys, e3pose.base.kernel; print('numba' in sys.modules)"
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout
    assert output.strip() == "False"


def test_threads_that_call_a_new_kernel_share_what_is_compiled() -> None:
    @kernel
    def doubled(value: float) -> float:
        return 2 * value

    found: list[tuple[float, int]] = []

    def call() -> None:
        found.append((doubled(2.0), id(doubled.compiled)))  # type: ignore[attr-defined]

    threads = [threading.Thread(target=call) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {value for value, _ in found} == {4.0} and len({made for _, made in found}) == 1


def test_full_disk_keeps_no_kernel_and_stops_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(FunctionCache, "save_overload", full)

    @kernel
    def half(number: float) -> float:
        return number / 2

    assert half(4.0) == 2.0


class Inner(NamedTuple):
    values: NDArray[np.float64]
    factor: float


class Outer(NamedTuple):
    inner: Inner
    rows: NDArray[np.int64]


@kernel
def scale(held: Held[Outer]) -> float:
    outer = held.values
    for row in outer.rows:
        outer.inner.values[row] *= outer.inner.factor
    return float(outer.inner.values.sum())


def test_a_kernel_works_on_the_arrays_that_are_held() -> None:
    values = np.arange(4.0)
    held = Held(Outer(Inner(values, 3.0), np.array([1, 3])))
    assert scale(held) == 3.0 + 2.0 + 9.0
    np.testing.assert_array_equal(values, [0.0, 3.0, 2.0, 9.0])
    alive = Held(Outer(Inner(np.ones(1000), 1.0), np.zeros(0, dtype=np.int64)))
    np.full(1000, 7.0)
    assert scale(alive) == 1000.0  # arrays live as long as what holds them
    assert len(scale.compiled.signatures) == 1  # type: ignore[attr-defined]


@kernel
def double(values: Floats, index: int) -> float:
    return 2 * float(values[index])


@kernel
def head(values: Floats, count: int) -> Any:
    return values[:count]


@kernel
def summed(values: Floats, start: int) -> float:
    total = 0.0
    for index in range(start, len(values)):
        total += double(values, index)
    return total


@kernel
def checked(values: Floats) -> float:
    if len(values) == 0:
        raise ValueError("no values")
    return summed(values, 0) + summed(head(values, 2), 1)


@kernel
def outer(values: Floats) -> float:
    room = np.zeros(3)
    for row in range(3):
        room[row] = checked(values[row:])
    return float(room.sum())


@kernel
def without_domain(value: float) -> tuple[float, float, float]:
    return 1.0 / math.sqrt(value), math.log(value), math.exp(1e3 + value)


def test_interpreted_kernels_go_on_where_python_would_not(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = [without_domain(value) for value in (-1.0, 0.0, 4.0)]
    monkeypatch.setattr(INTERPRETING, "on", True)
    with np.errstate(all="ignore"):
        interpreted = [without_domain(value) for value in (-1.0, 0.0, 4.0)]
    np.testing.assert_allclose(interpreted, compiled, rtol=1e-15)
    assert np.isnan(compiled[0][0]) and compiled[1][:2] == (np.inf, -np.inf)


def forms(function: Any) -> list[type]:
    return [type(found.library) for found in function.compiled.overloads.values()]


def test_what_a_kernel_calls_is_a_part_until_python_calls_it() -> None:
    values = np.arange(4.0)
    assert outer(values) == 12 + 12 + 10 + (2 + 4 + 6)
    if forms(double):  # compiled now, not loaded from disk
        kept = [*double.compiled.overloads.values(), *outer.compiled.overloads.values()]  # type: ignore[attr-defined]
        assert not any(one.fndesc.calltypes or one.type_annotation for one in kept)
        assert all(one.library._final_module is None for one in kept if type(one.library) is Part)
        assert set(forms(double)) == {Part} and set(forms(outer)) == {Whole}
    assert double(values, 3) == 6.0
    assert Whole in forms(double)
    assert outer(values) == 46
    assert len(forms(summed)) <= 1  # though it is called with 0 and with 1
    with pytest.raises(ValueError, match="no values"):
        outer(values[:2])


def test_a_kernel_that_was_loaded_is_compiled_as_a_part_of_a_new_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On disk is its machine code alone, which is no part of anything."""
    values = np.arange(4.0)
    double(values, 3)
    vars(double).pop("compiled")
    assert double(values, 3) == 6.0
    (loaded,) = double.compiled.overloads.values()  # type: ignore[attr-defined]
    assert loaded.metadata is None and len(loaded.library._shared_module.as_bitcode()) < 4000
    monkeypatch.setattr(KernelCache, "load_overload", lambda *_: None)

    @kernel
    def quadruple(values: Floats, index: int) -> float:
        return 2 * double(values, index)

    assert quadruple(values, 3) == 12.0 and double(values, 3) == 6.0
    assert forms(double) == [Part]


def test_arrays_of_parts_are_neither_freed_nor_kept() -> None:
    values = np.arange(4.0)
    before = sys.getrefcount(values)
    for _ in range(2000):
        outer(values)
    gc.collect()
    assert sys.getrefcount(values) == before
    np.testing.assert_array_equal(values, np.arange(4.0))


@each_case(
    ("done", "total", "spent_s", "rest_s"),
    [(0, 100, 0, None), (2, 100, 1, None), (25, 100, 10, 30), (100, 100, 40, 0), (0, 0, 0, None)],
)
def test_rest_is_at_the_pace_so_far(
    done: float, total: float, spent_s: float, rest_s: float | None
) -> None:
    assert left_s(done, total, spent_s) == rest_s
    assert progress_text(None) == "compiling for this machine, once"
    assert progress_text(41.3) == "compiling: 40 s left"
    assert progress_text(0.2) == "compiling: 5 s left"


def test_work_between_two_kernels_does_not_count() -> None:
    clock = ManualClock()
    compiling = Compiling(lambda: clock.time_ns / 1e9)
    kernels = [lambda: 1, lambda: 2, lambda: 3, lambda: 4]
    for each in kernels:
        compiling.expect(each)

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
