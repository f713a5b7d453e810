"""When a compiled kernel on disk may be used again, and what declaring one costs."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.caching import FunctionCache
from tests.cases import each_case

from e3pose.base import kernel_cache
from e3pose.base.kernel import kernel
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


def test_no_kernel_is_stamped_with_what_it_does_not_import() -> None:
    sources = {path.name for path in sources_of(Path(bias.__file__).resolve())}
    assert "foresight.py" not in sources and "step.py" not in sources


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
