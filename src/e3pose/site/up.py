"""Start a whole site on one machine: the edge and one process per local camera."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from e3pose.base.child_process import ask_to_end, start_detached
from e3pose.base.errors import InputError
from e3pose.base.private import append_to
from e3pose.base.quantities import LEAST_SIZE_BYTES
from e3pose.recording.videos import MAX_BYTES, VIDEOS
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.follow import ANY_HOST
from e3pose.site.run import END_S

RESTART_S = 2.0
BATTERIES = "batteries"  # folder of what is left in those of cameras on this machine
CHILD = "--end-with-parent"


def edge_command(path: Path, *options: str) -> list[str]:
    """Return the command line of the edge of a site."""
    return [sys.executable, "-m", "e3pose", "edge", str(path), *options, CHILD]


def view_command(path: Path, *options: str) -> list[str]:
    """Return the command line of the page, API and streams of a site."""
    return [sys.executable, "-m", "e3pose", "view", str(path), *options, CHILD]


def camera_command(site: ResolvedSite, camera_id: str) -> list[str]:
    """Return the command line of a camera of a site, run on this machine.

    Raises:
        InputError: when the site file does not say what the camera sees.
    """
    camera = site.cameras[camera_id]
    if camera.source is None:
        wanted = "what it sees, such as a video or recorded:RECORDING"
        raise InputError(f"camera {camera_id}: source", "none", wanted, str(site.file.path))
    shown = _allow_pictures(site)
    videos = _video_options(site, camera_id) if camera.record in ("video", "both") else []
    endpoint = site.file.link.endpoint
    if endpoint.host in ANY_HOST or endpoint.encrypted:
        endpoint = replace(endpoint, host="localhost")
    command = [
        sys.executable, "-m", "e3pose", "camera",
        "--site", site.file.name, "--name", camera_id, "--source", camera.source,
        "--endpoint", str(endpoint), "--wake-s", str(camera.wake_s),
        # On one machine every camera would measure the same watts, those of all together.
        "--provider", camera.provider, "--meter", camera.meter or "model", CHILD,
    ]  # fmt: skip
    if shown:
        command += ["--pictures"]
    if camera.gate:
        command += ["--gate"]
    if endpoint.encrypted:
        command += ["--keys", str(site.file.keys / "cameras" / camera_id)]
    for option, value in (
        ("--detector", camera.detector),
        ("--model", camera.model),
        ("--threads", camera.threads),
        ("--rotation", camera.rotation or None),
        ("--delay-ms", camera.delay_ms or None),
        ("--pace", None if site.file.pace == 1 else site.file.pace),
        ("--battery-wh", camera.battery_wh),
    ):
        if value is not None:
            command += [option, str(value)]
    command += videos
    if camera.battery_wh is not None:
        command += ["--state", str(site.file.folder / BATTERIES / f"{camera_id}.json")]
    if site.file.link.insecure:
        command.append("--insecure")
    return command


def _allow_pictures(site: ResolvedSite) -> bool:
    """Return whether cameras here show pictures; by default only to this machine."""
    if site.file.view.pictures is not None:
        return site.file.view.pictures
    here = site.file.view.listen.here_alone and site.file.link.endpoint.here_alone
    return here and not site.file.view.proxies


def _video_options(site: ResolvedSite, camera_id: str) -> list[str]:
    """Return the options of a camera that records videos; all share the size that is allowed."""
    cameras = sum(camera.record in ("video", "both") for camera in site.file.camera)
    folder = site.file.record.path / VIDEOS / camera_id
    size = (site.file.record.max_bytes or MAX_BYTES) // cameras
    options = [
        "--videos",
        str(folder),
        "--videos-max-size",
        f"{max(size, LEAST_SIZE_BYTES) / 1e6:.6f}MB",
    ]
    if site.file.record.part_s is not None:
        options += ["--videos-part", f"{site.file.record.part_s:g}s"]
    return options


@dataclass(eq=False)
class Program:
    """One process of the site, started again when it ends by itself.

    Its standard input is a pipe that ends with us, even if we are killed: see `end_with_parent`.

    Attributes:
        name: what to call it.
        command: how to start it.
        log: where its output goes.
        restarts: how often it was started again.
        process: the newest; None before the first start.
    """

    name: str
    command: Sequence[str]
    log: Path
    restarts: int = 0
    process: subprocess.Popen[bytes] | None = None
    _due_s: float = field(default=0.0)

    def start(self) -> None:
        """Start it; its output is appended to its log."""
        self.let_go()
        with append_to(self.log) as output:
            # A Ctrl-C on the terminal is for us, who end everybody in order.
            self.process = start_detached(self.command, subprocess.PIPE, output, subprocess.STDOUT)

    def ended(self) -> int | None:
        """Return how it ended; None while it runs."""
        return None if self.process is None else self.process.poll()

    def let_go(self) -> None:
        """Close the pipe that keeps it running."""
        if self.process is not None and self.process.stdin is not None:
            self.process.stdin.close()


def run_site(
    programs: Sequence[Program], stopped: Callable[[], bool], report: Callable[[str], None]
) -> None:
    """Run programs until stopped; one that ends by itself is restarted, or reported.

    Args:
        programs: the edge first; `stopped` may add others to the list, started already.
        stopped: whether to end.
        report: called with messages for operators.

    Raises:
        InputError: when a program refuses its input: that does not get better by itself.
    """
    try:
        for program in programs:
            program.start()
        while not stopped():
            for program in programs:
                code = program.ended()
                if code is None:
                    continue
                if code == 2:
                    raise InputError(f"{program.name}: {last_line(program.log)}")
                if program._due_s == 0.0:
                    program._due_s = time.monotonic() + RESTART_S
                    report(f"{program.name} exited with code {code}; restarting in {RESTART_S:g} s")
                elif time.monotonic() >= program._due_s:
                    program.restarts, program._due_s = program.restarts + 1, 0.0
                    program.start()
            time.sleep(0.1)
    finally:
        end(programs)


def end(programs: Sequence[Program]) -> None:
    """Terminate programs, cameras before the edge; kill the ones that do not react."""
    for group in (programs[1:], programs[:1]):
        for program in group:
            if program.process is not None and program.process.poll() is None:
                ask_to_end(program.process)
        deadline_s = time.monotonic() + END_S
        for program in group:
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
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return lines[-1][:500].removeprefix("e3pose: ") if lines else "exited without output"
