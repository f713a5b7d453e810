"""Work in many processes of this machine, or on a Dask cluster, with the same results either way.

Nothing here decides anything: a task carries its own seed, so that it does not matter who runs it.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from e3pose.base.errors import InputError, reason_of

Shared = TypeVar("Shared")
Task = TypeVar("Task")
Result = TypeVar("Result")

LOCAL = "local"
MAX_JOBS = 1000
ROUND = 4  # tasks of each process in one go
WAIT_S = 30.0  # for a cluster to answer


@dataclass(frozen=True, slots=True)
class Workers:
    """Processes or a Dask cluster that do the work.

    Attributes:
        jobs: processes; 1 works here, -1 uses every processor core.
        dask: the address of a Dask scheduler such as `tcp://host:8786`, or `local` for a cluster
            of its own on this machine; plain processes if None.
        option: what the address is called on the command line, for errors.

    Raises:
        InputError: for a number of processes that cannot be.
    """

    jobs: int = 1
    dask: str | None = None
    option: str = "--dask"

    def __post_init__(self) -> None:
        if self.jobs != -1 and not 1 <= self.jobs <= MAX_JOBS:
            raise InputError(
                f"--jobs: found {self.jobs}, expected 1 to {MAX_JOBS}, or -1 for all cores"
            )

    @property
    def processes(self) -> int:
        """How many share the work on this machine."""
        return (os.cpu_count() or 1) if self.jobs == -1 else self.jobs

    def run(
        self, function: Callable[[Shared, Task], Result], shared: Shared, tasks: Sequence[Task]
    ) -> Iterator[Result]:
        """Yield `function(shared, task)` of every task, in their order, as they become ready.

        Args:
            function: of a module, so that another process finds it.
            shared: what all tasks need; it travels to every worker once.
            tasks: work, with seeds where there is chance in it.

        Raises:
            InputError: when the Dask scheduler does not answer.
        """
        if self.dask is None and (self.jobs == 1 or len(tasks) < 2):
            for task in tasks:
                yield function(shared, task)
            return
        if self.dask is not None:
            with self._cluster(shared) as (client, near):
                yield from _in_order(client, function, near, tasks)
            return
        from joblib import Parallel, delayed, effective_n_jobs

        # The generators of joblib know no limit: they fill the memory if their results are used
        # more slowly than they are made. So a thread makes one round while another is used.
        with self._processes(), Parallel(batch_size=1) as run, ThreadPoolExecutor(1) as maker:
            size = ROUND * effective_n_jobs(None)
            rounds = (tasks[start : start + size] for start in range(0, len(tasks), size))
            made: Future[Any] | None = None
            for some in rounds:
                last, made = made, maker.submit(run, [delayed(function)(shared, t) for t in some])
                yield from last.result() if last else ()
            yield from made.result() if made else ()

    def as_ready(
        self, function: Callable[[Shared, Task], Result], shared: Shared, tasks: Sequence[Task]
    ) -> Iterator[tuple[int, Result]]:
        """Yield the place of a task with its result, of every task, whichever is ready first.

        Args:
            function: of a module, so that another process finds it.
            shared: what all tasks need.
            tasks: work whose results are small: they wait in memory until they are taken.

        Raises:
            InputError: when the Dask scheduler does not answer.
        """
        if self.dask is None and (self.jobs == 1 or len(tasks) < 2):
            for place, task in enumerate(tasks):
                yield place, function(shared, task)
            return
        if self.dask is not None:
            with self._cluster(shared) as (client, near):
                yield from _as_ready(client, function, near, tasks)
            return
        from joblib import Parallel, delayed

        with self._processes():
            yield from Parallel(batch_size=1, return_as="generator_unordered")(
                delayed(_placed)(function, shared, place, task) for place, task in enumerate(tasks)
            )

    @contextmanager
    def _processes(self) -> Iterator[None]:
        from joblib import parallel_config

        # Tasks are many and small: one thread each, or the processes fight for the cores.
        with parallel_config(backend="loky", n_jobs=self.jobs, inner_max_num_threads=1):
            yield

    @contextmanager
    def _cluster(self, shared: Any) -> Iterator[tuple[Any, Any]]:
        """Yield a client of the cluster, and what all tasks need, on its workers."""
        assert self.dask is not None
        with _client(self.dask, self.jobs, self.option) as client:
            (near,) = client.scatter([shared], broadcast=True, hash=False)
            yield client, near


def _in_order(
    client: Any, function: Callable[[Shared, Task], Result], near: Any, tasks: Sequence[Task]
) -> Iterator[Result]:
    """Yield results in the order of the tasks, of which only some are under way at a time."""
    ahead = 2 * ROUND * max(1, sum(client.ncores().values()))
    waiting: deque[Any] = deque()
    for task in tasks:
        waiting.append(client.submit(function, near, task, pure=False))
        if len(waiting) > ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def _as_ready(
    client: Any, function: Callable[[Shared, Task], Result], near: Any, tasks: Sequence[Task]
) -> Iterator[tuple[int, Result]]:
    from distributed import as_completed

    futures = [client.submit(function, near, task, pure=False) for task in tasks]
    places = {future.key: place for place, future in enumerate(futures)}
    for future in as_completed(futures):
        yield places[future.key], future.result()


def _placed(
    function: Callable[[Shared, Task], Result], shared: Shared, place: int, task: Task
) -> tuple[int, Result]:
    return place, function(shared, task)


@contextmanager
def _client(address: str, jobs: int, option: str) -> Iterator[Any]:
    """Connect to a Dask scheduler, or start one with workers on this machine."""
    from distributed import Client, LocalCluster

    if address == LOCAL:
        with (
            LocalCluster(
                n_workers=None if jobs == -1 else jobs,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",  # any free port: 8787 may be taken
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client
        return
    try:
        client = Client(address, timeout=WAIT_S)
    except (OSError, ValueError, TypeError) as error:
        reason = reason_of(error)[:200]
        raise InputError(
            f"{option}: found {address[:100]!r} ({reason}), expected {LOCAL} or the address of a "
            "Dask scheduler such as tcp://host:8786"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, WAIT_S)
        except Exception:  # of a kind that is not `TimeoutError` before Python 3.11
            raise InputError(option, f"no worker of {address[:100]}", "at least one") from None
        yield client
