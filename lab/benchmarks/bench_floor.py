"""The least CPU that a live edge can take here: its messages, and the step after a pause.

    python lab/benchmarks/bench_floor.py

Processes send what cameras send, over mutual TLS on loopback: a view in the slots in which they are
selected, and two heartbeats per second. A program in place of the edge decodes it, and sends an
order to each camera and the poses in every slot; first this alone, then with the step of the loop
on views of a recording. It has no slots that close, no store, no status, no state to keep.
"""

from __future__ import annotations

import argparse
import datetime
import multiprocessing
import socket
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from e3pose.evaluate.replay import ReplaySettings, make_pipeline, selected_views
from e3pose.pipeline import initial_state, step
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.wire import topics
from e3pose.wire.access import Link
from e3pose.wire.arrays import pack, poses_2d
from e3pose.wire.codec import decode, encode
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in, init_keys, read_roll
from e3pose.wire.messages import Heartbeat, Order, View
from e3pose.wire.network import NetworkTransport, open_network
from e3pose.wire.site_messages import Poses

SITE, FPS, PEOPLE, JOINTS = "floor", 25.0, 4, 17
SELECTED = 0.4  # share of the cameras in a slot


def next_slot() -> int:
    """Sleep until the next slot begins, and return it."""
    slot = int(time.time() * FPS) + 1
    time.sleep(max(0.0, slot / FPS - time.time()))
    return slot


def be_camera(folder: Path, endpoint: str, index: int, num_cameras: int) -> None:
    """Send what a camera sends, until ended."""
    camera_id = f"cam{index}"
    certificates = certificates_in(folder / "cameras" / camera_id, "camera")
    transport = open_network(Link("camera", SITE, read_endpoint(endpoint), certificates))
    transport.subscribe(topics.of_order(SITE, camera_id), lambda topic, payload: None)
    view, beat = (topics.of_camera(SITE, camera_id, what) for what in ("view", "heartbeat"))
    keypoints_px = pack(np.zeros((PEOPLE, JOINTS, 2), np.float32))
    scores = pack(np.ones((PEOPLE, JOINTS), np.float32))
    selected = round(SELECTED * num_cameras)
    while True:
        slot = next_slot()
        if (slot * selected + index) % num_cameras < selected:
            transport.publish(view, encode(View(camera_id, 1, slot, 1, keypoints_px, scores)))
        if (slot + index) % round(FPS / 2) == 0:
            transport.publish(beat, encode(Heartbeat(camera_id, 1, 1, "active")))


def measured(work: Callable[[], None], seconds: float) -> float:
    """Return the share of a core of all threads while `work` is done at the end of each slot."""
    next_slot()
    begun_s, cpu_s = time.perf_counter(), time.process_time()
    while time.perf_counter() - begun_s < seconds:
        next_slot()
        time.sleep(0.3 / FPS)  # the views have come
        work()
    return (time.process_time() - cpu_s) / (time.perf_counter() - begun_s)


def one_step_a_slot(recording: Recording) -> Callable[[], None]:
    """Make a function that runs one slot of a recording, which begins again at its end."""
    settings = ReplaySettings(num_selected=round(SELECTED * len(recording.rig)), lead_slots=4)
    pipeline = make_pipeline(recording, settings, time.perf_counter)
    online = np.ones(len(recording.rig), bool)
    state = initial_state(pipeline)

    def advance() -> None:
        nonlocal state
        if state.slot == recording.num_slots:
            state = initial_state(pipeline)
        views = selected_views(recording, state.slot, state.selections[0])
        state, _ = step(pipeline, state, views, online)

    for _ in range(recording.num_slots):  # compiles
        advance()
    return advance


def open_edge(folder: Path, num_cameras: int) -> tuple[NetworkTransport, str, list[float]]:
    """Return the transport of an edge that decodes what comes, its endpoint, and when beats came.

    Args:
        folder: of the keys, made here.
        num_cameras: that may join.
    """
    now = datetime.datetime.now(datetime.timezone.utc)
    init_keys(folder, SITE, [], now)
    for index in range(num_cameras):
        add_keys(folder, f"cam{index}", now)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tls/127.0.0.1:{probe.getsockname()[1]}"
    link = Link("edge", SITE, read_endpoint(endpoint), certificates_in(folder, "edge"))
    transport, beats_s = open_network(link, read_roll(folder)), []

    def take_view(topic: str, payload: bytes) -> None:
        poses_2d(decode(payload, View, "camera"))

    def take_beat(topic: str, payload: bytes) -> None:
        decode(payload, Heartbeat, "camera")
        beats_s.append(time.monotonic())

    for what, take in (("view", take_view), ("heartbeat", take_beat)):
        transport.subscribe(topics.of_camera(SITE, topics.ANY, what), take)
    return transport, endpoint, beats_s


def sender(transport: NetworkTransport, num_cameras: int) -> Callable[[], None]:
    """Make a function that sends the messages of a slot."""
    orders = [
        (topics.of_order(SITE, f"cam{i}"), Order(f"cam{i}", 1, True, "power-saving", 1, 1, 1, 1))
        for i in range(num_cameras)
    ]
    joints_m = np.zeros((PEOPLE, JOINTS, 3), np.float32)
    poses = Poses(
        1,
        1,
        (),
        pack(np.arange(PEOPLE)),
        pack(joints_m),
        pack(joints_m[..., 0]),
        pack(joints_m[..., 0] > 0),
    )

    def send() -> None:
        transport.publish(topics.of_site(SITE, "poses"), encode(poses))
        for topic, order in orders:
            transport.publish(topic, encode(order))

    return send


def main() -> None:
    """Print the shares of a core."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each figure")
    parser.add_argument("--cameras", type=int, default=5)
    options = parser.parse_args()
    scene = SceneSettings("ring", people=PEOPLE, seconds=8, fps=FPS, cameras=options.cameras)
    advance = one_step_a_slot(simulate(scene, seed=1))
    with tempfile.TemporaryDirectory(prefix="e3pose-floor-") as name:
        transport, endpoint, beats_s = open_edge(Path(name), options.cameras)
        send = sender(transport, options.cameras)

        def both() -> None:
            advance()
            send()

        spawn = multiprocessing.get_context("spawn")
        cameras = [
            spawn.Process(target=be_camera, args=(Path(name), endpoint, i, options.cameras))
            for i in range(options.cameras)
        ]
        for camera in cameras:
            camera.start()
        try:
            while len(beats_s) < 4 * options.cameras:  # two seconds of all of them
                time.sleep(0.1)
            messages, together = (measured(work, options.seconds) for work in (send, both))
        finally:
            for camera in cameras:
                camera.terminate()
                camera.join()
            transport.close()
    print(
        f"{options.cameras} cameras at {FPS:g} slots per second: the messages take {messages:.1%} "
        f"of a core, with the step {together:.1%}"
    )


if __name__ == "__main__":
    main()
