"""Memory of a site's processes by number of people."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from e3pose.output.report.overlay import write_movie
from e3pose.recording import Recording, save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.films import frames
from e3pose.site.example import Example
from e3pose_lab.reproduce.site_run import SiteRun, running_site, site_folder
from e3pose_lab.reproduce.sources import Sources

FPS = 10.0
SCENE_S = 6.0
# A camera that plays keypoints holds all of them. So few people move for longer, and every camera
# holds as many poses: else memory would rise with what is played, not with what is done with it.
PLAYED_S = 60.0  # of one person
KEYPOINTS = "keypoints"  # cameras that play recorded keypoints, without pixels
# Cameras with a network detect in films, seldom enough for five of them on two cores.
NETWORK_FPS, FILM_SIZE = 1.0, (640, 480)
BEGIN_S = 3.0  # in which buffers fill: not counted
BEGIN_SLOTS = 14  # with all cameras, until selection counts: likewise
SLOTS_S = 60.0  # for which slots are waited for, at most
EVERY_S = 0.25


@dataclass(frozen=True, slots=True)
class MemoryAsked:
    """Which site to run.

    Attributes:
        policy: who selects.
        people: in the scene.
        detector: of the cameras, which detect in films; `KEYPOINTS` for recorded keypoints.
        cameras: of the site.
        selected: the paper's C.
        seconds: to count for.
    """

    policy: str
    people: int
    detector: str = KEYPOINTS
    cameras: int = 5
    selected: int = 3
    seconds: float = 5.0

    @property
    def fps(self) -> float:
        """Slots per second."""
        return FPS if self.detector == KEYPOINTS else NETWORK_FPS


@dataclass(frozen=True, slots=True)
class Memory:
    """Megabytes that processes hold, medians over time.

    Attributes:
        edge_rss: of the edge: resident.
        edge_pss: its share, where pages that several processes use are divided among them; equal
            to `edge_rss` where the system does not say.
        camera_rss: of a camera, the mean of all.
        camera_pss: likewise.
        people: tracked by the edge, the mean of the last published statuses.
        selected: cameras per slot, the mean.
    """

    edge_rss: float
    edge_pss: float
    camera_rss: float
    camera_pss: float
    people: float
    selected: float


def site_memory(sources: Sources, asked: MemoryAsked) -> Memory:
    """Run a site of one edge and its cameras, and measure the processes."""
    with_pixels = asked.detector != KEYPOINTS
    seconds = SCENE_S if with_pixels else PLAYED_S / asked.people
    usual = SceneSettings("crowd", asked.people, seconds, asked.fps, asked.cameras)
    recording = simulate(replace(usual, image_size=FILM_SIZE) if with_pixels else usual, 1)
    with site_folder() as folder:
        example = Example(
            name="memory",
            sources=_sources(folder, recording, asked),
            fps=asked.fps,
            skeleton=recording.skeleton.name,
            cameras=asked.selected,
            camera={"detector": asked.detector, "threads": 1} if with_pixels else {},
            loop={"pipeline": "paper", "policy": asked.policy},
            deadline_ms=500.0,
        )
        with running_site(folder, recording.rig, example) as run:
            begin = max(BEGIN_SLOTS, round(BEGIN_S * asked.fps))
            run.wait(lambda: len(run.slots) >= begin, SLOTS_S, f"{begin} slots")
            return _measured(run, asked.seconds)


def _sources(folder: Path, recording: Recording, asked: MemoryAsked) -> dict[str, str]:
    ids = recording.rig.camera_ids
    if asked.detector == KEYPOINTS:
        save_recording(recording, folder / "recording")
        return dict.fromkeys(ids, "recorded:recording")
    for index, camera_id in enumerate(ids):
        write_movie(folder / f"{camera_id}.mp4", frames(recording, index), asked.fps)
    return {camera_id: f"{camera_id}.mp4" for camera_id in ids}


def _measured(run: SiteRun, seconds: float) -> Memory:
    import psutil

    edge, *cameras = (psutil.Process(pid) for pid in run.pids())
    first = set(run.slots)
    samples: list[tuple[float, float, float, float, int]] = []
    end_s = time.monotonic() + seconds
    while not samples or time.monotonic() < end_s:
        each = [_megabytes(camera) for camera in cameras]
        status = run.follower.status
        samples.append(
            (
                *_megabytes(edge),
                statistics.fmean(rss for rss, _ in each),
                statistics.fmean(pss for _, pss in each),
                0 if status is None else status.people,
            )
        )
        time.sleep(EVERY_S)
    columns = list(zip(*samples, strict=True))
    edge_rss, edge_pss, camera_rss, camera_pss = (statistics.median(c) for c in columns[:4])
    selected = [count for slot, (_, count, _) in run.slots.items() if slot not in first]
    return Memory(
        edge_rss,
        edge_pss,
        camera_rss,
        camera_pss,
        people=statistics.fmean(columns[4]),
        selected=statistics.fmean(selected) if selected else 0.0,
    )


def _megabytes(process: Any) -> tuple[float, float]:
    """Return the resident memory of a process and its share of it."""
    info = process.memory_full_info()
    return info.rss / 1e6, getattr(info, "pss", info.rss) / 1e6
