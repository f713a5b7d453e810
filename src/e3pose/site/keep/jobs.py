"""Jobs that make files of a store: one at a time, in a folder of bounded size, for a stated time.

A job is a folder with its files and `job.json`, so that whoever loads the page again, or starts the
program again, finds it as it is. What was being made when a program ended is said to be cut off.
"""

from __future__ import annotations

import json
import re
import secrets
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from e3pose.base.atomic import write_file
from e3pose.base.bounded import bytes_of, read_bytes
from e3pose.base.errors import InputError
from e3pose.base.lock import hold
from e3pose.base.private import make_folder
from e3pose.site.keep.request import ExportRequest

KEPT_S = 86_400.0  # files are removed a day after they were made
MOST_BYTES = 2 * 10**9  # of all files together
MOST_JOBS = 50
MOST_WAITING = 10
LEAST_FREE = 300_000_000  # bytes that a disk keeps, for the store
LOOK_S = 0.5  # between two looks at the size of what is being made
FILES = "view-files"  # folder beside the site file, of what the page made
NUMBER = re.compile(r"[0-9a-f]{16}")
JOB = "job.json"
MAX_JOB_BYTES = 65_536
CUT_OFF = "cut off: the program that made it was ended or restarted"
State = Literal["waiting", "working", "done", "failed"]


@dataclass(frozen=True, slots=True)
class Job:
    """One request and its state.

    Attributes:
        number: random, hexadecimal.
        request: what is wanted.
        made_s: when it was asked for, seconds since 1970.
        state: how far it is.
        share: how much is done, [0, 1]; None if unknown.
        doing: what is being done, or a note about what was made, or why not.
        files: names and bytes of what was made.
    """

    number: str
    request: ExportRequest
    made_s: float
    state: State = "waiting"
    share: float | None = None
    doing: str = ""
    files: tuple[tuple[str, int], ...] = ()

    def body(self) -> dict[str, Any]:
        """Return it as the API has it."""
        files = [{"name": name, "bytes": size} for name, size in self.files]
        return {**asdict(self), "files": files, "until_s": self.made_s + KEPT_S}


class Jobs:
    """The jobs of a site. Its methods may be called on any thread."""

    def __init__(
        self,
        folder: Path,
        site_file: Path,
        log: Callable[[str], object] = lambda line: None,
        now_s: Callable[[], float] = time.time,
    ) -> None:
        """Find the jobs of earlier programs.

        Args:
            folder: of all jobs; made with the first.
            site_file: of the site whose store it is.
            log: called with lines for operators.
            now_s: seconds since 1970.
        """
        self.folder, self.site_file, self._log, self._now_s = folder, site_file, log, now_s
        self._lock, self._stack = threading.Lock(), ExitStack()
        self._jobs: dict[str, Job] = {}
        self._wake, self._stop = threading.Event(), threading.Event()
        self._thread: threading.Thread | None = None
        self._child: tuple[str, subprocess.Popen[str]] | None = None
        self.why = ""  # there are none, although there may be
        if folder.is_dir():
            try:
                self._begin()
            except InputError as error:  # another program of the site has them
                self.why = str(error)

    def all(self) -> list[Job]:
        """Return the jobs, newest first."""
        self._sweep()
        with self._lock:
            return sorted(self._jobs.values(), key=lambda job: -job.made_s)

    def add(self, request: ExportRequest) -> Job:
        """Queue a request.

        Raises:
            InputError: when there are too many, no room, or another program makes files here.
        """
        self._sweep()
        self._begin()
        with self._lock:
            waiting = sum(job.state in ("waiting", "working") for job in self._jobs.values())
            if waiting >= MOST_WAITING or len(self._jobs) >= MOST_JOBS:
                raise InputError("jobs", f"{len(self._jobs)}, {waiting} of them to be made",
                                 "fewer: remove some, or wait")  # fmt: skip
            if why := self._full():
                raise InputError(why)
            job = Job(secrets.token_hex(8), request, self._now_s())
            try:
                make_folder(self.folder / job.number)
                self._keep(job)
            except (OSError, InputError) as error:
                self._jobs.pop(job.number, None)
                shutil.rmtree(self.folder / job.number, ignore_errors=True)
                raise InputError(f"the files cannot be made: {_reason(error)}") from None
        self._wake.set()
        return job

    def remove(self, number: str) -> None:
        """End a job and remove its files; raise `InputError` for one that is not there."""
        with self._lock:
            if self._jobs.pop(number, None) is None:
                raise InputError("job", repr(number[:40]), "one of the site")
            if self._child is not None and self._child[0] == number:
                self._child[1].kill()
            shutil.rmtree(self.folder / number, ignore_errors=True)

    def file(self, number: str, name: str) -> Path:
        """Return a file that a job made; raise `InputError` for anything else."""
        with self._lock:
            job = self._jobs.get(number)
            if job is None or name not in [made for made, _ in job.files]:
                raise InputError("file", repr(name[:80]), "one that a job made")
            return self.folder / number / name

    def close(self) -> None:
        """Stop the job in progress."""
        self._stop.set()
        self._wake.set()
        with self._lock:
            if self._child is not None:
                self._child[1].kill()
        if self._thread is not None:
            self._thread.join(10)
        self._stack.close()

    def _begin(self) -> None:
        """Hold the folder, load its jobs and start the thread, once."""
        with self._lock:
            if self._thread is not None:
                return
            try:
                make_folder(self.folder)
            except OSError as error:
                raise InputError(f"no folder for files: {_reason(error)}") from None
            self._stack.enter_context(hold(self.folder / "jobs"))
            for job in jobs_in(self.folder):
                self._jobs[job.number] = job
                if job.state in ("waiting", "working"):
                    with suppress(OSError, InputError):
                        _clear(self.folder / job.number)
                        self._keep(replace(job, state="failed", doing=CUT_OFF, share=None))
            self._thread = threading.Thread(target=self._work, name="files", daemon=True)
            self._thread.start()

    def _keep(self, job: Job) -> None:
        """Remember a job, also for the next program."""
        self._jobs[job.number] = job
        write_file(self.folder / job.number / JOB, json.dumps(asdict(job)), private=True)

    def _sweep(self) -> None:
        with self._lock:
            for job in list(self._jobs.values()):
                over = self._now_s() - job.made_s > KEPT_S and job.state in ("done", "failed")
                if over:
                    del self._jobs[job.number]
                    shutil.rmtree(self.folder / job.number, ignore_errors=True)

    def _full(self) -> str:
        """Return why no more can be made; empty if it can."""
        if bytes_of(self.folder) >= MOST_BYTES:
            return f"the files take more than {MOST_BYTES / 1e9:g} GB: remove some"
        try:
            free = shutil.disk_usage(self.folder).free
        except OSError as error:
            return f"the folder of files cannot be read: {_reason(error)}"
        if free < LEAST_FREE:
            return f"the disk has {free / 1e6:.0f} MB left, and keeps {LEAST_FREE / 1e6:.0f} MB"
        return ""

    # What follows runs in the thread.

    def _work(self) -> None:
        while not self._stop.is_set():
            with self._lock:
                waiting = [job for job in self._jobs.values() if job.state == "waiting"]
                job = min(waiting, key=lambda one: one.made_s, default=None)
                if job is not None:
                    self._jobs[job.number] = job = replace(job, state="working")
            if job is None:
                self._wake.wait()
                self._wake.clear()
                continue
            try:
                self._make(job)
            except OSError as error:
                self._end(job, "failed", _reason(error), ())

    def _make(self, job: Job) -> None:
        folder = self.folder / job.number
        program = (sys.executable, "-m", "e3pose.site.keep.program")
        full: list[str] = []
        with subprocess.Popen(
            [*program, str(folder), str(self.site_file)], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, encoding="utf-8",
        ) as child:  # fmt: skip
            with self._lock:
                self._child = job.number, child
                if job.number not in self._jobs or self._stop.is_set():  # removed meanwhile
                    child.kill()
            watching = threading.Thread(target=self._watch, args=(child, full), daemon=True)
            watching.start()
            try:
                end = self._follow(job, child)
            finally:
                child.wait()
                watching.join()
                with self._lock:
                    self._child = None
        names = [name for name in end.get("files", ()) if (folder / name).is_file()]
        if names and not full:
            files = tuple((name, (folder / name).stat().st_size) for name in names)
            self._end(job, "done", str(end.get("note", "")), files)
        else:
            ended = CUT_OFF if self._stop.is_set() else f"the program ended with {child.returncode}"
            why = (full or [str(end.get("problem", ""))])[0] or ended
            self._end(job, "failed", why, ())

    def _follow(self, job: Job, child: subprocess.Popen[str]) -> dict[str, Any]:
        """Send the request to the child and read its progress; return its last message."""
        assert child.stdin is not None and child.stdout is not None
        with suppress(BrokenPipeError):
            child.stdin.write(json.dumps(asdict(job.request)))
            child.stdin.close()
        end: dict[str, Any] = {}
        for line in child.stdout:
            try:
                said = json.loads(line)
            except ValueError:
                continue
            if "doing" not in said:
                end = said
                continue
            with self._lock:
                if job.number in self._jobs:
                    now = replace(job, state="working", share=said["share"], doing=said["doing"])
                    self._jobs[job.number] = now
        return end

    def _watch(self, child: subprocess.Popen[str], full: list[str]) -> None:
        """Stop a child whose files grow too large."""
        while child.poll() is None:
            if why := self._full():
                full.append(why)
                child.kill()
                return
            with suppress(subprocess.TimeoutExpired):
                child.wait(LOOK_S)

    def _end(self, job: Job, state: State, doing: str, files: tuple[tuple[str, int], ...]) -> None:
        folder = self.folder / job.number
        with self._lock:
            if job.number not in self._jobs:
                shutil.rmtree(folder, ignore_errors=True)
                return
            if state == "failed":
                _clear(folder)
            ended = replace(job, state=state, doing=doing[:500], files=files, share=None)
            self._jobs[job.number] = ended
            with suppress(OSError, InputError):  # the next program calls it cut off
                self._keep(ended)
        self._log(
            f"page: {job.request.file_name} {state}" + (f": {doing}" if state == "failed" else "")
        )


def jobs_in(folder: Path) -> Iterator[Job]:
    """Yield the jobs of earlier programs; other folders are left alone."""
    for path in sorted(folder.glob(f"*/{JOB}")):
        if not NUMBER.fullmatch(path.parent.name) or path.parent.is_symlink():
            continue
        with suppress(InputError, OSError, ValueError, KeyError, TypeError, RecursionError):
            told = json.loads(read_bytes(path, MAX_JOB_BYTES))
            request = ExportRequest(
                **{**told["request"], "tracks": tuple(told["request"]["tracks"])}
            )
            files = tuple((str(name), int(size)) for name, size in told["files"])
            if any(Path(name).name != name for name, _ in files):
                continue
            yield Job(
                path.parent.name, request, float(told["made_s"]), told["state"], None,
                str(told["doing"]), files,
            )  # fmt: skip


def _clear(folder: Path) -> None:
    """Remove the files of a failed job."""
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.name != JOB:
            path.unlink(missing_ok=True)


def _reason(error: Exception) -> str:
    """Return why something failed, without where things lie on this machine."""
    return (error.strerror if isinstance(error, OSError) else None) or "the disk takes no more"
