"""A live site whose cameras detect in real videos: its work, and its 3D poses over their images."""

from __future__ import annotations

import base64
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from e3pose.model.camera import Rig
from e3pose.model.skeleton import COCO18
from e3pose.recording.calibration import load_rig
from e3pose.site.demo_clip import find_clip
from e3pose.site.example import Example
from e3pose.wire import topics
from e3pose.wire.arrays import unpack
from e3pose.wire.codec import decode, encode
from e3pose.wire.site_messages import Picture, PictureQuestion
from e3pose_lab.reproduce.scene import Limbs, limbs_of
from e3pose_lab.reproduce.site_run import SiteRun, running_site, site_folder
from e3pose_lab.reproduce.sources import NETWORK, Sources

# The clip is played so slowly that four networks keep up on two busy cores: a slot of 1/20 s takes
# 2 s.
FPS, PACE = 20.0, 0.025
DEADLINE_MS = 1800.0
BEGIN_SLOTS = 12  # in which all cameras are on, and buffers fill: not counted
WAIT_S = 120.0
ASK_S = 5.0


@dataclass(frozen=True, slots=True)
class LiveAsked:
    """Which site to run.

    Attributes:
        policy: who selects.
        feedback: whether cameras are told who is expected.
        selected: cameras per slot of policies that select.
        slots: to count.
        pictures: whether to keep the images of a slot.
    """

    policy: str
    feedback: bool = False
    selected: int = 3
    slots: int = 30
    pictures: bool = False


@dataclass(frozen=True, slots=True)
class OverImage:
    """Image of a camera in a slot, with the 3D poses of that slot projected into it.

    Attributes:
        camera: its name.
        jpeg: of the image, base64.
        image_size: `(width, height)` in pixels.
        people: in the image, pixels `u0 v0 u1 v1` of each limb; in one order in all images, without
            limbs where somebody is not in that slot.
    """

    camera: str
    jpeg: str
    image_size: tuple[int, int]
    people: list[Limbs]


@dataclass(frozen=True, slots=True)
class LiveFigures:
    """Figures of a site, means per slot.

    Attributes:
        cameras_s: processor seconds of all cameras together.
        edge_s: of the edge.
        selected: cameras that were on.
        arrived: of these, whose views came in time.
        people: who were published.
        views: images with what was published; empty where nobody asked for them.
    """

    cameras_s: float
    edge_s: float
    selected: float
    arrived: float
    people: float
    views: list[OverImage]


def live_video(sources: Sources, asked: LiveAsked) -> LiveFigures:
    """Run a site of one edge and a camera per video, and measure its processes."""
    clip = find_clip()
    assert clip is not None, "items say what they need"
    rig = load_rig(clip.calibration)
    with site_folder() as folder:
        example = Example(
            name="live-video",
            sources=dict(zip(rig.camera_ids, map(str, clip.videos), strict=True)),
            fps=FPS,
            pace=PACE,
            skeleton=COCO18.name,
            cameras=asked.selected,
            camera={"detector": NETWORK, "threads": 1},
            loop={"pipeline": "paper", "policy": asked.policy, "feedback": asked.feedback},
            deadline_ms=DEADLINE_MS,
        )
        with running_site(folder, rig, example) as run:
            run.wait(lambda: len(run.slots) >= BEGIN_SLOTS, WAIT_S, f"{BEGIN_SLOTS} slots")
            return _measured(run, rig, asked)


def _measured(run: SiteRun, rig: Rig, asked: LiveAsked) -> LiveFigures:
    import psutil

    edge, *cameras = (psutil.Process(pid) for pid in run.pids())
    first = set(run.slots)
    before = [_spent_s([edge]), _spent_s(cameras)]
    wanted = len(first) + asked.slots
    run.wait(lambda: len(run.slots) >= wanted, WAIT_S + 2 * asked.slots, f"{asked.slots} slots")
    after = [_spent_s([edge]), _spent_s(cameras)]
    slots = [slot for slot in list(run.slots) if slot not in first]
    people = [len(unpack(poses.track_ids)) for poses in list(run.newest)]
    edge_s, cameras_s = (
        (end - begin) / len(slots) for begin, end in zip(before, after, strict=True)
    )
    return LiveFigures(
        cameras_s,
        edge_s,
        statistics.fmean(run.slots[slot][1] for slot in slots),
        statistics.fmean(run.slots[slot][2] for slot in slots),
        statistics.fmean(people) if people else 0.0,
        _views(run, rig) if asked.pictures else [],
    )


def _spent_s(processes: Sequence[Any]) -> float:
    return sum(sum(process.cpu_times()[:2]) for process in processes)


def _views(run: SiteRun, rig: Rig) -> list[OverImage]:
    """Return the newest image of each camera with the poses of its slot."""
    found = []
    order: dict[int, int] = {}  # of tracks
    for camera in rig.cameras:
        end_s = time.monotonic() + WAIT_S
        while time.monotonic() < end_s:
            picture = _picture(run, camera.camera_id)
            shown = [p for p in list(run.newest) if picture is not None and p.slot == picture.slot]
            if picture is not None and shown and len(unpack(shown[0].track_ids)):
                pixels = camera.project(unpack(shown[0].joints_m).astype(np.float64))
                jpeg = base64.b64encode(picture.jpeg).decode("ascii")
                track_ids = unpack(shown[0].track_ids).tolist()
                for track_id in track_ids:
                    order.setdefault(track_id, len(order))
                people: list[Limbs] = [[] for _ in order]
                for track_id, limbs in zip(track_ids, limbs_of(pixels, COCO18.limbs), strict=True):
                    people[order[track_id]] = limbs
                found.append(OverImage(camera.camera_id, jpeg, picture.image_size, people))
                break
            time.sleep(0.2)
    return found


def _picture(run: SiteRun, camera_id: str) -> Picture | None:
    """Return the newest image in which a camera detected; None without one."""
    topic = topics.of_camera(run.follower.site, camera_id, "picture")
    answer = run.ask(topic, encode(PictureQuestion(large=True)), ASK_S)
    picture = None if answer is None else decode(answer, Picture, camera_id)
    return picture if picture is not None and picture.jpeg else None
