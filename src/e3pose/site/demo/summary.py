"""The summary of a demo: results, savings, files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from e3pose.model.blind_slot import blind_words

if TYPE_CHECKING:
    from e3pose.evaluate.figures import Summary

SLOWER = 3  # how much slower than life the movie plays; the clip lasts under two seconds
FILES = {
    "report.html": "open this first: 3D player, camera selection and energy",
    "overlay.webm": f"video with the 3D skeletons drawn on the frames, {SLOWER}x slow motion",
    "overlay.png": "four moments of it as one picture",
    "poses.parquet": "3D poses in metres (also poses.csv)",
    "summary.json": "all figures",
    "site": "the site itself: site.toml, store, logs; run it again with `e3pose up`",
}


@dataclass(frozen=True, slots=True)
class LiveFigures:
    """Figures measured while the site ran.

    Attributes:
        pace: seconds of the scene that passed in a second.
        alone_ms: of one detection on this machine without load; 0 if simulated.
        cores: it has.
        lead_slots: how many slots ahead orders were sent.
        orders: that came to cameras.
        late_orders: of those, that came after their slot had begun.
        views: that cameras sent.
        late_views: of those, that came after their slot was closed.
        slots_lost: slots that the edge gave up.
        view_bytes: of all views.
        order_bytes: of all orders.
        video_bytes: of the videos of the same time; 0 if simulated.
        fuse_ms: median and 99th percentile from a slot's last view to its poses.
        delay_ms: median from the middle of a slot until its poses were published.
        blind: blind slots by cause.
        selected: cameras per slot after the warm-up, without blind slots; NaN before its end.
        look_cpu_ms: measured processor time of one look, mean.
        frame_cpu_ms: of one frame, with all else that a camera program does, mean.
    """

    pace: float
    alone_ms: float
    cores: int
    lead_slots: int
    orders: int
    late_orders: int
    views: int
    late_views: int
    slots_lost: int
    view_bytes: int
    order_bytes: int
    video_bytes: int
    fuse_ms: tuple[float, float]
    delay_ms: float
    blind: Mapping[str, int]
    selected: float
    look_cpu_ms: float = 0.0
    frame_cpu_ms: float = 0.0


@dataclass(frozen=True, slots=True)
class DemoReport:
    """The results of the demo.

    Attributes:
        dest: the folder it left.
        real: whether it ran on the real clip.
        not_fetched: what could not be had and why, one line each.
        num_cameras: of the rig.
        network: which searched the frames for people.
        people: mean number of people in 3D per slot.
        live: what was measured while it ran.
        summary: the run's figures.
        seconds: it took in all.
    """

    dest: Path
    real: bool
    not_fetched: tuple[str, ...]
    num_cameras: int
    network: str
    people: float
    live: LiveFigures
    summary: Summary = field(repr=False)
    seconds: float


def printed_lines(report: DemoReport) -> list[str]:
    """Return the lines that the demo prints: its story, its savings, its files."""
    where = [f"  {report.dest / name}: {what}" for name, what in _files(report.dest).items()]
    return [*story(report), f"Finished in {report.seconds:.0f} s. Wrote:", *where]


def about(report: DemoReport, folder: Path) -> str:
    """Return the text to leave beside the results in `folder`."""
    where = [f"  {name}: {what}" for name, what in _files(folder).items()]
    return "\n".join(["Output of e3pose demo", "", *story(report), "", *where, ""])


def story(report: DemoReport) -> list[str]:
    """Describe the run and its savings, one or two sentences per line."""
    summary, live = report.summary, report.live
    settings, selection = summary.settings, summary.selection
    assert selection is not None, "a demo has slots"
    if report.real:
        did = [
            f"Ran a live site: an edge server and {report.num_cameras} camera processes that play "
            f"real videos and detect people with {report.network}.",
            *pace_words(live, report.num_cameras),
        ]
    else:
        did = [
            *(f"Could not download {problem}" for problem in report.not_fetched),
            f"Ran a live site on a simulated scene instead: an edge server and "
            f"{report.num_cameras} camera processes that play simulated detections.",
        ]
    return [
        *did,
        f"In {summary.slots} slots the edge selected cameras {_ahead(live.lead_slots)} and "
        "estimated the 3D poses from their views: all cameras in the first "
        f"{settings.warmup_slots} slots, then {_selected(live.selected)}"
        f"(goal: {settings.num_selected:g}).",
        f"On average {selection.mean_cameras:.1f} of {report.num_cameras} cameras were active. "
        f"{summary.savings.sentence()}.",
        *processor_words(live),
        *delivery_words(live),
        f"Found {report.people:.1f} people per slot on average. A new track is confirmed by three "
        "cameras or ten detections.",
        *_accuracy(summary),
    ]


def pace_words(live: LiveFigures, num_cameras: int) -> list[str]:
    """Say how fast the videos were played, and why not faster; nothing at full speed."""
    if live.pace == 1:
        return []
    return [
        f"Videos played at {live.pace:.2g}x speed: one detection takes {live.alone_ms:.0f} ms on "
        f"this machine, and {num_cameras} cameras share {live.cores} cores."
    ]


def processor_words(live: LiveFigures) -> list[str]:
    """Describe the processor time of a look and a frame; empty if unknown."""
    if not live.look_cpu_ms:
        return []
    return [
        f"Of processor time, a look took {live.look_cpu_ms:.0f} ms and a frame "
        f"{live.frame_cpu_ms:.1f} ms."
    ]


def _selected(mean: float) -> str:
    return "fewer " if math.isnan(mean) else f"{mean:.1f} per slot on average "


def _ahead(lead_slots: int) -> str:
    return "one slot ahead" if lead_slots == 1 else f"{lead_slots} slots ahead"


def delivery_words(live: LiveFigures) -> list[str]:
    """Say whether orders and views came in time, and how large they were."""
    in_time = live.orders - live.late_orders
    said = (
        f"Timing: {in_time} of {live.orders} orders and {live.views - live.late_views} of "
        f"{live.views} views arrived in time; {live.slots_lost} slots lost{_blind(live)}. Poses "
        f"are published {live.fuse_ms[0]:.1f} ms after the last view, median."
    )
    sizes = f"Network: {live.view_bytes / 1e3:.0f} kB of keypoints"
    if live.video_bytes:
        return [said, f"{sizes}; the same video is {live.video_bytes / 1e3:.0f} kB."]
    return [said, f"{sizes}, {live.order_bytes / 1e3:.0f} kB of orders."]


def _blind(live: LiveFigures) -> str:
    count = sum(live.blind.values())
    return f", {count} blind ({blind_words(live.blind)})" if count else ""


def latency_words(live: LiveFigures) -> str:
    """Say how long poses take after the last view, in detail."""
    return f"{live.fuse_ms[0]:.1f} ms after the last view, 99 %: {live.fuse_ms[1]:.1f} ms"


def _accuracy(summary: Summary) -> list[str]:
    error_mm = summary.metrics.mpjpe_mm
    if error_mm is None:
        return []
    return [f"Mean joint error against the simulated truth: {error_mm:.0f} mm."]


def _files(folder: Path) -> dict[str, str]:
    return {name: what for name, what in FILES.items() if (folder / name).exists()}
