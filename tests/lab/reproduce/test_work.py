"""Results are kept, found again, and made anew when they are broken or something changed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from tests.ports import free_port

from e3pose_lab.reproduce import work
from e3pose_lab.reproduce.replays import Asked, over_seeds
from e3pose_lab.reproduce.sources import Sources
from e3pose_lab.reproduce.work import Made, Piece, Results, lacking, run
from e3pose_lab.workers import Workers


@dataclass(frozen=True, slots=True)
class Question:
    number: int


@dataclass(frozen=True, slots=True)
class Answer:
    square: int
    process: int


def answer(sources: Sources, question: Question) -> Answer:
    return Answer(question.number**2, os.getpid())


def pieces(count: int) -> list[Piece[Question, Answer]]:
    return [Piece(answer, Question(number)) for number in range(count)]


def answers(results: Results, count: int, workers: Workers) -> dict[int, Answer]:
    made = Made(results)
    for piece, result in run(results, lacking(made, pieces(count)), workers):
        made.add(piece, result)
    return {piece.settings.number: made(piece) for piece in pieces(count)}


def test_a_result_is_kept_and_found_again(tmp_path: Path) -> None:
    results = Results(tmp_path, Sources())
    first = answers(results, 3, Workers(1))
    files = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert answers(results, 3, Workers(1)) == first == answers(results, 3, Workers(2))
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == files


@pytest.mark.parametrize(
    "damage", [b"", b"{", b'{"format":"e3pose-reproduced"}', b"\xff\xff"], ids=repr
)
def test_a_broken_result_is_made_anew(tmp_path: Path, damage: bytes) -> None:
    results = Results(tmp_path, Sources())
    answers(results, 2, Workers(1))
    broken = results.path(pieces(2)[1])
    whole = broken.read_bytes()
    broken.write_bytes(damage)
    assert answers(results, 2, Workers(1))[1].square == 1
    assert broken.read_bytes() == whole


def test_a_changed_figure_is_noticed(tmp_path: Path) -> None:
    results = Results(tmp_path, Sources())
    answers(results, 3, Workers(1))
    path = results.path(pieces(3)[2])
    path.write_bytes(path.read_bytes().replace(b'"square":4', b'"square":5'))
    assert answers(results, 3, Workers(1))[2].square == 4


def test_other_settings_and_other_data_are_kept_apart(tmp_path: Path) -> None:
    results = Results(tmp_path, Sources())
    other = Results(tmp_path, replace(Sources(), stamp="other"))
    one, two = pieces(2)
    assert len({results.path(one), results.path(two), other.path(one)}) == 3
    assert results.path(one) == results.path(Piece(answer, Question(0)))


def test_the_same_piece_is_done_once(tmp_path: Path) -> None:
    made = Made(Results(tmp_path, Sources()))
    assert len(lacking(made, [*pieces(3), *pieces(2)])) == 3


def test_work_that_is_timed_stays_in_this_process(tmp_path: Path) -> None:
    results = Results(tmp_path, Sources())
    mixed = [*pieces(3), replace(Piece(answer, Question(7)), times=True)]
    found = {piece.settings.number: result for piece, result in run(results, mixed, Workers(2))}
    assert found[7].process == os.getpid()
    assert os.getpid() not in {found[number].process for number in range(3)}


def test_results_depend_on_what_computes_and_not_on_what_shows() -> None:
    assert work._counts(("e3pose_lab", "reproduce", "simulated.py"))
    assert work._counts(("e3pose", "pipeline.py"))
    assert work._counts(("e3pose", "predict", "weights", "attention-lstm.onnx"))
    assert not work._counts(("e3pose_lab", "reproduce", "page.py"))
    assert not work._counts(("e3pose_lab", "reproduce", "items", "shelf_table.py"))
    assert not work._counts(("e3pose_lab", "cli", "reproducing.py"))


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Run a Dask scheduler and two workers, all processes of their own; yields its address."""
    distributed = pytest.importorskip(
        "distributed", reason="distributed is not installed: pip install e3pose[lab]"
    )
    address = f"tcp://127.0.0.1:{free_port()}"
    python = [sys.executable, "-m"]
    worker = [
        *python, "distributed.cli.dask_worker", address, "--nthreads=1", "--no-nanny",
        "--no-dashboard", f"--local-directory={tmp_path_factory.mktemp('workers')}",
    ]  # fmt: skip
    commands = [
        [*python, "distributed.cli.dask_scheduler", "--no-dashboard", f"--host={address}"],
        worker,
        worker,
    ]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, os.getcwd()])}
    started = [
        subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for command in commands
    ]
    try:
        with distributed.Client(address, timeout=120) as client:
            client.wait_for_workers(2, timeout=120)
        yield address
    finally:
        end(started)


def end(started: list[subprocess.Popen[bytes]]) -> None:
    """End processes at once."""
    for process in started:
        process.kill()  # a worker that is asked to end may wait for its scheduler for ever
    for process in started:
        process.wait()


@pytest.mark.slow
@pytest.mark.nightly  # tests/lab/test_workers.py has a cluster by day
def test_a_scheduler_and_two_workers_give_the_same(tmp_path: Path, scheduler: str) -> None:
    asked = Asked("ring", "e3pose", seconds=2.0, fps=12.5)
    wanted = over_seeds(asked, 3)

    def files(name: str, workers: Workers) -> dict[str, bytes]:
        results = Results(tmp_path / name, Sources())
        assert len(list(run(results, wanted, workers))) == len(wanted)
        return {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()}

    here = files("here", Workers(1))
    assert here == files("there", Workers(1, scheduler))
    assert len(here) == len(wanted)


@pytest.mark.slow
@pytest.mark.nightly  # tests/lab/test_workers.py has a cluster by day
def test_workers_of_a_scheduler_do_the_work(tmp_path: Path, scheduler: str) -> None:
    found = answers(Results(tmp_path / "kept", Sources()), 6, Workers(1, scheduler))
    assert [found[number].square for number in range(6)] == [n**2 for n in range(6)]
    assert os.getpid() not in {each.process for each in found.values()}


def sometimes(sources: Sources, question: Question) -> Answer:
    if question.number == 1:
        raise ValueError("no room\n  left")
    return answer(sources, question)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_piece_that_fails_costs_no_other_and_is_tried_again(tmp_path: Path, jobs: int) -> None:
    results = Results(tmp_path, Sources())
    asked = [Piece(sometimes, Question(number)) for number in range(3)]
    made = Made(results)
    for piece, result in run(results, asked, Workers(jobs)):
        made.add(piece, result)
    assert made(asked[0]).square == 0 and made(asked[2]).square == 4
    assert made.failure(asked) == "test_work-sometimes: ValueError: no room left"
    assert not made.failure([asked[0], asked[2]])
    assert len(list(tmp_path.iterdir())) == 2
