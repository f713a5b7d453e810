"""Frame rate against network and server delay, as in the paper's timeline figure.

Ours is the real thing: an edge and cameras as processes of their own, with the paper's policy and
predictor, whose messages are delayed by a relay. The others are emulated: with central control by
2D boxes every frame waits for a round trip and the server's decision; with distributed control
cameras decide alone. Detection takes a fixed time in all of them, and so do the 2D motion vectors
that both others need.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from e3pose.output.report.overlay import write_movie
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.films import frames
from e3pose.site.example import Example
from e3pose_lab.reproduce import emulated
from e3pose_lab.reproduce.emulated import DETECT_S, SERVER_S
from e3pose_lab.reproduce.site_run import running_site, site_folder
from e3pose_lab.reproduce.sources import Sources

FPS = 25.0
CAMERAS, SELECTED = 3, 2
SCENE = SceneSettings(
    "ring", people=2, seconds=4.0, fps=FPS, cameras=CAMERAS, image_size=(640, 480)
)
VECTORS_S = 0.002
DEADLINE_S = 0.3  # for the views of a slot, beyond the round trip
BEGIN_SLOTS = 25  # not counted
BEGIN_S = 60.0  # for which they are waited for, at most


@dataclass(frozen=True, slots=True)
class RatesAsked:
    """Delays of the network and the server.

    Attributes:
        round_trip_ms: of messages between a camera and the edge, beyond that of the loopback.
        slow_server: whether the server takes `SERVER_S` longer for a prediction or decision.
        seconds: to count for.
    """

    round_trip_ms: float
    slow_server: bool
    seconds: float


@dataclass(frozen=True, slots=True)
class Rates:
    """Frames per second of the three designs.

    Attributes:
        ours: slots for which every selected camera's view was in the poses.
        central: with a decision before every frame.
        distributed: with none.
        lead: slots ahead of which ours gave its orders at the end.
    """

    ours: float
    central: float
    distributed: float
    lead: int


def rates(sources: Sources, asked: RatesAsked) -> Rates:
    """Measure the three designs."""
    rate, lead = ours(asked)
    return Rates(rate, central_2d(asked), distributed(asked.seconds), lead)


def ours(asked: RatesAsked) -> tuple[float, int]:
    """Return the slots per second with all selected views, and the lead, of a site of processes."""
    recording, trip_s = simulate(SCENE, 1), asked.round_trip_ms / 1e3
    slow = {"predictor": f"{emulated.__name__}:{emulated.slow_published.__name__}"}
    with site_folder() as folder:
        for index, camera_id in enumerate(recording.rig.camera_ids):
            write_movie(folder / f"{camera_id}.mp4", frames(recording, index), FPS)
        example = Example(
            name="timeline",
            sources={camera_id: f"{camera_id}.mp4" for camera_id in recording.rig.camera_ids},
            fps=FPS,
            skeleton=recording.skeleton.name,
            cameras=SELECTED,
            camera={"detector": f"{emulated.__name__}:{emulated.SlowDetector.__name__}"},
            loop={"pipeline": "paper", "policy": "e3pose", **(slow if asked.slow_server else {})},
            deadline_ms=1e3 * (trip_s + DEADLINE_S),
        )
        with running_site(folder, recording.rig, example, trip_s) as run:
            run.wait(lambda: len(run.slots) >= BEGIN_SLOTS, BEGIN_S, f"{BEGIN_SLOTS} slots")
            begun_s = time.monotonic()
            time.sleep(asked.seconds)
            passed_s = time.monotonic() - begun_s
            whole = sum(
                came_s >= begun_s and arrived >= SELECTED
                for came_s, _, arrived in list(run.slots.values())
            )
            status = run.follower.status
            return whole / passed_s, 0 if status is None else status.lead


def central_2d(asked: RatesAsked) -> float:
    """Return the frames per second of cameras that wait for the decision of every frame."""
    decision_s = asked.round_trip_ms / 1e3 + SERVER_S * asked.slow_server
    return _frames_a_second(VECTORS_S + decision_s + DETECT_S, asked.seconds)


def distributed(seconds: float) -> float:
    """Return the frames per second of cameras that decide alone."""
    return _frames_a_second(VECTORS_S + DETECT_S, seconds)


def _frames_a_second(work_s: float, seconds: float) -> float:
    """Return the frames per second of a loop in which each takes `work_s`, or an interval."""
    count, begun_s = 0, time.monotonic()
    while time.monotonic() - begun_s < seconds:
        frame_s = time.monotonic()
        time.sleep(work_s)
        count += 1
        time.sleep(max(0.0, 1 / FPS - (time.monotonic() - frame_s)))
    return count / (time.monotonic() - begun_s)
