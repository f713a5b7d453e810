"""Results are kept, found again, and made anew when they are broken or something changed."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from e3pose_lab.reproduce import work
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
