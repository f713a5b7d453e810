"""Workers: the same results in the same order, whoever works."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from tests.waiting import settled

from e3pose.errors import InputError
from e3pose.workers import ROUND, Workers


def draw(shift: float, seed: int) -> tuple[float, int]:
    return shift + np.random.default_rng(seed).random(), os.getpid()


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_come_in_order(jobs: int) -> None:
    results = list(Workers(jobs).run(draw, 5.0, range(8)))
    assert [value for value, _ in results] == [draw(5.0, seed)[0] for seed in range(8)]
    assert (os.getpid() in {process for _, process in results}) == (jobs == 1)


def test_who_stops_early_leaves_no_mess() -> None:
    results = Workers(2).run(draw, 0.0, range(1000))
    assert next(results)[0] == draw(0.0, 0)[0]
    results.close()  # type: ignore[attr-defined]


def make_file(folder: Path, task: int) -> int:
    (folder / f"{task}").touch()
    return task


def test_no_more_is_made_than_is_soon_used(tmp_path: Path) -> None:
    results = Workers(2).run(make_file, tmp_path, range(1000))
    assert [next(results) for _ in range(20)] == list(range(20))
    assert settled(lambda: len(list(tmp_path.iterdir()))) <= 20 + 2 * ROUND * 2
    results.close()  # type: ignore[attr-defined]


def fall(shared: None, task: int) -> int:
    if task == 5:
        raise InputError("5: found nothing")
    return task


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_reaches_who_takes_the_results(jobs: int) -> None:
    results = Workers(jobs).run(fall, None, range(1000))
    with pytest.raises(InputError, match="5: found nothing"):
        list(results)


@pytest.mark.parametrize("jobs", [0, -2, 100_000])
def test_impossible_numbers_of_processes_are_refused(jobs: int) -> None:
    with pytest.raises(InputError, match="jobs: found"):
        Workers(jobs)


def test_a_dask_cluster_gives_the_same() -> None:
    pytest.importorskip(
        "distributed", reason="distributed is not installed: pip install e3pose[train]"
    )
    results = [value for value, _ in Workers(2, "local").run(draw, 5.0, range(8))]
    assert results == [draw(5.0, seed)[0] for seed in range(8)]


def test_a_scheduler_that_is_none_is_named() -> None:
    pytest.importorskip(
        "distributed", reason="distributed is not installed: pip install e3pose[train]"
    )
    with pytest.raises(InputError, match="--dask: found 'nonsense'"):
        list(Workers(2, "nonsense").run(draw, 0.0, range(2)))
