"""Certificates that expire and clocks that jump, under a running site of real processes."""

from __future__ import annotations

import math
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from attack_inputs import SECOND, Report, Result
from attack_lies import POSES_SHARE, Seen, got, viewer
from e3pose.site.up import Program
from e3pose.wire.keys.authority import LEAF_DAYS
from e3pose.wire.keys.renewal import certificate_files, expiring, renew_keys
from e3pose.wire.site_messages import Status
from live_site import Site, live_site, wait

CAMERAS, FPS = 4, 25.0
SLEEPERS_FPS = 10.0  # at which each of four cameras that look by turns has time to sleep
MOVED = Path(__file__).with_name("moved_clock.py")
LIFE_S = 200.0  # of the first certificates, in which all before must be over: cameras reconnect
REST_SLOTS = 50  # in which it is measured what comes just before a trial
WHILE_S = 4.0  # for which a moved clock stays moved
STEPPED_S = 10.0  # for which poses are counted after a jump
BACK_S = 20.0  # within which cameras must be back
STOPPED_S = 15.0
ASLEEP_SHARE = 0.05  # of the heartbeats, most of which wait for a slot, and so for who is awake
TRUE_S = 0.5  # that times of poses may be wrong by
FLOWS = f"{POSES_SHARE:.0%} of the poses just before"
BACK = f"all cameras there within {BACK_S:g} s"


def clocks(report: Report) -> None:
    """Move clocks, stop a camera, let certificates expire; five minutes."""
    _clocks_of_sleepers(report)
    _clocks_and_certificates(report)


@dataclass
class _Movable:
    """Lets programs run with clocks that can be moved.

    Attributes:
        offsets: by program, the file that says by how much.
    """

    offsets: dict[str, Path] = field(default_factory=dict)

    def change(self, program: Program) -> None:
        self.offsets[program.name] = program.log.with_suffix(".offsets")
        moved = str(MOVED), str(self.offsets[program.name])
        program.command = [sys.executable, *moved, *program.command[3:]]


def _clocks_of_sleepers(report: Report) -> None:
    """Move the clocks of a site whose cameras sleep between their orders."""
    movable = _Movable()
    with (
        live_site(
            cameras=CAMERAS, people=3, fps=SLEEPERS_FPS, loop="cameras = 1", asleep=True,
            change=movable.change,
        ) as site,
        viewer(site) as seen,
    ):  # fmt: skip
        trials = _Trials(site, seen, movable.offsets, report, "cameras that sleep, ")
        trials.tell(trials.asleep)
        trials.tell(trials.system, "cam3", -86400.0)
        trials.tell(trials.camera_steps, 5.0)
        trials.tell(trials.camera_steps, 600.0)
        trials.tell(trials.camera_is_stopped)
        trials.tell(trials.edge_steps, 5.0)
        trials.tell(trials.asleep)


def _clocks_and_certificates(report: Report) -> None:
    movable = _Movable()
    now = datetime.now(timezone.utc)
    made = now - timedelta(days=LEAF_DAYS) + timedelta(seconds=LIFE_S)
    with (
        live_site(
            cameras=CAMERAS, people=3, fps=FPS, keys_made=made, change=movable.change
        ) as site,
        viewer(site) as seen,
    ):
        trials = _Trials(site, seen, movable.offsets, report)
        trials.tell(trials.usual)
        for seconds in (5.0, -5.0, 600.0, -86400.0):
            trials.tell(trials.system, "cam3", seconds)
            trials.tell(trials.system, "edge", seconds)
        trials.tell(trials.camera_steps, 5.0)
        trials.tell(trials.camera_steps, 600.0)
        trials.tell(trials.camera_is_stopped)
        for seconds in (5.0, 600.0):
            trials.tell(trials.edge_steps, seconds)
        trials.certificates_expire(now + timedelta(seconds=LIFE_S))
        trials.certificates_are_renewed()


class _Trials:
    """Trials of moved clocks, and their results."""

    def __init__(
        self, site: Site, seen: Seen, offsets: dict[str, Path], report: Report, where: str = ""
    ) -> None:
        self.site, self.seen, self.offsets = site, seen, offsets
        self._report, self._where = report, where
        self._fps = SLEEPERS_FPS if where else FPS
        self._rest = math.inf  # poses per second of the site before anything was tried
        self._usual = 0.0  # the same just before a trial, where that is less
        self._kept = math.nan  # share of it that came, for the next row
        self._moved = {name: [0.0, 0.0] for name in offsets}

    def _row(self, name: str, figures: str, held: bool, must: str) -> Result:
        kept, self._kept = self._kept, math.nan
        return Result(f"{self._where}{name}", figures, held, must, kept)

    def tell(self, trial: Callable[..., Result], *given: Any) -> None:
        """Report what comes of a trial; where it does not hold, of a second one."""
        result = trial(*given)
        if not result.held:
            self._report(replace(result, again=True))
            self._back_s(time.monotonic())
            result = trial(*given)
            result = replace(result, name=f"{result.name}{SECOND}")
        self._report(result)

    def _move(self, name: str, steady_s: float = 0.0, system_s: float = 0.0) -> None:
        moved = self._moved[name]
        moved[:] = moved[0] + steady_s, moved[1] + system_s
        self.offsets[name].write_text(f"{moved[0]} {moved[1]}")

    def _away(self) -> dict[str, str]:
        """Return the cameras that are not online by the newest status, and why."""
        return {c.camera_id: c.why for c in self.seen.statuses[-1][1].cameras if not c.online}

    def _back_s(self, since_s: float, left: bool = False) -> float | None:
        """Return after how many seconds all cameras are there; None if not within `BACK_S`.

        Args:
            since_s: when what was tried ended.
            left: whether to wait first until one was seen to be away, for some seconds.
        """
        while left and not self._away() and time.monotonic() < since_s + WHILE_S:
            wait(0.1)
        while time.monotonic() < since_s + BACK_S:
            at_s, status = self.seen.statuses[-1]
            fresh = at_s > since_s + 1.0 and status.fps > 0.5 * self._fps
            if fresh and not self._away():
                return time.monotonic() - since_s
            wait(0.1)
        return None

    def _begin(self) -> float:
        """Measure what comes just before a trial; return the time."""
        before_s = time.monotonic()
        wait(REST_SLOTS / self._fps)
        now_s = time.monotonic()
        found = got(self.seen, set(), before_s, now_s).poses
        self._rest = found if math.isinf(self._rest) else self._rest
        self._usual = min(self._rest, found)
        return now_s

    def _flow(self, since_s: float, honest: int = CAMERAS) -> tuple[bool, str]:
        """Return whether poses with a view flow since some time, and how many, in words."""
        ids = {f"cam{index}" for index in range(honest)}
        found = got(self.seen, ids, since_s, time.monotonic()).poses
        words = f"{found:.1f} poses per second, {self._usual:.1f} at rest"
        self._kept = found / max(self._usual, 1e-9)
        return found > POSES_SHARE * self._usual, words

    def usual(self) -> Result:
        self._begin()
        return self._row(
            "clocks at rest", f"{self._usual:.1f} poses per second", self._usual > 0, "poses come"
        )

    def asleep(self) -> Result:
        """Look whether cameras sleep, and how many views come nevertheless."""
        end_s = time.monotonic() + BACK_S
        while time.monotonic() < end_s and not any(
            self._sleeping(status) for _, status in self.seen.statuses[-1:]
        ):
            wait(0.2)  # all are awake in the first slots
        since_s = self._begin()
        wait(2 * WHILE_S)
        newest = [status for at_s, status in list(self.seen.statuses) if at_s >= since_s]
        share = sum(map(self._sleeping, newest)) / max(CAMERAS * len(newest), 1)
        found, words = self._flow(since_s)
        said = f"{words}, asleep in {share:.0%} of their heartbeats"
        must = f"{FLOWS}, asleep in {ASLEEP_SHARE:.0%} of the heartbeats"
        return self._row("at rest", said, found and share > ASLEEP_SHARE, must)

    @staticmethod
    def _sleeping(status: Status) -> int:
        """Return how many cameras slept at their last heartbeats."""
        return sum(camera.mode == "aggressive-power-saving" for camera in status.cameras)

    def system(self, name: str, seconds: float) -> Result:
        """Set the system's clock of a program, and back."""
        since_s, away = self._begin(), dict[str, str]()
        self._move(name, system_s=seconds)
        while time.monotonic() < since_s + WHILE_S:
            away |= self._away()
            wait(0.2)
        poses = [(at, slot) for at, slot, *_ in list(self.seen.poses) if at >= since_s]
        (at0, slot0), (at1, slot1) = poses[0], poses[-1]
        wrong_s = abs((slot1 - slot0) / self._fps - (at1 - at0))
        found, words = self._flow(since_s)
        self._move(name, system_s=-seconds)
        return self._row(
            f"system clock of {name} set by {seconds:+g} s",
            f"{words}, {len(away)} cameras left, times of slots wrong by {wrong_s:.2f} s",
            found and not away and wrong_s < TRUE_S,
            f"{FLOWS}, no camera leaves, times wrong by less than {TRUE_S:g} s",
        )

    def camera_steps(self, seconds: float) -> Result:
        """Move the steady clock of a camera, for good."""
        since_s = self._begin()
        self._move("cam3", steady_s=seconds)
        back_s = self._back_s(since_s, left=True)
        wait(max(since_s + STEPPED_S - time.monotonic(), 0.0))
        found, words = self._flow(since_s, CAMERAS - 1)
        return self._row(
            f"steady clock of a camera jumps by {seconds:+g} s",
            f"{words}, all cameras there after {_said(back_s)}",
            back_s is not None and found,
            f"{FLOWS}, {BACK}",
        )

    def camera_is_stopped(self) -> Result:
        """Stop a camera for a while, as a suspended machine is."""
        process = self._program("cam2").process
        assert process is not None
        since_s = self._begin()
        process.send_signal(signal.SIGSTOP)
        wait(STOPPED_S)
        away = self._away()
        found, words = self._flow(since_s, CAMERAS - 1)
        process.send_signal(signal.SIGCONT)
        back_s = self._back_s(time.monotonic())
        return self._row(
            f"camera stopped for {STOPPED_S:g} s",
            f"{words}, away: {', '.join(sorted(away))}; back after {_said(back_s)}",
            list(away) == ["cam2"] and back_s is not None and found,
            f"{FLOWS}, it alone is away, {BACK}",
        )

    def edge_steps(self, seconds: float) -> Result:
        """Move the steady clock of the edge, for good, as after a machine was suspended."""
        since_s, before = time.monotonic(), self.seen.poses[-1][1]
        self._move("edge", steady_s=seconds)
        back_s = self._back_s(since_s, left=True)
        passed = (time.monotonic() - since_s) * self._fps
        skipped = self.seen.poses[-1][1] - before - passed
        return self._row(
            f"steady clock of the edge jumps by {seconds:+g} s",
            f"{max(skipped, 0):.0f} slots skipped, all cameras there after {_said(back_s)}",
            back_s is not None,
            BACK,
        )

    def _program(self, name: str) -> Program:
        (found,) = (program for program in self.site.programs if program.name == name)
        return found

    def certificates_expire(self, until: datetime) -> None:
        """Wait until all certificates have expired; then start a camera again with its own."""
        wait(max((until - datetime.now(timezone.utc)).total_seconds() - 2.0, 0.0))
        since_s, away = self._begin(), dict[str, str]()
        while time.monotonic() < since_s + 10.0:
            away |= self._away()
            wait(0.2)
        found, words = self._flow(since_s)
        said, must = f"{words}, {len(away)} cameras left", f"{FLOWS}, no camera leaves"
        self._report(self._row("all certificates expire", said, found and not away, must))
        camera = self._program("cam1")
        self._end(camera)
        camera.start()
        assert camera.process is not None
        code = camera.process.wait(30.0)
        last = camera.log.read_text().strip().splitlines()[-1]
        row = self._row(
            "camera started with an expired certificate",
            f"exit code {code}: {last[max(last.find('expired') - 40, 0) :][:120]}",
            code == 2 and "expired" in last,
            "exit code 2, which says that it has expired",
        )
        self._report(row)

    def certificates_are_renewed(self) -> None:
        """Renew all certificates; start the camera, then the edge again."""
        keys, since_s = self.site.folder / "keys", time.monotonic()
        for name in certificate_files(keys):
            renew_keys(keys, name, datetime.now(timezone.utc))
        left = [name for name, _ in expiring(keys, datetime.now(timezone.utc))]
        wait(3.0)
        self._program("cam1").start()
        back_s = self._back_s(time.monotonic())
        wait(max(since_s + STEPPED_S - time.monotonic(), 0.0))
        found, words = self._flow(since_s)
        row = self._row(
            "certificates renewed",
            f"{words}, {len(left)} left expired, all there after {_said(back_s)}",
            back_s is not None and not left and found,
            f"{FLOWS}, none left expired, {BACK}",
        )
        self._report(row)
        edge = self._program("edge")
        self._end(edge)
        edge.start()
        back_s = self._back_s(time.monotonic() + 1.0)
        row = self._row(
            "edge killed and started again",
            f"all back after {_said(back_s)}",
            back_s is not None,
            BACK,
        )
        self._report(row)

    def _end(self, program: Program) -> None:
        assert program.process is not None
        program.process.kill()
        program.process.wait()


def _said(back_s: float | None) -> str:
    return f"more than {BACK_S:g} s" if back_s is None else f"{back_s:.1f} s"
