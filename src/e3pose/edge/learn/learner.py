"""The online learner: collects poses of a running edge, trains, and deploys better predictors.

The edge's own thread only appends to a list and looks into a queue. Files, processes and networks
are the business of a thread beside it, and torch that of a process of its own, so that neither a
slow disk nor a dying trainer costs a slot.
"""

from __future__ import annotations

import logging
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import msgspec
import numpy as np

from e3pose.base.atomic import write_file
from e3pose.base.child_process import kill_all, start_detached
from e3pose.base.clock import Clock
from e3pose.base.errors import Exit, InputError, reason_of
from e3pose.base.lock import hold
from e3pose.edge.learn.job import COMPLAINTS, JOB, WEIGHTS, Job, read_result
from e3pose.edge.learn.ring_buffer import Gathering, Ring, slots_in
from e3pose.edge.learn.settings import LearningSettings
from e3pose.edge.learn.versions import SHIPPED_NUMBER, Manifest, Version, VersionStore
from e3pose.model.skeleton import Skeleton
from e3pose.pipeline import SlotRecord
from e3pose.predict.attention_lstm import AttentionLstm
from e3pose.predict.base import Predictor

TRAINER = (sys.executable, "-m", "e3pose.edge.learn.trainer")
MAX_COMPLAINT = 300
# One thread each: the processor belongs to the edge.
SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


class TrainerProcess:
    """One training in a process of its own, in a session of its own.

    Args:
        folder: emptied, then the place of the job and of its result.
        job: what to do.
        command: runs a trainer when given the folder as last argument.
    """

    def __init__(self, folder: Path, job: Job, command: Sequence[str] = TRAINER) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        self.folder, self.job = folder, job
        write_file(folder / JOB, msgspec.json.encode(job))
        with (folder / COMPLAINTS).open("wb") as complaints:
            self.process = start_detached(
                [*command, str(folder)],
                subprocess.DEVNULL,
                subprocess.DEVNULL,
                complaints,
                {**os.environ, **SINGLE},
                last=True,
            )

    @property
    def pid(self) -> int:
        """The process."""
        return self.process.pid

    def code(self) -> int | None:
        """Return its exit code, negative for a signal; None while it runs."""
        return self.process.poll()

    def how_it_ended(self) -> str:
        """Return one line about a process that ended."""
        code = self.process.returncode
        if code < 0:
            try:
                how = f"was killed by {signal.Signals(-code).name}"
            except ValueError:
                how = f"was killed by signal {-code}"
        else:
            how = f"ended with code {code}"
        said = self._last_complaint()
        return f"{how}: {said}" if said else how

    def kill(self) -> None:
        """Kill it and all its children."""
        kill_all(self.process)
        with suppress(subprocess.TimeoutExpired):  # stuck in the kernel: not worth waiting for
            self.process.wait(timeout=5.0)

    def _last_complaint(self) -> str:
        try:
            with (self.folder / COMPLAINTS).open("rb") as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - 4096))
                lines = file.read().decode("utf-8", errors="replace").split("\n")
        except OSError:
            return ""
        last = next((line for line in reversed(lines) if line.strip()), "")
        return "".join(c if c.isprintable() else " " for c in last)[:MAX_COMPLAINT]


LOG = logging.getLogger(__name__)
POLL_S = 0.5  # between polls of the thread beside the edge
MAX_WAITING = 8  # chunks of a disk that is too slow; later ones are lost
MAX_EVENTS = 200
WARM_UP_PEOPLE = 4


class OnlineTrainer:
    """Trains the predictor on the poses that the running system estimates.

    Args:
        folder: of this site; what it holds survives restarts. One process at a time.
        skeleton: of the estimated poses.
        settings: how to learn.
        clock: the time.
        command: runs a trainer when given a job's folder as last argument.
        background: let a thread do the work; without it, call `run_once` for each round.

    Raises:
        InputError: when the folder cannot be used, or another process learns there.
    """

    def __init__(
        self,
        folder: Path,
        skeleton: Skeleton,
        settings: LearningSettings,
        clock: Clock,
        *,
        command: Sequence[str] = TRAINER,
        background: bool = True,
    ) -> None:
        self.folder, self.skeleton, self.settings = folder, skeleton, settings
        self.clock, self.command = clock, tuple(command)
        try:
            self.ring = Ring(folder / "poses", skeleton, settings.ring_bytes)
            self.store = VersionStore(folder / "versions", settings.keep_versions)
        except OSError as error:
            raise InputError(f"{folder}: cannot be used to learn in: {reason_of(error)}") from None
        self._lock = ExitStack()
        self._lock.enter_context(hold(folder / "poses"))
        self._events: deque[str] = deque(maxlen=MAX_EVENTS)
        self._gathering = Gathering(clock.now_ns())
        self._waiting: queue.Queue[Gathering] = queue.Queue(MAX_WAITING)
        self._ready: queue.SimpleQueue[Predictor] = queue.SimpleQueue()
        self._trainer: TrainerProcess | None = None
        self._deadline_s = self._due_s = 0.0
        self._failures = 0
        self._slots_of = {path: slots_in(path, skeleton.joints) for path in self.ring.files()}
        self._fresh_s = sum(self._slots_of.values()) * settings.interval_s
        self._running = SHIPPED_NUMBER
        try:
            self._follow_manifest()
        except Exception as error:  # learning may wait, the edge must start
            self._report(f"{type(error).__name__}: {error}", logging.WARNING)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="learning", daemon=True)
        if background:
            self._thread.start()

    # What the edge's thread calls.

    def collect(self, record: SlotRecord) -> None:
        """Collect the record of a slot; never waits."""
        self._gathering.add(record)
        if self._gathering.full(round(self.settings.chunk_s / self.settings.interval_s)):
            self._put_by()

    def new_run(self) -> None:
        """Say that slots and track ids begin anew from here."""
        if self._gathering.records:
            self._put_by()
        self._gathering = Gathering(max(self._gathering.run + 1, self.clock.now_ns()))

    def poll(self) -> Predictor | None:
        """Return a predictor to use from the next slot on, or None to go on; never waits."""
        try:
            return self._ready.get_nowait()
        except queue.Empty:
            return None

    # What anybody may call.

    @property
    def events(self) -> tuple[str, ...]:
        """The latest things that happened, oldest first."""
        return tuple(self._events)

    @property
    def current(self) -> int:
        """Number of the version that runs, 0 for the weights to begin with."""
        return self._running

    @property
    def training(self) -> bool:
        """Whether a trainer is at work."""
        return self._trainer is not None

    @property
    def collected_s(self) -> float:
        """Seconds with people in them that are on disk."""
        return sum(self._slots_of.values()) * self.settings.interval_s

    def close(self) -> None:
        """Write collected poses, stop a running training, and unlock the folder."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(timeout=10.0)
        if self._trainer is not None:
            self._trainer.kill()
            self._trainer = None
        if self._gathering.records:
            self._put_by()
        self.write_waiting()
        self._lock.close()

    # What the thread beside the edge does.

    def run_once(self) -> None:
        """Run one round of work: write, start, watch, judge, load. Never raises."""
        now_s = self.clock.now_ns() / 1e9
        try:
            self.write_waiting()
            self._follow_manifest()
            if self._trainer is not None:
                self._watch(self._trainer, now_s)
            elif now_s >= self._due_s:
                self._start_if_enough(now_s)
        except Exception as error:  # the edge goes on, whatever happens here
            self._failed(now_s, f"{type(error).__name__}: {error}")

    def _run(self) -> None:
        while not self._closing.wait(POLL_S):
            self.run_once()

    def _put_by(self) -> None:
        gathered, self._gathering = self._gathering, Gathering(self._gathering.run)
        try:
            self._waiting.put_nowait(gathered)
        except queue.Full:
            self._report("poses lost: the disk is too slow", logging.WARNING)

    def write_waiting(self) -> None:
        """Write the poses that wait for it."""
        while not self._waiting.empty():
            gathered = self._waiting.get()
            try:
                path = self.ring.write(gathered.chunk())
            except (InputError, OSError) as error:
                self._report(f"poses lost: {error}", logging.WARNING)
                continue
            self._slots_of[path] = len(gathered.records)
            self._fresh_s += len(gathered.records) * self.settings.interval_s

    def _start_if_enough(self, now_s: float) -> None:
        if self._fresh_s < self.settings.held_back_s:
            return
        self._slots_of = {path: self._slots_of.get(path, 0) for path in self.ring.files()}
        files = [path for path, slots in self._slots_of.items() if slots > 0]
        interval_s = self.settings.interval_s
        seconds = np.array([self._slots_of[path] * interval_s for path in files])
        after = np.cumsum(seconds[::-1])[::-1] - seconds  # of newer files
        held_back = [p for p, s in zip(files, after, strict=True) if s < self.settings.held_back_s]
        learn = files[: len(files) - len(held_back)]
        if not learn or seconds.sum() < self.settings.least_s:
            return
        base = self._weights_of(self.store.read(), self._running)
        job = Job(
            parent=os.getpid(),
            joints=self.skeleton.joints,
            interval_s=interval_s,
            learn=tuple(str(path.resolve()) for path in learn),
            held_back=tuple(str(path.resolve()) for path in held_back),
            base=str(base.resolve()),
            leads=self.settings.leads,
            steps=self.settings.steps,
            train_s=self.settings.train_s,
            learning_rate=self.settings.learning_rate,
            memory_bytes=self.settings.memory_bytes,
            seed=self.settings.seed,
        )
        self._trainer = TrainerProcess(self.folder / "job", job, self.command)
        self._fresh_s = 0.0  # what was held back now may be learned next time
        self._deadline_s = now_s + 2 * self.settings.train_s + 60.0
        self._report(f"training started on {seconds[: len(learn)].sum():.0f} s of motion")

    def _watch(self, trainer: TrainerProcess, now_s: float) -> None:
        code = trainer.code()
        if code is None:
            if now_s > self._deadline_s:
                self._trainer = None
                trainer.kill()
                self._failed(now_s, "the trainer timed out and was stopped")
            return
        self._trainer = None
        if code:
            self._failed(now_s, f"the trainer {trainer.how_it_ended()}", code == Exit.REFUSED)
            return
        try:
            self._judge(trainer)
        except (InputError, OSError) as error:
            self._failed(now_s, f"invalid result of the trainer: {error}")
            return
        self._failures = 0
        self._due_s = now_s + self.settings.every_s

    def _judge(self, trainer: TrainerProcess) -> None:
        verdict, content, card = read_result(trainer.folder, trainer.job)
        figures = "mean error in mm: " + ", ".join(
            f"lead {lead} {1000 * old:.1f} -> {1000 * new:.1f}"
            for lead, new, old in zip(
                verdict.leads, verdict.error_m, verdict.base_error_m, strict=True
            )
        )
        if verdict.windows < self.settings.least_windows:
            self._report(f"no change: only {verdict.windows} validation windows")
            return
        if not verdict.better(self.settings.margin):
            self._report(f"no change: the new network is not better; {figures}")
            return
        if Path(trainer.job.base) != self._weights_of(self.store.read(), self._running).resolve():
            self._report("no change: another version was selected during training")
            return
        predictor = self._load(trainer.folder / WEIGHTS)
        version = self.store.add(
            content,
            card,
            Version(
                number=0,
                parent=self._running,
                created_s=self.clock.now_ns() / 1e9,
                sha256="",
                leads=verdict.leads,
                error_m=verdict.error_m,
                parent_error_m=verdict.base_error_m,
                windows=verdict.windows,
            ),
        )
        self._running = version.number
        self._ready.put(predictor)
        self._report(f"version {version.number} in use from the next slot; {figures}")

    def _follow_manifest(self) -> None:
        """Load the version that the manifest names, if another one runs."""
        try:
            manifest = self.store.read()
        except InputError as error:
            aside, manifest = self.store.put_aside()
            now = f"version {manifest.current}" if manifest.current else "the network to begin with"
            self._report(f"{error}; moved to {aside.name}, {now} runs", logging.WARNING)
        if manifest.current == self._running:
            return
        wanted, predictor = manifest.current, None
        while predictor is None and wanted != self._running:
            try:
                predictor = self._load(self._weights_of(manifest, wanted))
            except InputError as error:
                self._report(f"version {wanted} rejected: {error}", logging.WARNING)
                older = [one.parent for one in manifest.versions if one.number == wanted]
                wanted = older[0] if older and older[0] < wanted else self._running
        if wanted != manifest.current:
            self.store.use(wanted)
        self._running = wanted
        if predictor is not None:
            self._ready.put(predictor)
            self._report(f"version {wanted} in use from the next slot")

    def _weights_of(self, manifest: Manifest, number: int) -> Path:
        version = manifest.find(number)
        return self.settings.base if version is None else self.store.weights(version)

    def _load(self, path: Path) -> Predictor:
        """Return the predictor of a file, warmed up, so that its first slot is like any other."""
        predictor = AttentionLstm(self.skeleton, path)
        lead = max(self.settings.leads)
        history = np.random.default_rng(0).normal(
            size=(predictor.history_slots, WARM_UP_PEOPLE, len(self.skeleton), 3)
        )
        for _ in range(3):
            said = predictor.predict(history, self.settings.interval_s, lead)
        if not np.isfinite(said.joints_m).all():
            raise InputError(f"{path}: network: found predictions that are no numbers")
        return predictor

    def _failed(self, now_s: float, reason: str, for_long: bool = False) -> None:
        settings = self.settings
        wait_s = min(settings.back_off_s * 2.0**self._failures, settings.longest_back_off_s)
        wait_s = settings.longest_back_off_s if for_long else wait_s
        self._failures = min(self._failures + 1, 60)
        self._fresh_s = max(self._fresh_s, settings.held_back_s)  # nothing came of it: try again
        self._due_s = now_s + wait_s
        self._report(f"{reason}; next attempt in {wait_s:.0f} s", logging.WARNING)

    def _report(self, event: str, level: int = logging.INFO) -> None:
        line = " ".join(event.split())[:1000]
        self._events.append(line)
        LOG.log(level, "learning: %s", line)
