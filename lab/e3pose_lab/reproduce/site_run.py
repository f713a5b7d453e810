"""Run a site of real processes: an edge and its cameras."""

from __future__ import annotations

import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.settings.resolved import resolve_site
from e3pose.site.example import Example, write_example
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.up import Program, camera_command, edge_command, end, last_line
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import Poses
from e3pose_lab.reproduce.relay import relay

START_S = 240.0  # an edge that never ran on this machine compiles first
LOOK_S = 0.05
NEWEST = 16  # slots


@dataclass(eq=False)
class SiteRun:
    """A running site.

    Attributes:
        programs: the edge, then the cameras in the order of the rig.
        follower: what the edge says.
        slots: number of every published slot, with the time at which it came, monotonic seconds,
            the cameras that were selected for it and those whose views came in time.
        newest: the latest of what was published.
        ask: asks a program of the site, see `Transport.ask`.
    """

    programs: list[Program]
    follower: Follower
    slots: dict[int, tuple[float, int, int]] = field(default_factory=dict)
    newest: deque[Poses] = field(default_factory=lambda: deque(maxlen=NEWEST))
    ask: Callable[[str, bytes, float], bytes | None] = lambda topic, payload, timeout_s: None

    def pids(self) -> list[int]:
        """Return the process numbers of the edge and of the cameras."""
        return [program.process.pid for program in self.programs if program.process is not None]

    def wait(self, there: Callable[[], bool], seconds: float, what: str) -> None:
        """Wait for a condition.

        Raises:
            InputError: with the last words of all programs, when it takes too long or one ended.
        """
        end_s = time.monotonic() + seconds
        while not there():
            ended = [
                p.name for p in self.programs if p.process is not None and p.ended() is not None
            ]
            if ended or time.monotonic() > end_s:
                said = "; ".join(
                    f"{p.name}: {last_line(p.log)}" for p in self.programs if p.log.exists()
                )
                why = f"{', '.join(ended)} ended" if ended else f"not within {seconds:.0f} s"
                raise InputError(f"site: {why}: {said}; expected {what}")
            time.sleep(LOOK_S)

    def take(self, poses: Poses) -> None:
        """Take in a published slot; poses that are published again, smoothed, are skipped."""
        if poses.selected:
            came = (time.monotonic(), len(poses.selected), len(poses.arrived))
            self.slots.setdefault(poses.slot, came)
            self.newest.append(poses)

    def all_online(self) -> bool:
        """Return whether the edge sees every camera."""
        status = self.follower.status
        return status is not None and all(camera.online for camera in status.cameras)


@contextmanager
def running_site(
    folder: Path, rig: Rig, example: Example, round_trip_s: float = 0.0
) -> Iterator[SiteRun]:
    """Start a site and wait until the edge sees every camera; end it at the end.

    Args:
        folder: of the site; sources of the example are relative to it.
        rig: the cameras.
        example: what the site is made of.
        round_trip_s: what messages between cameras and edge take longer, there and back.

    Raises:
        InputError: with the last words of the programs, when the site does not run.
    """
    path = write_example(folder, example, rig)
    site = resolve_site(path)
    run = SiteRun(
        [Program("edge", edge_command(path), folder / "edge.log")], Follower(site.file.name)
    )
    with ExitStack() as stack:
        through = site
        if round_trip_s:
            port = site.file.link.endpoint.port
            near = stack.enter_context(relay(port, round_trip_s))
            link = replace(site.file.link, endpoint=Endpoint("tcp", "127.0.0.1", near))
            through = replace(site, file=replace(site.file, link=link))
        run.programs += [
            Program(camera_id, camera_command(through, camera_id), folder / f"{camera_id}.log")
            for camera_id in rig.camera_ids
        ]
        transport = open_network(viewer_link(site.file, None))
        stack.callback(transport.close)
        run.ask = transport.ask
        run.follower.listen(transport, run.take)
        stack.callback(end, run.programs)
        for program in run.programs:
            program.start()
        run.wait(run.all_online, START_S, "every camera online")
        yield run


@contextmanager
def site_folder() -> Iterator[Path]:
    """Yield a folder for a site, deleted at the end."""
    with tempfile.TemporaryDirectory(prefix="e3pose-site-") as name:
        yield Path(name)
