"""Work in the background: progress, an end, and one task at a time."""

from __future__ import annotations

import threading

import pytest

from e3pose.base.errors import InputError
from e3pose.site.setup.tasks import Task, Tasks

WAIT_S = 30.0


def test_a_job_tells_how_far_it_is_and_ends() -> None:
    tasks, go, told = Tasks(), threading.Event(), threading.Event()

    def work(task: Task) -> None:
        task.progress("counting", 3, 10)
        task.say("three of ten")
        told.set()
        assert go.wait(WAIT_S)

    tasks.start(Task("count", "Counting", "e3pose count"), work)
    assert told.wait(WAIT_S) and tasks.newest is not None
    shown = tasks.newest.body()
    assert (shown["state"], shown["stage"], shown["done"], shown["total"]) == (
        "running", "counting", 3, 10,
    )  # fmt: skip
    with pytest.raises(InputError, match="Counting is at work: wait until it is done, or stop it"):
        tasks.start(Task("other", "Other"), lambda task: None)
    go.set()
    tasks.wait(WAIT_S)
    assert (
        tasks.newest.state == "done" and tasks.newest.lines == ["three of ten"] and not tasks.busy
    )


def test_a_job_that_is_stopped_ends_at_its_next_step() -> None:
    tasks, begun = Tasks(), threading.Event()

    def work(task: Task) -> None:
        begun.set()
        for number in range(10**9):
            task.progress("for ever", number, None)

    tasks.start(Task("long", "Long work"), work)
    assert begun.wait(WAIT_S)
    tasks.close()
    assert tasks.newest is not None and tasks.newest.state == "stopped" and not tasks.newest.problem


def test_an_error_is_the_sentence_of_the_command_line() -> None:
    tasks = Tasks()

    def work(task: Task) -> None:
        raise InputError("height", "3 cm", "50 to 250 cm")

    tasks.start(Task("solve", "Finding the cameras"), work)
    tasks.wait(WAIT_S)
    failed = tasks.newest
    assert failed is not None and failed.state == "failed"
    assert failed.problem == "height: found 3 cm, expected 50 to 250 cm"
    tasks.start(Task("solve", "Finding the cameras"), lambda task: None)
    tasks.wait(WAIT_S)
    assert tasks.newest is not failed and tasks.newest is not None and tasks.newest.state == "done"
