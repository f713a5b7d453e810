"""Run the demo from end to end: videos in, a live site, poses and a report out.

One process per camera and one for the edge, over loopback. Where the real clip or the network
cannot be fetched, the cameras play a simulated scene.
"""

from __future__ import annotations

import json
import math
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from e3pose.base.atomic import atomic_folder, check_free
from e3pose.base.errors import InputError
from e3pose.base.system import num_cores
from e3pose.camera.source import open_video
from e3pose.detectors import make_detector
from e3pose.detectors.weights import Progress, find_weights, is_installed, pull_weights
from e3pose.edge.reports import savings
from e3pose.energy.saving import NO_SAVINGS
from e3pose.evaluate.figures import Summary, as_json
from e3pose.evaluate.poses_table import write_poses
from e3pose.evaluate.summary import summarise
from e3pose.model.blind_slot import count_blind
from e3pose.model.skeleton import COCO18
from e3pose.output.report import write_report
from e3pose.recording import Recording, ViewSeries
from e3pose.recording.calibration import load_rig
from e3pose.settings.loop import ReplaySettings
from e3pose.settings.resolved import resolve_site
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.demo.clip import SOURCE, TITLE, Clip, fetch_clip, find_clip
from e3pose.site.demo.pictures import draw
from e3pose.site.demo.summary import (
    DemoReport,
    LiveFigures,
    about,
    delivery_words,
    latency_words,
    pace_words,
    processor_words,
)
from e3pose.site.example import STORE_FILE, Example, write_example, write_recorded

if TYPE_CHECKING:
    from e3pose.pipeline import SlotRecord
    from e3pose.site.demo.live import Heard, Show
    from e3pose.site.demo.stored_run import Film

T = TypeVar("T")

NETWORK = "openpose-thin"
FPS = 20.0  # slots per second of the scene: every third frame
NUM_SELECTED = 2
WARMUP_SLOTS = 10  # the loop's own default, in which every camera detects
STAND_IN_SLOTS = 150
READY_S, READY_DETECTIONS = 4.0, 20.0  # a camera imports, then loads and tries its network
SPARE = 0.55  # of the processor that detecting may take: the rest decodes, fuses, and is spare
DEADLINE_SLOTS = 2.5  # so that others who use the machine for a moment do no harm
TIMING_S, TIMING_DETECTIONS = 1.5, 5
MIN_DEADLINE_MS = 150.0

STAND_IN = SceneSettings(people=3, seconds=12.0, cameras=4)
ABOUT = "e3pose-demo.txt"  # says what the folder is, and marks it as one that may be replaced
MARKS = (ABOUT,)
SITE = "site"
COMMENT = (
    "The site of the demo. Run it again with `e3pose up site.toml`.\n"
    "Keys: docs/reference/site-file.md."
)

# Opens a phase of the work by its name, yields what to tell its progress to.
Phase = Callable[[str], AbstractContextManager[Progress]]
# Opens a view of the running site, yields what to tell its status to.
Watch = Callable[[], AbstractContextManager["Show"]]


@contextmanager
def silent(name: str) -> Iterator[Progress]:
    """Show nothing of a phase."""
    yield lambda done, total: None


@contextmanager
def unwatched() -> Iterator[Show]:
    """Show nothing of the running site."""
    yield lambda status, done, total: None


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The scene that the demo's site shows.

    Attributes:
        site_file: of the site that was written.
        recording: its cameras, and for a simulated scene its truth; its views are not used.
        film: what is played.
        num_slots: how long to run.
        alone_s: seconds of one detection on this machine without load; 0 if simulated.
    """

    site_file: Path
    recording: Recording
    film: Film
    num_slots: int
    alone_s: float = 0.0


def run_demo(
    dest: Path,
    *,
    offline: bool = False,
    overwrite: bool = False,
    phase: Phase = silent,
    watch: Watch = unwatched,
    stand_in: SceneSettings | None = None,
) -> DemoReport:
    """Run the job and leave its results in the folder `dest`, whole or not at all.

    Args:
        dest: folder to make.
        offline: download nothing; what earlier runs fetched is used.
        overwrite: replace what an earlier demo left at `dest`.
        phase: shows how far each part of the work is.
        watch: shows the site while it runs.
        stand_in: the scene to simulate where the clip cannot be had.

    Raises:
        InputError: when `dest` is taken by something else, or the site does not work.
    """
    from e3pose.site.demo.live import run_live
    from e3pose.site.demo.stored_run import stored_records

    began = time.monotonic()
    check_free(dest, overwrite, MARKS)
    inputs, problems = _inputs(offline, phase)
    with atomic_folder(dest, overwrite, MARKS) as folder:
        if inputs is None:
            scene = _simulated(stand_in, folder / SITE, phase)
        else:
            scene = _filmed(*inputs, folder / SITE, phase)
        with watch() as show:
            ready_s = READY_S + READY_DETECTIONS * scene.alone_s
            round_s = scene.film.length_s / scene.film.pace
            heard = run_live(
                scene.site_file, scene.recording.rig, scene.num_slots, round_s, ready_s, show
            )
            film = replace(scene.film, begin_ns=heard.begin_ns)
        with phase("writing the results") as progress:
            store = folder / SITE / STORE_FILE
            records, times, charged_j = stored_records(
                store, scene.recording.interval_s, film, scene.num_slots
            )
            figures = _figures(scene, heard, records, inputs)
            summary = _write_results(
                scene,
                heard,
                records,
                charged_j,
                film.moments(heard, records, times),
                figures,
                folder,
                progress,
            )
        report = DemoReport(
            dest=dest,
            real=inputs is not None,
            not_fetched=tuple(problems),
            num_cameras=len(scene.recording.rig),
            network=NETWORK,
            people=_mean_people(records),
            live=figures,
            summary=summary,
            seconds=time.monotonic() - began,
        )
        (folder / ABOUT).write_text(about(report, folder), encoding="utf-8")
    return report


def _inputs(offline: bool, phase: Phase) -> tuple[tuple[Clip, Path] | None, list[str]]:
    """Get the clip and the network, or None with the missing files and the reason."""
    clip, weights, problems = find_clip(), None, []
    try:
        clip = clip or _fetched("the four-camera recording", fetch_clip, offline, phase)
    except InputError as error:
        problems.append(f"the four-camera recording: {error}.")
    try:
        if is_installed(NETWORK):
            weights = find_weights(NETWORK)
        else:
            pull = partial(pull_weights, NETWORK)
            weights = _fetched(f"the network {NETWORK}", pull, offline, phase)
    except InputError as error:
        problems.append(f"the network {NETWORK}: {error}.")
    if clip is None or weights is None:
        return None, problems
    return (clip, weights), problems


def _fetched(name: str, fetch: Callable[[Progress], T], offline: bool, phase: Phase) -> T:
    if offline:
        raise InputError("not in the cache, and this run is offline")
    with phase(f"downloading {name}") as progress:
        return fetch(progress)


def _filmed(clip: Clip, weights: Path, folder: Path, phase: Phase) -> Scene:
    """Write a site whose cameras play the clip, as fast as this machine can detect."""
    from e3pose.site.demo.stored_run import Film

    rig = load_rig(clip.calibration)
    (folder / "videos").mkdir(parents=True)
    for video in clip.videos:
        shutil.copyfile(video, folder / "videos" / video.name)
    videos = {i: v.name for i, v in zip(rig.camera_ids, clip.videos, strict=True)}
    with phase("timing the network"):
        alone_s = _alone_s(clip.videos[0], weights)
    pace = pace_for(alone_s, len(rig), FPS, num_cores())
    source = open_video(clip.videos[0])
    film = Film(source.num_frames / source.rate, pace)
    example = Example(
        name="demo",
        sources={i: f"videos/{name}" for i, name in videos.items()},
        fps=FPS,
        skeleton=COCO18.name,
        cameras=min(NUM_SELECTED, len(rig)),
        pace=pace,
        deadline_ms=max(MIN_DEADLINE_MS, round(1000 * DEADLINE_SLOTS / FPS / pace)),
        camera={"detector": NETWORK, "threads": 1, "meter": "model"},
        comment=COMMENT,
    )
    nothing = ViewSeries.from_views([], [], [], len(COCO18))
    recording = Recording(
        name=TITLE,
        rig=rig,
        fps=FPS,
        num_slots=round(film.length_s * FPS),
        skeleton=COCO18,
        views=(nothing,) * len(rig),
        videos=videos,
        source=SOURCE,
    )
    return Scene(write_example(folder, example, rig), recording, film, recording.num_slots, alone_s)


def _alone_s(video: Path, weights: Path) -> float:
    """Return the seconds of a detection on one thread of this machine."""
    detector = make_detector(NETWORK, weights, "cpu", 1)
    image = next(iter(open_video(video).frames(0.0))).image
    detector.detect(image)  # the first detection is slow
    began, detections = time.perf_counter(), 0
    while detections < TIMING_DETECTIONS or time.perf_counter() - began < TIMING_S:
        detector.detect(image)
        detections += 1
    return (time.perf_counter() - began) / detections


def pace_for(alone_s: float, num_cameras: int, fps: float, cores: int) -> float:
    """Return the pace at which a machine can detect in all cameras; 1 at most.

    Args:
        alone_s: seconds of one detection on one core.
        num_cameras: that are active in every slot.
        fps: slots per second of the scene.
        cores: that they share.
    """
    pace = SPARE * cores / (num_cameras * fps * alone_s)
    return 1.0 if pace >= 1 else max(0.01, float(f"{pace:.2g}"))


def _simulated(stand_in: SceneSettings | None, folder: Path, phase: Phase) -> Scene:
    from e3pose.site.demo.stored_run import Film

    scene = stand_in or STAND_IN
    with phase("simulating a scene") as progress:
        recording = simulate(scene, 0, lambda share: progress(round(100 * share), 100))
    site_file = write_recorded(folder, recording, "demo")
    film = Film(recording.num_slots * recording.interval_s, 1.0)
    return Scene(site_file, recording, film, min(STAND_IN_SLOTS, recording.num_slots))


def _figures(
    scene: Scene, heard: Heard, records: Sequence[SlotRecord], inputs: tuple[Clip, Path] | None
) -> LiveFigures:
    status = heard.status
    played_s = len(records) * scene.recording.interval_s
    video_bytes = 0.0
    if inputs is not None:
        whole = sum(video.stat().st_size for video in inputs[0].videos)
        video_bytes = whole * played_s / scene.film.length_s
    return LiveFigures(
        pace=scene.film.pace,
        alone_ms=1000 * scene.alone_s,
        cores=num_cores(),
        lead_slots=0 if status is None else status.lead,
        orders=sum(beat.orders for beat in heard.beats.values()),
        late_orders=sum(beat.late_orders for beat in heard.beats.values()),
        views=len(heard.views),
        late_views=0 if status is None else sum(camera.late for camera in status.cameras),
        slots_lost=0 if status is None else status.slots_lost,
        view_bytes=sum(heard.sent_bytes.values()),
        order_bytes=heard.order_bytes,
        video_bytes=round(video_bytes),
        fuse_ms=(0.0, 0.0) if status is None else status.latency_ms,
        delay_ms=1000 * float(np.median(heard.delays_s)) if heard.delays_s else 0.0,
        blind=count_blind(records),
        selected=_mean_selected(records),
        **_processor(heard),
    )


def _processor(heard: Heard) -> dict[str, Any]:
    """Return the measured processor time of a look and of a frame, mean over the cameras."""
    beats = list(heard.beats.values())
    cpu_s = sum(beat.cpu_s or 0.0 for beat in beats)
    look_cpu_s = sum(beat.look_cpu_s for beat in beats)
    looks, frames = (sum(getattr(b, name) for b in beats) for name in ("detected", "captured"))
    return {
        "look_cpu_ms": 1e3 * look_cpu_s / max(looks, 1),
        "frame_cpu_ms": 1e3 * (cpu_s - look_cpu_s) / max(frames, 1),
    }


def _mean_selected(records: Sequence[SlotRecord]) -> float:
    """Return the cameras per slot after the warm-up; NaN before its end."""
    later = [r.selected.sum() for r in records if r.slot >= WARMUP_SLOTS and not r.blind]
    return float(np.mean(later)) if later else math.nan


def _mean_people(records: Sequence[SlotRecord]) -> float:
    return float(np.mean([len(record.people) for record in records])) if records else 0.0


def _write_results(
    scene: Scene,
    heard: Heard,
    records: Sequence[SlotRecord],
    charged_j: NDArray[np.float64] | None,
    moments_s: NDArray[np.float64],
    figures: LiveFigures,
    folder: Path,
    progress: Progress,
) -> Summary:
    """Write tables, figures, the page and the pictures; return the figures."""
    from e3pose.site.demo.stored_run import as_recording

    recording = as_recording(scene.recording, heard, moments_s)
    plan = resolve_site(scene.site_file).plan
    settings = ReplaySettings(
        pipeline="default",
        num_selected=min(NUM_SELECTED, len(recording.rig)),
        lead_slots=max(1, figures.lead_slots),
        warmup_slots=WARMUP_SLOTS,
    )
    pace = pace_words(figures, len(recording.rig))
    notes = (*pace, *processor_words(figures), *delivery_words(figures))
    summary = summarise(
        recording,
        settings,
        records,
        plan.profiles,
        idle_mode=plan.idle_mode,
        battery_wh=plan.battery_wh,
        charged_j=charged_j,
    )
    live = NO_SAVINGS if heard.status is None else savings(heard.status)
    both = replace(summary.savings, processor_time=live.processor_time)
    summary = replace(summary, notes=notes, savings=both)
    for name in ("poses.parquet", "poses.csv"):
        write_poses(records, recording.skeleton, folder / name)
    table = as_json(summary, live=asdict(figures))
    (folder / "summary.json").write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")
    details = {"latency": latency_words(figures)}
    write_report(recording, records, summary, folder / "report.html", details=details)
    draw(recording, records, moments_s, folder, folder / SITE, progress)
    return summary
