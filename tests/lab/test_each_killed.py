"""`e3pose each` on a Dask cluster of real processes, of which some are killed."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import psutil
import pytest
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.recording import save_recording
from e3pose.simulate import DetectorSettings, SceneSettings, simulate

pytestmark = [pytest.mark.slow, pytest.mark.nightly]

COUNT = 6
VERB = "replay --policy round-robin --cameras 1"
END_S = 240.0


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("recordings")
    scene = SceneSettings(
        people=1, seconds=1.0, fps=10, cameras=2, detector=DetectorSettings(perfect=True)
    )
    for seed in range(COUNT):
        save_recording(simulate(scene, seed), folder / f"walk{seed}")
    return sorted(folder.iterdir())


@contextmanager
def program(folder: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program of Dask, and all that it starts, until the block ends."""
    with (folder / "dask.log").open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", *words], stdout=log, stderr=log, cwd=folder
        )
    try:
        yield process
    finally:
        kill(process)


def kill(process: subprocess.Popen[bytes]) -> list[psutil.Process]:
    """Kill a process, and no child of it; return those."""
    children = (
        psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
    )
    process.kill()
    process.wait()
    return children


@contextmanager
def cluster(
    folder: Path, port: int, workers: int
) -> Iterator[tuple[subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """Yield a scheduler and its workers."""
    head = ("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port))
    one = ("distributed.cli.dask_worker", f"tcp://127.0.0.1:{port}", "--no-nanny", "--nthreads")
    with program(folder, *head, "--no-dashboard") as scheduler, ExitStack() as stack:
        made = (program(folder, *one, "1", "--no-dashboard") for _ in range(workers))
        yield scheduler, [stack.enter_context(each) for each in made]


@contextmanager
def each(dest: Path, recordings: list[Path], port: int) -> Iterator[subprocess.Popen[str]]:
    """Run the verb until the block ends."""
    words = [sys.executable, "-m", "e3pose", "each", str(dest), *map(str, recordings)]
    words += ["--verb", VERB, "--cluster", f"tcp://127.0.0.1:{port}"]
    pipe = subprocess.PIPE
    command = subprocess.Popen(words, stdout=pipe, stderr=pipe, text=True)
    try:
        yield command
    finally:
        command.kill()


def results(dest: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in dest.glob("*.parquet")}


def test_killed_worker_loses_no_result_and_leaves_nothing_at_work(
    recordings: list[Path], tmp_path: Path
) -> None:
    dest, port = tmp_path / "results", free_port()
    with cluster(tmp_path, port, 2) as (_, workers), each(dest, recordings, port) as command:
        assert eventually(lambda: results(dest), END_S), (tmp_path / "dask.log").read_text()
        children = kill(workers[0])
        out, err = command.communicate(timeout=END_S)
    assert command.returncode == 0, err
    assert f"{COUNT} results, 0 failed" in out and len(results(dest)) == COUNT
    assert eventually(lambda: not any(child.is_running() for child in children))


def test_killed_scheduler_is_told_and_the_same_command_goes_on(
    recordings: list[Path], tmp_path: Path
) -> None:
    dest, port = tmp_path / "results", free_port()
    with cluster(tmp_path, port, 1) as (scheduler, _), each(dest, recordings, port) as command:
        assert eventually(lambda: results(dest), END_S), (tmp_path / "dask.log").read_text()
        kill(scheduler)
        _, err = command.communicate(timeout=END_S)
    assert command.returncode == 2 and "the same command goes on" in err, err
    before = results(dest)
    assert 0 < len(before) < COUNT
    port = free_port()
    with cluster(tmp_path, port, 2), each(dest, recordings, port) as command:
        out, err = command.communicate(timeout=END_S)
    assert command.returncode == 0, err
    assert f"done: {len(before)}" in out
    after = results(dest)
    assert len(after) == COUNT and before.items() <= after.items()
