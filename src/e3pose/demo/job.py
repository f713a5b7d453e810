"""The main job from end to end: real videos in; 3D poses, a report and pictures out.

Where the real clip or the network cannot be fetched, the same job runs on a simulated scene.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from e3pose.atomic import atomic_folder, check_free
from e3pose.demo.clip import SOURCE, TITLE, Clip, fetch_clip, find_clip
from e3pose.demo.pictures import draw
from e3pose.demo.words import DemoReport, about
from e3pose.errors import InputError
from e3pose.simulate import SceneSettings, simulate
from e3pose.weights import Progress, find_weights, is_installed, pull_weights

if TYPE_CHECKING:
    from e3pose.pipeline import SlotRecord
    from e3pose.recording import Recording

T = TypeVar("T")

NETWORK = "openpose-thin"
EVERY = 2  # of the 60 frames a second: half of them tell as much and take half the time
NUM_SELECTED = 2
PROFILE = "xavier-nx"

STAND_IN = SceneSettings(people=3, seconds=12.0, cameras=4)
ABOUT = "e3pose-demo.txt"  # says what the folder is, and marks it as one that may be replaced
MARKS = (ABOUT,)

# Opens a phase of the work by its name, yields what to tell its progress to.
Phase = Callable[[str], AbstractContextManager[Progress]]


@contextmanager
def silent(name: str) -> Iterator[Progress]:
    """Show nothing of a phase."""
    yield lambda done, total: None


def run_demo(
    dest: Path,
    *,
    offline: bool = False,
    overwrite: bool = False,
    phase: Phase = silent,
    stand_in: SceneSettings | None = None,
) -> DemoReport:
    """Run the job and leave its results in the folder `dest`, whole or not at all.

    Args:
        dest: folder to make.
        offline: download nothing; what earlier runs fetched is used.
        overwrite: replace what an earlier demo left at `dest`.
        phase: shows how far each part of the work is.
        stand_in: the scene to simulate where the clip cannot be had.

    Raises:
        InputError: when `dest` is taken by something else.
    """
    from e3pose.profiles import load_profile

    began = time.monotonic()
    check_free(dest, overwrite, MARKS)
    inputs, problems = _inputs(offline, phase)
    with atomic_folder(dest, overwrite, MARKS) as folder:
        if inputs is None:
            recording = _simulated(stand_in, folder, phase)
        else:
            recording = _detected(*inputs, folder, phase)
        with phase("selecting cameras, triangulating") as progress:
            records, summary, people_all = _replayed(recording, load_profile(PROFILE), progress)
        _write_results(recording, records, summary, folder)
        with phase("drawing") as progress:
            draw(recording, records, folder, progress)
        report = DemoReport(
            dest=dest,
            real=inputs is not None,
            not_fetched=tuple(problems),
            num_cameras=len(recording.rig),
            network=NETWORK,
            num_frames=0 if inputs is None else sum(len(v.slots) for v in recording.views),
            people=_mean_people(records),
            people_all=people_all,
            summary=summary,
            seconds=time.monotonic() - began,
        )
        (folder / ABOUT).write_text(about(report, folder))
    return report


def _inputs(offline: bool, phase: Phase) -> tuple[tuple[Clip, Path] | None, list[str]]:
    """Get the clip and the network; or None, with what could not be had and why."""
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
        raise InputError("not fetched before, and this run is offline")
    with phase(f"fetching {name}") as progress:
        return fetch(progress)


def _detected(clip: Clip, weights: Path, folder: Path, phase: Phase) -> Recording:
    """Detect in the clip; leave the recording, with its videos, in `folder`."""
    from e3pose.calibration import load_rig
    from e3pose.detect import DetectSettings, detect_videos
    from e3pose.detectors import make_detector
    from e3pose.recording import load_recording, save_recording

    detected, dest = folder / "detected", folder / "recording"
    with phase("finding people in the frames") as progress:
        detector = make_detector(NETWORK, weights)
        settings = DetectSettings(every=EVERY)
        rig = load_rig(clip.calibration)
        detect_videos(clip.videos, rig, detector, detected, settings, NETWORK, progress)
    recording = load_recording(detected)
    names = {camera_id: Path(video).name for camera_id, video in recording.videos.items()}
    recording = replace(recording, name=TITLE, source=SOURCE, videos=names)
    save_recording(recording, dest)
    (dest / "videos").mkdir(exist_ok=True)
    for video in clip.videos:
        shutil.copyfile(video, dest / "videos" / video.name)
    shutil.copyfile(detected / "detection.toml", dest / "detection.toml")
    shutil.rmtree(detected)
    return recording


def _simulated(stand_in: SceneSettings | None, folder: Path, phase: Phase) -> Recording:
    from e3pose.recording import save_recording

    scene = stand_in or STAND_IN
    with phase("simulating a scene") as progress:
        recording = simulate(scene, 0, lambda share: progress(round(100 * share), 100))
    save_recording(recording, folder / "recording")
    return recording


def _replayed(
    recording: Recording, profile: Any, progress: Progress
) -> tuple[list[SlotRecord], dict[str, Any], float]:
    """Replay with a selection; and with all cameras, for how many people those find."""
    from e3pose.evaluate.replay import ReplaySettings, replay
    from e3pose.evaluate.summary import summarise

    settings = ReplaySettings(
        pipeline="default",
        num_selected=min(NUM_SELECTED, len(recording.rig)),
        foresees=True,
    )
    runs: list[list[SlotRecord]] = []
    for number, chosen in enumerate((settings, replace(settings, policy="all"))):
        records = []
        for record in replay(recording, chosen):
            records.append(record)
            progress(number * recording.num_slots + len(records), 2 * recording.num_slots)
        runs.append(records)
    summary = summarise(recording, settings, runs[0], profile)
    return runs[0], summary, _mean_people(runs[1])


def _mean_people(records: Sequence[SlotRecord]) -> float:
    return float(np.mean([len(record.poses) for record in records])) if records else 0.0


def _write_results(
    recording: Recording, records: Sequence[SlotRecord], summary: dict[str, Any], folder: Path
) -> None:
    from e3pose.evaluate.poses_table import write_poses
    from e3pose.report import write_report

    for name in ("poses.parquet", "poses.csv"):
        write_poses(records, recording.skeleton, folder / name)
    (folder / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    write_report(recording, records, summary, folder / "report.html")
