"""Work in the background: progress, an end, and one job at a time."""

from __future__ import annotations

import threading

import pytest

from e3pose.base.errors import InputError
from e3pose.site.setup.jobs import Job, Jobs

WAIT_S = 30.0


def test_a_job_tells_how_far_it_is_and_ends() -> None:
    jobs, go, told = Jobs(), threading.Event(), threading.Event()

    def work(job: Job) -> None:
        job.progress("counting", 3, 10)
        job.say("three of ten")
        told.set()
        assert go.wait(WAIT_S)

    jobs.start(Job("count", "Counting", "e3pose count"), work)
    assert told.wait(WAIT_S) and jobs.newest is not None
    shown = jobs.newest.body()
    assert (shown["state"], shown["stage"], shown["done"], shown["total"]) == (
        "running", "counting", 3, 10,
    )  # fmt: skip
    with pytest.raises(InputError, match="Counting is at work: wait until it is done, or stop it"):
        jobs.start(Job("other", "Other"), lambda job: None)
    go.set()
    jobs.wait(WAIT_S)
    assert jobs.newest.state == "done" and jobs.newest.lines == ["three of ten"] and not jobs.busy


def test_a_job_that_is_stopped_ends_at_its_next_step() -> None:
    jobs, begun = Jobs(), threading.Event()

    def work(job: Job) -> None:
        begun.set()
        for number in range(10**9):
            job.progress("for ever", number, None)

    jobs.start(Job("long", "Long work"), work)
    assert begun.wait(WAIT_S)
    jobs.close()
    assert jobs.newest is not None and jobs.newest.state == "stopped" and not jobs.newest.problem


def test_an_error_is_the_sentence_of_the_command_line() -> None:
    jobs = Jobs()

    def work(job: Job) -> None:
        raise InputError("height", "3 cm", "50 to 250 cm")

    jobs.start(Job("solve", "Finding the cameras"), work)
    jobs.wait(WAIT_S)
    failed = jobs.newest
    assert failed is not None and failed.state == "failed"
    assert failed.problem == "height: found 3 cm, expected 50 to 250 cm"
    jobs.start(Job("solve", "Finding the cameras"), lambda job: None)
    jobs.wait(WAIT_S)
    assert jobs.newest is not failed and jobs.newest is not None and jobs.newest.state == "done"
