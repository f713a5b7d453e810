"""A live site on this machine: latency, orders, CPU of the edge, bytes, how many cameras it bears.

    python lab/benchmarks/bench_live.py                      # 20 s for each row
    python lab/benchmarks/bench_live.py --seconds 600 --cameras 5

Cameras replay simulated detections over mutual TLS on loopback, one process each; the edge runs the
whole loop with the store. Cameras share the machine's cores with the edge.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from e3pose.evaluate.replay import ReplaySettings, make_pipeline, selected_views
from e3pose.pipeline import initial_state, step
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.demo_clip import find_clip
from e3pose.wire.arrays import pack
from e3pose.wire.codec import encode
from e3pose.wire.messages import View
from live_site import Site, live_site, traffic

PEOPLE, FPS = 4, 25.0
JPEG_QUALITY = 75
PAUSE_S = 0.036
STEP_S = 10.0  # of a scene, for the step by itself
TARGET_CPU = 0.10  # of a core, at 5 cameras and 25 slots per second


def row(cameras: int, seconds: float) -> dict[str, float]:
    """Run one site and return its figures."""
    with live_site(cameras, PEOPLE, FPS, loop=f"cameras = {max(1, round(cameras * 0.4))}") as site:
        before = traffic()
        status = site.follower.status
        assert status is not None
        slot, lost, begun_s = status.slot, status.slots_lost, status.uptime_s
        orders, late_orders = orders_told(site)
        machine = bare_loop(seconds)
        status = site.follower.status
        assert status is not None
        slots = status.slot - slot
        figures = {
            "cameras": cameras,
            "slots_a_second": slots / (status.uptime_s - begun_s),
            "slots_lost": status.slots_lost - lost,
            "step_ms_p50": status.step_ms[0],
            "step_ms_p99": status.step_ms[1],
            "latency_ms_p50": status.latency_ms[0],
            "latency_ms_p99": status.latency_ms[1],
            "edge_cpu_share": site.edge_cpu_share(),
            **{f"cpu of {part}": share for part, share in site.cpu_by_part().items()},
            "orders": orders_told(site)[0] - orders,
            "orders_late": orders_told(site)[1] - late_orders,
            "views_late_or_lost": sum(c.late + c.lost for c in status.cameras),
            "lead_slots": status.lead,
            "loopback_bytes_a_slot": (traffic() - before) / max(slots, 1),
            "edge_rss_mb": site.sample().edge_rss / 1e6,
            "bare_loop_ms_p50": machine[0],
            "bare_loop_ms_p99": machine[1],
            "bare_wake_ms_p99": machine[2],
        }
    return figures


def orders_told(site: Site) -> tuple[float, float]:
    """Return how many orders came to the cameras so far, and how many of them too late."""
    return site.metric("e3pose_camera_orders"), site.metric("e3pose_camera_late_orders")


def bare_loop(seconds: float) -> tuple[float, float, float]:
    """Return how long a few milliseconds of plain Python take here, and how late sleep ends.

    What happens to a program that does nothing else is the machine's doing: no latency beside it
    can be better.

    Returns:
        Median and 99th percentile of the work, 99th percentile of the lateness, milliseconds.
    """
    work_s, late_s = [], []
    end_s = time.perf_counter() + seconds
    while time.perf_counter() < end_s:
        begun_s = time.perf_counter()
        time.sleep(PAUSE_S)
        woken_s = time.perf_counter()
        sum(number * number for number in range(30_000))
        work_s.append(time.perf_counter() - woken_s)
        late_s.append(woken_s - begun_s - PAUSE_S)
    median, high = np.quantile(work_s, [0.5, 0.99]) * 1e3
    return float(median), float(high), float(np.quantile(late_s, 0.99) * 1e3)


def step_alone(cameras: int) -> tuple[float, float]:
    """Measure the step of the loop by itself, without an edge around it.

    Between two slots of a live edge other programs use the caches, the table of pages and the
    branch predictor. The same work takes longer after a pause, and no profile of a replay shows it.

    Returns:
        Median CPU of a step in ms, back to back and each after a pause of `PAUSE_S`.
    """
    scene = SceneSettings("ring", people=PEOPLE, seconds=STEP_S, fps=FPS, cameras=cameras)
    recording = simulate(scene, seed=1)
    settings = ReplaySettings(num_selected=max(1, round(cameras * 0.4)), lead_slots=4)
    pipeline, online = make_pipeline(recording, settings, time.perf_counter), np.ones(cameras, bool)
    found: list[float] = []
    for pause_s in (0.0, 0.0, PAUSE_S):  # the first turn compiles
        state, spent_s = initial_state(pipeline), []
        for slot in range(recording.num_slots):
            views = selected_views(recording, slot, state.selections[0])
            time.sleep(pause_s)
            begun_s = time.thread_time()
            state, _ = step(pipeline, state, views, online)
            spent_s.append(time.thread_time() - begun_s)
        found.append(1e3 * float(np.median(spent_s[settings.warmup_slots :])))
    return found[1], found[2]


def view_bytes() -> int:
    """Return the bytes of what a camera sends in a slot."""
    view = View(
        "cam1", 1, 1, 1, pack(np.zeros((PEOPLE, 17, 2), np.float32)),
        pack(np.ones((PEOPLE, 17), np.float32)),
    )  # fmt: skip
    return len(encode(view))


def jpeg_bytes(video: Path) -> int:
    """Return the median bytes of a frame of a video as a JPEG."""
    import cv2

    from e3pose.camera.source import open_video

    quality = [int(cv2.IMWRITE_JPEG_QUALITY), JPEG_QUALITY]
    sizes = [
        len(cv2.imencode(".jpg", cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR), quality)[1])
        for frame in open_video(video)
        if frame.index % 10 == 0
    ]
    return int(np.median(sizes))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each row")
    parser.add_argument("--cameras", type=int, nargs="+", default=[5, 12, 28])
    options = parser.parse_args()
    for cameras in options.cameras:
        figures = row(cameras, options.seconds)
        print(
            f"{cameras} cameras x {PEOPLE} people, {options.seconds:g} s over TLS: "
            f"{figures['slots_a_second']:.1f} slots per second, {figures['slots_lost']:.0f} lost; "
            f"last view to poses {figures['latency_ms_p50']:.2f} ms, p99 "
            f"{figures['latency_ms_p99']:.2f}; step {figures['step_ms_p50']:.2f} ms, p99 "
            f"{figures['step_ms_p99']:.2f}; edge uses {figures['edge_cpu_share']:.0%} of a core, "
            f"{figures['edge_rss_mb']:.0f} MB; {figures['views_late_or_lost']:.0f} views late or "
            f"lost; {figures['orders_late']:.0f} of {figures['orders']:.0f} orders late; "
            f"{figures['loopback_bytes_a_slot'] / 1e3:.1f} kB per slot over the loopback; lead "
            f"{figures['lead_slots']:.0f}; {1 / figures['edge_cpu_share']:.0f} such "
            f"sites a core; beside it a bare loop of {figures['bare_loop_ms_p50']:.1f} ms has p99 "
            f"{figures['bare_loop_ms_p99']:.1f}, and wakes up to {figures['bare_wake_ms_p99']:.1f} "
            "late",
            flush=True,
        )
        shares = {
            n.removeprefix("cpu of "): v for n, v in figures.items() if n.startswith("cpu of")
        }
        total = figures["edge_cpu_share"]
        print(
            f"  of a core, {total:.1%} (target {TARGET_CPU:.0%} at 5 cameras): "
            + ", ".join(f"{part} {share:.1%}" for part, share in shares.items()),
            flush=True,
        )
        warm_ms, cold_ms = step_alone(cameras)
        per_slot = FPS / 1e3
        print(
            f"  the step by itself: {warm_ms:.2f} ms of CPU back to back, {cold_ms:.2f} after "
            f"pauses of {1e3 * PAUSE_S:.0f} ms; of a core {warm_ms * per_slot:.1%}, and "
            f"{(cold_ms - warm_ms) * per_slot:.1%} for cold caches",
            flush=True,
        )
    sent = view_bytes()
    print(f"a view of {PEOPLE} people is {sent} bytes", end="")
    clip = find_clip()
    if clip is not None:
        jpeg = jpeg_bytes(clip.videos[0])
        print(
            f"; a frame of {clip.videos[0].name} as a JPEG {jpeg}: {jpeg / sent:.0f} times", end=""
        )
    print()


if __name__ == "__main__":
    main()
