"""Start a whole site on one machine: the edge and one process per local camera."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import IO, Any

from e3pose.base.child_process import ask_to_end, start_detached
from e3pose.base.errors import Exit, GaveUp, InputError, reason_of
from e3pose.base.masking import has_secret
from e3pose.base.private import append_to
from e3pose.base.quantities import LEAST_SIZE_BYTES
from e3pose.recording.videos import MAX_BYTES, VIDEOS
from e3pose.settings.resolved import ResolvedSite
from e3pose.settings.sources import ENVIRONMENT, is_live
from e3pose.site.follow import ANY_HOST
from e3pose.site.run import END_S

RESTART_S, LONGEST_RESTART_S = 2.0, 60.0  # before a program starts again; doubled if that fails
STEADY_S = 30.0  # a program that ran for so long works
MOST_RESTARTS = 4  # of a program that never worked
BATTERIES = "batteries"  # folder of what is left in those of cameras on this machine
CHILD = "--end-with-parent"
SOURCE = "E3POSE_SOURCE"  # in the environment of a camera: a source that holds a password


def edge_command(path: Path, *options: str) -> list[str]:
    """Return the command line of the edge of a site."""
    return [sys.executable, "-m", "e3pose", "edge", str(path), *options, CHILD]


def view_command(path: Path, *options: str) -> list[str]:
    """Return the command line of the page, API and streams of a site."""
    return [sys.executable, "-m", "e3pose", "view", str(path), *options, CHILD]


def camera_keys(site: ResolvedSite, camera_id: str) -> dict[str, Any]:
    """Return the keys of a camera file for a camera that runs on this machine.

    Raises:
        InputError: when the site file does not say what the camera sees.
    """
    camera = site.cameras[camera_id]
    if camera.source is None:
        wanted = "what it sees, such as a video or recorded:RECORDING"
        raise InputError(f"camera {camera_id}: source", "none", wanted, str(site.file.path))
    endpoint = site.file.link.endpoint
    if endpoint.host in ANY_HOST or endpoint.encrypted:
        endpoint = replace(endpoint, host="localhost")
    battery = site.file.folder / BATTERIES / f"{camera_id}.json"
    keys = site.file.keys / "cameras" / camera_id
    said = {
        "site": site.file.name,
        "camera": camera_id,
        "source": camera.source,
        "endpoint": endpoint,
        "wake_s": camera.wake_s,
        "provider": camera.provider,
        # On one machine every camera would measure the same watts, those of all together.
        "meter": camera.meter or "model",
        "pictures": _allow_pictures(site),
        "gate": camera.gate,
        "keys": keys if endpoint.encrypted else None,
        "detector": camera.detector,
        "model": camera.model,
        "threads": camera.threads,
        "rotation": camera.rotation or None,
        "delay_ms": camera.delay_ms or None,
        "size": _size(site, camera_id),
        "pace": None if site.file.pace == 1 else site.file.pace,
        "battery_wh": camera.battery_wh,
        **(_video_keys(site, camera_id) if camera.record in ("video", "both") else {}),
        "state": None if camera.battery_wh is None else battery,
        "insecure": site.file.link.insecure,
    }
    return {
        key: value if isinstance(value, bool | int | float) else str(value)
        for key, value in said.items()
        if value is not None and value is not False
    }


def camera_command(site: ResolvedSite, camera_id: str) -> list[str]:
    """Return the command line of a camera of a site, run on this machine; errors likewise."""
    keys = camera_keys(site, camera_id)
    if has_secret(keys["source"]):  # every user of the machine can read command lines
        keys["source"] = f"{ENVIRONMENT}{SOURCE}"
    keys["name"] = keys.pop("camera")
    command = [sys.executable, "-m", "e3pose", "camera", CHILD]
    for key, value in keys.items():
        option = f"--{key.replace('_', '-')}"
        command += [option] if value is True else [option, str(value)]
    return command


def _size(site: ResolvedSite, camera_id: str) -> str | None:
    """Return the image size to ask a camera here for: its own, else that of its calibration."""
    size = site.cameras[camera_id].size
    if size is None and site.rig.placed:
        size = site.rig.cameras[site.rig.index(camera_id)].image_size
    source = site.cameras[camera_id].source or ""
    asks = is_live(source) and "://" not in source
    return f"{size[0]}x{size[1]}" if size is not None and asks else None


def _allow_pictures(site: ResolvedSite) -> bool:
    """Return whether cameras here show pictures; by default only to this machine."""
    if site.file.view.pictures is not None:
        return site.file.view.pictures
    here = site.file.view.listen.here_alone and site.file.link.endpoint.here_alone
    return here and not site.file.view.proxies


def _video_keys(site: ResolvedSite, camera_id: str) -> dict[str, str | None]:
    """Return the keys of a camera that records videos; all share the size that is allowed."""
    cameras = sum(camera.record in ("video", "both") for camera in site.file.camera)
    size = (site.file.record.max_bytes or MAX_BYTES) // cameras
    part_s = site.file.record.part_s
    return {
        "videos": str(site.file.record.path / VIDEOS / camera_id),
        "videos_max_size": f"{max(size, LEAST_SIZE_BYTES) / 1e6:.6f}MB",
        "videos_part": None if part_s is None else f"{part_s:g}s",
    }


def longer_s(wait_s: float) -> float:
    """Return the wait before the next start of a program that ended again after a wait."""
    return min(2 * wait_s, LONGEST_RESTART_S) or RESTART_S


class Role(Enum):
    """The consequence for a site of a program that never works."""

    NEEDED = "the site ends"
    CAMERA = "the site goes on, as long as another camera does"
    PAGE = "the site goes on"


@dataclass(eq=False)
class Program:
    """One process of the site, started again when it ends by itself.

    Its standard input is a pipe that ends with us, even if we are killed: see `end_with_parent`.

    Attributes:
        name: what to call it.
        command: how to start it.
        log: where its output goes.
        passed: sockets that it is given, which outlast its restarts.
        restarts: how often it was started again.
        works: whether it once ran for `STEADY_S`.
        process: the newest; None before the first start.
        environment: variables beside ours.
        role: what becomes of the site without it.
        failure: why it never worked, once that is known.
    """

    name: str
    command: Sequence[str]
    log: Path
    passed: Sequence[socket.socket] = ()
    restarts: int = 0
    works: bool = False
    process: subprocess.Popen[bytes] | None = None
    environment: Mapping[str, str] = field(default_factory=dict)
    role: Role = Role.NEEDED
    failure: InputError | GaveUp | None = None
    _begun_s: float = 0.0
    _due_s: float = 0.0  # to start again; 0 while it runs
    _wait_s: float = 0.0

    def start(self) -> str:
        """Start it; its output is appended to its log. Return why there is no log, else empty."""
        self.let_go()
        problem = ""
        with ExitStack() as stack:
            try:
                output: int | IO[bytes] = stack.enter_context(append_to(self.log))
            except OSError as error:
                output, problem = subprocess.DEVNULL, reason_of(error).lower()
            # A Ctrl-C on the terminal is for us, who end everybody in order.
            self.process = start_detached(
                self.command,
                subprocess.PIPE,
                output,
                subprocess.STDOUT,
                {**os.environ, **self.environment},
                passed=[each.fileno() for each in self.passed],
            )
        self._begun_s, self._due_s = time.monotonic(), 0.0
        return problem and f"{self.name} runs without a log: {self.log}: {problem}"

    def ended(self) -> int | None:
        """Return how it ended; None while it runs."""
        code = None if self.process is None else self.process.poll()
        if code is None and self.process and time.monotonic() - self._begun_s > STEADY_S:
            self.works, self._wait_s, self.failure = True, 0.0, None
        return code

    def restart(self, code: int) -> str:
        """Start it again, when due, after it ended with a code; return a line for operators.

        One that refuses its input, or ended again and again, and never worked has a `failure`; it
        is said once and tried again all the same, as somebody may mend what it needs.
        """
        now_s = time.monotonic()
        if self._due_s == 0.0:
            said, left_out = f"{self.name}: {last_line(self.log)}", self.failure is not None
            if not self.works and code == Exit.REFUSED:
                self.failure = InputError(said)
            elif not self.works and self.restarts >= MOST_RESTARTS:
                times = f"ended {self.restarts + 1} times, the last with code {code}"
                self.failure = GaveUp(f"{said} ({times})")
            if self.failure is not None:
                self._due_s = now_s + LONGEST_RESTART_S
                again = f"the others go on; tried again every {LONGEST_RESTART_S:g} s"
                return "" if left_out else f"{self.failure}; {again}"
            self._wait_s = longer_s(self._wait_s)
            self._due_s = now_s + self._wait_s
            return f"{self.name} exited with code {code}; restarting in {self._wait_s:g} s"
        if now_s < self._due_s:
            return ""
        self.restarts += 1
        try:
            return self.start()
        except OSError as error:  # no memory or no file left
            self._due_s = now_s + LONGEST_RESTART_S
            return f"{self.name} cannot be started: {reason_of(error).lower()}"

    def let_go(self) -> None:
        """Close the pipe that keeps it running."""
        if self.process is not None and self.process.stdin is not None:
            self.process.stdin.close()


def camera_program(site: ResolvedSite, camera_id: str, logs: Path) -> Program:
    """Return a camera of a site, run on this machine; errors as of `camera_command`."""
    command, source = camera_command(site, camera_id), site.cameras[camera_id].source or ""
    environment = {SOURCE: source} if has_secret(source) else {}
    return Program(camera_id, command, logs / f"{camera_id}.log", environment=environment)


def cameras_program(site: ResolvedSite, logs: Path) -> Program:
    """Return all cameras of a site, run on this machine in one program."""
    command = [sys.executable, "-m", "e3pose", "cameras", str(site.file.path), CHILD]
    return Program("cameras", command, logs / "cameras.log")


def run_site(
    programs: Sequence[Program], stopped: Callable[[], bool], report: Callable[[str], None]
) -> None:
    """Run programs until stopped; one that ends by itself is restarted, or reported.

    Args:
        programs: the edge first; `stopped` may add others to the list, started already.
        stopped: whether to end.
        report: called with messages for operators.

    Raises:
        InputError: when a program that the site needs never worked and refuses its input.
        GaveUp: when such a one never worked, however often it was started.
    """
    try:
        problems = [problem for program in programs if (problem := program.start())]
        for problem in problems[:1]:  # the others', too
            report(problem)
        while not stopped():
            for program in programs:
                if (code := program.ended()) is None:
                    continue
                said = program.restart(code)
                if program.failure is not None and _ends_site(program, programs):
                    raise program.failure
                if said:
                    report(said)
            time.sleep(0.1)
    finally:
        end(programs)


def _ends_site(program: Program, programs: Sequence[Program]) -> bool:
    """Return whether a site cannot go on without a program that never worked."""
    cameras = [each for each in programs if each.role is Role.CAMERA]
    none = all(each.failure is not None and each.ended() is not None for each in cameras)
    return program.role is Role.NEEDED or (program.role is Role.CAMERA and none)


def end(programs: Sequence[Program]) -> None:
    """Terminate programs, cameras before the edge; kill the ones that do not react."""
    for group in (programs[1:], programs[:1]):
        for program in group:
            if program.process is not None and program.process.poll() is None:
                ask_to_end(program.process)
        deadline_s = time.monotonic() + END_S
        for program in group:
            for each in program.passed:
                each.close()
            if program.process is None:
                continue
            try:
                program.process.wait(max(0.1, deadline_s - time.monotonic()))
            except subprocess.TimeoutExpired:
                program.process.kill()
                program.process.wait()
            program.let_go()


def last_line(log: Path) -> str:
    """Return the last line that a program wrote."""
    try:
        lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    except OSError as error:
        return f"its log cannot be read: {reason_of(error).lower()}"
    return lines[-1][:500].removeprefix("e3pose: ") if lines else "exited without output"
