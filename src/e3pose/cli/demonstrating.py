"""`e3pose demo`: `up` and `replay --report` on a real four-camera recording."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import numpy as np
from cyclopts import Parameter
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn

from e3pose.base.atomic import atomic_folder, check_free
from e3pose.base.errors import InputError
from e3pose.camera.detect import DetectSettings, detect_videos
from e3pose.cli.network import ready_network
from e3pose.cli.options import Flag, warn
from e3pose.cli.progress import bar, track_progress
from e3pose.cli.running_site import run_shown
from e3pose.detectors import AUTO, make_detector
from e3pose.edge.reports import savings
from e3pose.evaluate.figures import as_json
from e3pose.evaluate.poses_table import write_poses
from e3pose.evaluate.replay import replay
from e3pose.evaluate.summary import summarise
from e3pose.evaluate.tables import print_summary
from e3pose.model.slot_record import SlotRecord
from e3pose.output.report import write_report
from e3pose.output.report.overlay import overlay_images, write_movie
from e3pose.recording import Recording, load_recording, save_recording
from e3pose.recording.calibration import load_rig
from e3pose.settings.loop import ReplaySettings
from e3pose.settings.resolved import resolve_site
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.demo_clip import SOURCE, TITLE, fetch_clip, find_clip
from e3pose.site.detector_speed import measure_detections, suggested_fps
from e3pose.site.example import Example, write_example
from e3pose.site.simulated_films import write_films
from e3pose.site.up import last_line

if TYPE_CHECKING:
    from e3pose.detectors.weights import Progress
    from e3pose.wire.site_messages import Status

T = TypeVar("T")

STAND_IN_DETECTOR = "drawn"
STAND_IN = SceneSettings(people=3, seconds=6.0, cameras=4)
FPS = 20.0  # slots per second of the scene: every third frame of the clip
CAMERAS = 2.0  # active in each slot
DEADLINE_SLOTS, MIN_DEADLINE_MS = 2.5, 150.0  # so that others who use the machine do no harm
SLOWER = 3  # the movie is slow motion, for the clip lasts under two seconds
PANEL_PX = 560  # height of a camera's picture
ABOUT = "e3pose-demo.txt"  # says what the folder is, and marks it as one that may be replaced
FILES = {
    "report.html": "open this first: 3D player, camera selection and energy",
    "overlay.webm": "the 3D skeletons on the frames, slow: from all cameras, then from two",
    "poses.parquet": "3D poses in metres (also poses.csv)",
    "summary.json": "all figures",
    "recording": "videos and detections of all cameras, for `e3pose replay`",
    "site": "the live site: site.toml, store, logs; run it again with `e3pose up`",
}


def demo(
    dest: Path = Path("demo-output"),
    /,
    *,
    offline: Annotated[bool, Parameter(negative="", env_var="E3POSE_OFFLINE")] = False,
    overwrite: Flag = False,
) -> None:
    """Run a live site on real films; get 3D poses, a report and a film with skeletons.

    Example: `e3pose demo`

    The demo downloads films of four cameras from your Python package index (60 MB, once), and the
    best 2D pose network that it can get, and takes a minute or two. It detects the people in all
    frames, then runs an edge and four cameras that play the films, slower on a slow machine: two of
    four cameras detect in each slot. The report and the poses are those of a replay with the same
    selection. Without an internet connection the demo shows a simulated scene.

    Parameters
    ----------
    dest
        Output folder.
    offline
        Download nothing.
    overwrite
        Replace the output of an earlier demo.
    """
    begun_s = time.monotonic()
    check_free(dest, overwrite, (ABOUT,))
    with atomic_folder(dest, overwrite, (ABOUT,)) as folder:
        recording, detector = _recorded(folder / "recording", offline)
        # First, for a first replay compiles: the films would be over before the edge has.
        settings = ReplaySettings(num_selected=CAMERAS, foresees=True).for_rig(len(recording.rig))
        records = _replayed(recording, settings, "replay of two cameras")
        everything = ReplaySettings(policy="all").for_rig(len(recording.rig))
        every = _replayed(recording, everything, "replay of all cameras")
        status = _live(folder / "site", recording, detector)
        _write(recording, settings, records, every, folder, status)
        where = [f"  {name}: {what}" for name, what in FILES.items()]
        (folder / ABOUT).write_text("\n".join(["Output of e3pose demo", "", *where, ""]))
    print(f"Finished in {time.monotonic() - begun_s:.0f} s. Wrote:")
    print("\n".join(f"  {dest / name}: {what}" for name, what in FILES.items()))


def _recorded(dest: Path, offline: bool) -> tuple[Recording, str]:
    """Write the demo's recording, the clip or a simulated scene; return it and its detector."""
    try:
        clip = find_clip() or _fetched("the four-camera recording", fetch_clip, offline)
        name = ready_network(AUTO, live=True, offline=offline)
    except InputError as error:
        print(f"Could not download {error}.\nThis is a simulated scene instead.")
        with _phase("simulating a scene") as progress:
            recording = simulate(STAND_IN, 0)
            save_recording(recording, dest)
            write_films(recording, dest, lambda share: progress(round(100 * share), 100))
        return load_recording(dest), STAND_IN_DETECTOR
    rig = load_rig(clip.calibration)
    videos = [f"{i}={video}" for i, video in zip(rig.camera_ids, clip.videos, strict=True)]
    network = make_detector(name, None, "cpu", 1)
    with _phase("detecting people in all frames") as progress:
        settings = DetectSettings(fps=FPS, keep_videos="copy")
        detect_videos(videos, rig, network, dest, settings, name, progress)
    return replace(load_recording(dest), name=TITLE, source=SOURCE), name


def _fetched(name: str, fetch: Callable[[Progress], T], offline: bool) -> T:
    """Fetch something, with progress; errors say what could not be had."""
    try:
        if offline:
            raise InputError("not in the cache, and this run is offline")
        with _phase(f"downloading {name}") as progress:
            return fetch(progress)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _live(folder: Path, recording: Recording, detector: str) -> Status | None:
    """Run a site whose cameras play the videos, as fast as this machine detects; return how it was.

    Raises:
        InputError: with the last words of the program that did not do its work.
    """
    from e3pose.site.ready import site_programs

    ids = recording.rig.camera_ids
    example = Example(
        name="demo",
        sources={i: f"../recording/videos/{recording.videos[i]}" for i in ids},
        fps=recording.fps,
        skeleton=recording.skeleton.name,
        cameras=round(CAMERAS),
        camera={"detector": detector, "threads": 1, "meter": "model"},
        comment="The site of the demo. Run it again with `e3pose up site.toml`.\n"
        "Keys: docs/reference/site-file.md.",
    )
    path = write_example(folder, example, recording.rig)
    console = Console(stderr=True)
    with console.status("measuring the network"):
        times = measure_detections(resolve_site(path))
    assert times is not None, "it plays videos"
    pace = min(1.0, float(f"{suggested_fps(times, len(ids)) / example.fps:.2g}"))
    if pace < 1:
        print(f"Videos play at {pace:g}x speed, as fast as this machine detects in all of them.")
    deadline_ms = max(MIN_DEADLINE_MS, round(1000 * DEADLINE_SLOTS / example.fps / pace))
    path = write_example(
        folder, replace(example, pace=pace, deadline_ms=deadline_ms), recording.rig
    )
    site, logs = resolve_site(path), folder / "logs"
    programs = site_programs(site, logs, warn=warn)

    def over(status: Status | None) -> bool:
        for program in programs:
            if program.restarts:
                raise InputError(f"{program.name}: {last_line(program.log)}")
        return status is not None and status.slot >= recording.num_slots

    if not console.is_terminal:
        console.print("running the edge and the cameras ...", highlight=False)
    return run_shown(site, programs, logs, Console(), over)


def _replayed(recording: Recording, settings: ReplaySettings, label: str) -> list[SlotRecord]:
    return list(track_progress(replay(recording, settings), recording.num_slots, label))


def _write(
    recording: Recording,
    settings: ReplaySettings,
    records: list[SlotRecord],
    every: list[SlotRecord],
    folder: Path,
    status: Status | None,
) -> None:
    """Write the poses, figures, report page and pictures of replays of two and of all cameras."""
    plan = resolve_site(folder / "site").plan
    summary = summarise(
        recording,
        settings,
        records,
        plan.profiles,
        idle_mode=plan.idle_mode,
        battery_wh=plan.battery_wh,
    )
    live = {}
    if status is not None:
        names = ("slot", "slots_lost", "lead", "latency_ms", "blind")
        live = {name: getattr(status, name) for name in names} | {"saved": asdict(savings(status))}
    for name in ("poses.parquet", "poses.csv"):
        write_poses(records, recording.skeleton, folder / name)
    table = json.dumps(as_json(summary, live=live), indent=2)
    (folder / "summary.json").write_text(table + "\n", encoding="utf-8")
    write_report(recording, records, summary, folder / "report.html", folder=folder / "recording")
    with _phase("drawing the pictures") as progress:

        def images() -> Iterator[NDArray[np.uint8]]:
            for first, run in ((0, every), (recording.num_slots, records)):
                drawn = overlay_images(recording, run, folder / "recording", PANEL_PX)
                for done, image in enumerate(drawn, start=first + 1):
                    progress(done, 2 * recording.num_slots)
                    yield image

        write_movie(folder / "overlay.webm", images(), recording.fps / SLOWER)
    print("Replayed with the same selection, as in the report:")
    print_summary(summary)


@contextmanager
def _phase(name: str) -> Iterator[Progress]:
    """Show one phase as a bar on standard error; a plain line where that is no terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        console.print(f"{name} ...", highlight=False)
    columns = (TextColumn(f"{name:<36}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with bar(name, *columns, transient=False) as progress:
        yield progress
