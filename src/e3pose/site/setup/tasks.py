"""Long work in the background, with progress; it continues without an open page."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from e3pose.base.errors import InputError
from e3pose.base.installing import not_installed
from e3pose.base.masking import masked

State = Literal["running", "done", "failed", "stopped"]
END_S = 20.0  # for a task to notice that it is to stop
MAX_LINES = 40


class Stopped(Exception):
    """Ends a task that was stopped."""


@dataclass(eq=False)
class Task:
    """One piece of work, by its page and on its own thread; its methods may be called on both.

    Attributes:
        kind: what it is, for the page.
        title: in words.
        command: the command line that does the same.
        state: how far it is.
        stage: what it does at present, in words.
        done: steps of that stage that are done.
        total: how many it has; 0 where nobody knows.
        lines: what it said.
        problem: why it failed, the sentence that the command line prints.
        begun_s: when it began, by a clock that only goes forward.
        ended_s: when it ended; None before.
        shown: what it shows while it runs, for the page.
    """

    kind: str
    title: str
    command: str = ""
    state: State = "running"
    stage: str = ""
    done: int = 0
    total: int = 0
    lines: list[str] = field(default_factory=list)
    problem: str = ""
    begun_s: float = field(default_factory=time.monotonic)
    ended_s: float | None = None
    shown: dict[str, Any] = field(default_factory=dict)
    stopping: threading.Event = field(default_factory=threading.Event)

    def progress(self, stage: str, done: int, total: int | None) -> None:
        """Note the progress of a stage; end the work if it was stopped."""
        if self.stopping.is_set():
            raise Stopped
        self.stage, self.done, self.total = stage, done, total or 0

    def say(self, line: str) -> None:
        """Note a line for people."""
        self.lines = [*self.lines, masked(line)][-MAX_LINES:]

    def body(self) -> dict[str, Any]:
        """Return it for the page."""
        end_s = time.monotonic() if self.ended_s is None else self.ended_s
        return {
            "kind": self.kind, "title": self.title, "command": self.command, "state": self.state,
            "stage": self.stage, "done": self.done, "total": self.total, "lines": self.lines,
            "problem": masked(self.problem), "since_s": round(end_s - self.begun_s, 1),
            "shown": self.shown, "stopping": self.stopping.is_set(),
        }  # fmt: skip


def interrupted(kind: str, title: str) -> Task:
    """Return the task that was at work when `e3pose setup` ended."""
    task = Task(kind, title, state="failed", problem="interrupted: e3pose setup ended meanwhile; "
              "start it again")  # fmt: skip
    task.ended_s = task.begun_s
    return task


class Tasks:
    """The work of a page: one task at a time, as each takes the cameras or the whole machine."""

    def __init__(self) -> None:
        """Begin with nothing to do."""
        self.newest: Task | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    @property
    def busy(self) -> bool:
        """Whether a task is at work."""
        return self.newest is not None and self.newest.state == "running"

    def start(self, task: Task, work: Callable[[Task], object]) -> Task:
        """Begin a task on a thread of its own.

        Args:
            task: which.
            work: does it; an error of it is the task's.

        Raises:
            InputError: while another is at work.
        """
        with self._lock:
            self.check_free()
            self.newest = task
            self._thread = threading.Thread(
                target=self._run, args=(task, work), name=f"setup-{task.kind}", daemon=True
            )
            self._thread.start()
        return task

    def check_free(self) -> None:
        """Raise `InputError` while a task is at work."""
        if self.busy:
            assert self.newest is not None
            raise InputError(f"{self.newest.title} is at work: wait until it is done, or stop it")

    def stop(self) -> None:
        """Ask the task at work to end."""
        if self.newest is not None:
            self.newest.stopping.set()

    def close(self) -> None:
        """Stop the task at work, and wait for it."""
        self.stop()
        if self._thread is not None:
            self._thread.join(END_S)

    def wait(self, timeout_s: float) -> None:
        """Wait until the task at work has ended."""
        if self._thread is not None:
            self._thread.join(timeout_s)

    def _run(self, task: Task, work: Callable[[Task], object]) -> None:
        end: State = "failed"
        try:
            work(task)
            end = "done"
        except Stopped:
            end = "stopped"
        except (InputError, OSError) as error:
            task.problem = str(error)
        except MemoryError:
            task.problem = "out of memory, expected a smaller or shorter input"
        except ModuleNotFoundError as error:
            task.problem = not_installed(error.name, "all")
        except Exception as error:  # a fault of ours: the page says so instead of waiting for ever
            task.problem = f"internal error: {type(error).__name__}: {error}"
            raise
        finally:
            task.ended_s = time.monotonic()
            task.state = end
