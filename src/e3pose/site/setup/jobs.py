"""Long work in the background, with progress: it goes on while nobody looks at the page."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from e3pose.base.errors import InputError

State = Literal["running", "done", "failed", "stopped"]
END_S = 20.0  # for a job to notice that it is to stop
MAX_LINES = 40


class Stopped(Exception):
    """Ends a job that somebody stopped."""


@dataclass(eq=False)
class Job:
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
        """Note how far a stage is; end the work if somebody stopped it."""
        if self.stopping.is_set():
            raise Stopped
        self.stage, self.done, self.total = stage, done, total or 0

    def say(self, line: str) -> None:
        """Note a line for people."""
        self.lines = [*self.lines, line][-MAX_LINES:]

    def body(self) -> dict[str, Any]:
        """Return it for the page."""
        end_s = time.monotonic() if self.ended_s is None else self.ended_s
        return {
            "kind": self.kind, "title": self.title, "command": self.command, "state": self.state,
            "stage": self.stage, "done": self.done, "total": self.total, "lines": self.lines,
            "problem": self.problem, "since_s": round(end_s - self.begun_s, 1),
            "shown": self.shown, "stopping": self.stopping.is_set(),
        }  # fmt: skip


def interrupted(kind: str, title: str) -> Job:
    """Return the job that was at work when `e3pose setup` ended."""
    job = Job(kind, title, state="failed", problem="interrupted: e3pose setup ended meanwhile; "
              "start it again")  # fmt: skip
    job.ended_s = job.begun_s
    return job


class Jobs:
    """The work of a page: one job at a time, as each takes the cameras or the whole machine."""

    def __init__(self) -> None:
        """Begin with nothing to do."""
        self.newest: Job | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    @property
    def busy(self) -> bool:
        """Whether a job is at work."""
        return self.newest is not None and self.newest.state == "running"

    def start(self, job: Job, work: Callable[[Job], object]) -> Job:
        """Begin a job on a thread of its own.

        Args:
            job: which.
            work: does it; an error of it is the job's.

        Raises:
            InputError: while another is at work.
        """
        with self._lock:
            self.check_free()
            self.newest = job
            self._thread = threading.Thread(
                target=self._run, args=(job, work), name=f"setup-{job.kind}", daemon=True
            )
            self._thread.start()
        return job

    def check_free(self) -> None:
        """Raise `InputError` while a job is at work."""
        if self.busy:
            assert self.newest is not None
            raise InputError(f"{self.newest.title} is at work: wait until it is done, or stop it")

    def stop(self) -> None:
        """Ask the job at work to end."""
        if self.newest is not None:
            self.newest.stopping.set()

    def close(self) -> None:
        """Stop the job at work, and wait for it."""
        self.stop()
        if self._thread is not None:
            self._thread.join(END_S)

    def wait(self, timeout_s: float) -> None:
        """Wait until the job at work has ended."""
        if self._thread is not None:
            self._thread.join(timeout_s)

    def _run(self, job: Job, work: Callable[[Job], object]) -> None:
        end: State = "failed"
        try:
            work(job)
            end = "done"
        except Stopped:
            end = "stopped"
        except (InputError, OSError) as error:
            job.problem = str(error)
        except MemoryError:
            job.problem = "out of memory, expected a smaller or shorter input"
        except ModuleNotFoundError as error:
            job.problem = f"{error.name} is not installed: pip install 'e3pose[all]'"
        except Exception as error:  # a fault of ours: the page says so instead of waiting for ever
            job.problem = f"internal error: {type(error).__name__}: {error}"
            raise
        finally:
            job.ended_s = time.monotonic()
            job.state = end
