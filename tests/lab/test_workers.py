"""Workers: the same results in the same order, whoever works."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.waiting import settled

from e3pose.base.errors import InputError
from e3pose_lab.workers import ROUND, Workers

pytestmark = pytest.mark.slow


def distributed_here() -> Any:
    reason = "distributed is not installed: pip install e3pose[lab]"
    return pytest.importorskip("distributed", reason=reason)


def draw(shift: float, seed: int) -> tuple[float, int]:
    return shift + np.random.default_rng(seed).random(), os.getpid()


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_come_in_order(jobs: int) -> None:
    results = list(Workers(jobs).run(draw, 5.0, range(8)))
    assert [value for value, _ in results] == [draw(5.0, seed)[0] for seed in range(8)]
    assert (os.getpid() in {process for _, process in results}) == (jobs == 1)


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


@pytest.fixture(scope="module")
def one_worker() -> Iterator[str]:
    """A cluster of one worker, which is another process; yields the address of its scheduler."""
    distributed = distributed_here()
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    ) as cluster:
        yield cluster.scheduler_address


def test_a_cluster_of_one_worker_works_and_not_this_process(one_worker: str) -> None:
    alone = Workers(1, one_worker)
    found = list(alone.run(draw, 5.0, range(4)))
    assert [value for value, _ in found] == [draw(5.0, seed)[0] for seed in range(4)]
    ready = dict(alone.as_ready(draw, 5.0, range(4)))
    assert [ready[place][0] for place in range(4)] == [value for value, _ in found]
    assert os.getpid() not in {pid for _, pid in (*found, *ready.values())}


@pytest.mark.parametrize("ready", [False, True])
def test_an_error_on_a_cluster_reaches_who_takes_the_results(ready: bool, one_worker: str) -> None:
    workers = Workers(1, one_worker)
    with pytest.raises(InputError, match="5: found nothing"):
        list((workers.as_ready if ready else workers.run)(fall, None, range(20)))


def test_a_cluster_without_a_worker_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = distributed_here()
    monkeypatch.setattr("e3pose_lab.workers.WAIT_S", 2.0)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as cluster,
        pytest.raises(InputError, match="--dask: found no worker of tcp"),
    ):
        list(Workers(1, cluster.scheduler_address).run(draw, 0.0, range(2)))
    with pytest.raises(InputError, match="--dask: found 'nonsense'"):
        list(Workers(2, "nonsense").run(draw, 0.0, range(2)))
