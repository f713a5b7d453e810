"""Processor time of the cameras of live sites, measured, beside error and recall.

    python lab/benchmarks/camera_work.py --model FILE.onnx --runs 2
    python lab/benchmarks/camera_work.py --network openpose-thin --model FILE.onnx

The film is played to a site of real processes, an edge and four cameras, once for each way to
look; their processor time is what every camera program took, all threads together, as the system
counts it. Ways are run one after the other, so that shares are within one run.

The film is the demo's four real videos, 34 slots at 20 per second, played forward and back again
and again; its truth is the offline smoother over all views. It is played slowly, `--slot-s` seconds
a slot, so that a busy machine keeps up: where many slots are blind, or fewer looks came than were
asked for, it did not, and a row says nothing. Weights are those of the cache, or FILE.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from clip_error import references
from e3pose.base.arrays import Floats
from e3pose.camera.detect import DetectSettings, detect_videos
from e3pose.camera.source import open_video
from e3pose.detectors import make_detector
from e3pose.evaluate.summary import accuracy
from e3pose.model.blind_slot import count_blind
from e3pose.model.camera import Rig
from e3pose.model.noises import load_noise
from e3pose.model.skeleton import Skeleton
from e3pose.output.report.overlay import write_movie
from e3pose.recording import Recording, ViewSeries, load_recording
from e3pose.recording.calibration import load_rig
from e3pose.recording.record import Truth
from e3pose.site.demo_clip import find_clip
from e3pose.site.example import STORE_FILE, Example, write_example
from live_run import Heard, run_live, stored_records

NETWORK = "movenet-multipose"
CLIP_FPS, CLIP_EVERY = 20.0, 3
DEADLINE_SLOTS = 2.5
READY_S = 12.0
WARMUP_SLOTS = 10
# Who sleeps draws next to nothing; the programs here wait, and capture nothing.
PROFILE = """
[rests.asleep]
watts = 0.5
enter_s = 0.5
wake_s = 1.0
wake_sd_s = 0.2
source = "assumed"
"""
CHEAP = {"rest": "asleep", "feedback": True}
# By name: keys of the loop, and of every camera.
WAYS: dict[str, tuple[Mapping[str, Any], Mapping[str, Any]]] = {
    "all cameras": ({"policy": "all"}, {}),
    "two, awake (today)": ({"cameras": 2}, {}),
    "two, rests": ({"cameras": 2, "rest": "asleep"}, {}),
    "two, rests, gate": ({"cameras": 2, "rest": "asleep"}, {"gate": True}),
    "two, rests, gate, parts": ({"cameras": 2, **CHEAP}, {"gate": True}),
    "one and a half, likewise": ({"cameras": 1.5, **CHEAP}, {"gate": True}),
    "one, likewise": ({"cameras": 1, **CHEAP}, {"gate": True}),
}
TODAY = 1  # layout: of `WAYS`, what others are a share of


@dataclass(frozen=True, slots=True, eq=False)
class Footage:
    """Videos of a simulated scene, by camera.

    Attributes:
        scene: its rig and truth; its views are not used.
        videos: by camera.
        detector: keys of every camera.
    """

    scene: Recording
    videos: Mapping[str, Path]
    detector: Mapping[str, Any]


@dataclass
class Work:
    """Costs of a way to look in all runs; each list has one figure a run."""

    cpu_ms: list[float] = field(default_factory=list)  # of all cameras, a slot
    look_ms: list[float] = field(default_factory=list)
    frame_ms: list[float] = field(default_factory=list)
    looks: list[float] = field(default_factory=list)  # with the network, a slot
    frames: list[float] = field(default_factory=list)  # captured, a slot
    error_mm: list[float] = field(default_factory=list)
    recall: list[float] = field(default_factory=list)
    blind: list[float] = field(default_factory=list)  # percent of slots; few, or it tells nothing
    slots: list[int] = field(default_factory=list)


def back_and_forth(count: int, slots: int) -> list[int]:
    """Return which of so many images is shown in each slot: forward, back, and again."""
    there = [*range(count), *range(count - 2, 0, -1)]
    return [there[slot % len(there)] for slot in range(slots)]


def clip(folder: Path, slots: int, network: str, model: Path | None) -> Footage:
    """Make films of the demo's real videos."""
    found = find_clip()
    assert found is not None, "the demo fetches it"
    rig = load_rig(found.calibration)
    seen, videos = folder / "seen", {}
    detector = make_detector(network, model, "cpu", 1)
    sources = [f"{c}={v}" for c, v in zip(rig.camera_ids, found.videos, strict=True)]
    detect_videos(sources, rig, detector, seen, DetectSettings(fps=CLIP_FPS), network)
    recording = load_recording(seen)
    people = references(recording, load_noise(network))
    shown = back_and_forth(recording.num_slots, slots)
    for camera_id, video in zip(rig.camera_ids, found.videos, strict=True):
        every = [
            f.image for n, f in enumerate(open_video(video).frames(0.0)) if n % CLIP_EVERY == 0
        ]
        videos[camera_id] = folder / f"{camera_id}.mp4"
        write_movie(videos[camera_id], (every[at] for at in shown), CLIP_FPS)
    joints_m = np.stack([[person.at(at) for person in people] for at in shown])
    scene = _scene(rig, CLIP_FPS, recording.skeleton, joints_m)
    return Footage(scene, videos, {"detector": network, **_weights(model)})


def _weights(model: Path | None) -> dict[str, str]:
    return {} if model is None else {"model": str(model.resolve())}


def _scene(rig: Rig, fps: float, skeleton: Skeleton, joints_m: Floats) -> Recording:
    nothing = ViewSeries.from_views([], [], [], len(skeleton))
    names = tuple(f"person{number}" for number in range(1, joints_m.shape[1] + 1))
    return Recording(
        name="films",
        rig=rig,
        fps=fps,
        num_slots=len(joints_m),
        skeleton=skeleton,
        views=(nothing,) * len(rig),
        truth=Truth(skeleton, names, joints_m),
    )


def run(footage: Footage, way: str, slot_s: float, folder: Path, work: Work) -> None:
    """Play a film to a site, and add what its cameras took."""
    scene, (loop, camera) = footage.scene, WAYS[way]
    pace = 1 / (scene.fps * slot_s)
    example = Example(
        name="work",
        sources={camera_id: str(path) for camera_id, path in footage.videos.items()},
        fps=scene.fps,
        skeleton=scene.skeleton.name,
        pace=pace,
        deadline_ms=round(1000 * DEADLINE_SLOTS * slot_s),
        camera={**footage.detector, "threads": 1, "meter": "model", **camera},
        loop=loop,
    )
    path = write_example(folder, example, scene.rig)
    (folder / "board.toml").write_text(_profile())
    path.write_text(f'{path.read_text()}\n[energy]\nprofile = "board.toml"\n')
    length_s = scene.num_slots * scene.interval_s
    wanted = scene.num_slots - 2 * round(DEADLINE_SLOTS) - 1
    heard = run_live(path, wanted, length_s, READY_S)
    records, moments_s = stored_records(folder / STORE_FILE, scene.interval_s, heard, wanted)
    assert scene.truth is not None
    frames = np.round(moments_s * scene.fps).astype(np.int64) % scene.num_slots
    truth = replace(scene.truth, joints_m=scene.truth.joints_m[frames])
    scored = (WARMUP_SLOTS, len(records))
    seen = replace(scene, num_slots=len(records), truth=truth, scored_slots=scored)
    found = accuracy(seen, records)
    _count(work, heard, len(records))
    work.blind.append(100 * sum(count_blind(records).values()) / len(records))
    work.error_mm.append(found.mpjpe_mm or np.nan)
    work.recall.append(100 * (found.recall_500mm or 0.0))


def _count(work: Work, heard: Heard, slots: int) -> None:
    beats = list(heard.beats.values())
    cpu_s, look_cpu_s = (sum(getattr(b, n) or 0.0 for b in beats) for n in ("cpu_s", "look_cpu_s"))
    looks, captured = (sum(getattr(b, n) for b in beats) for n in ("detected", "captured"))
    work.cpu_ms.append(1000 * cpu_s / slots)
    work.look_ms.append(1000 * look_cpu_s / max(looks, 1))
    work.frame_ms.append(1000 * (cpu_s - look_cpu_s) / max(captured, 1))
    work.looks.append(looks / slots)
    work.frames.append(captured / slots)
    work.slots.append(slots)


def _profile() -> str:
    import e3pose.energy.profiles as profiles

    text = (Path(profiles.__file__).parent / "xavier-nx.toml").read_text()
    head, _, _ = text.partition("[rests.asleep]")
    return head + PROFILE


def lines(works: Mapping[str, Work]) -> Iterator[str]:
    """Yield the rows of a table in Markdown; several runs of a way beside each other."""
    names = (
        "cameras", "CPU ms a slot, all cameras", "% less than today", "looks a slot", "ms a look",
        "frames a slot", "ms a frame", "error, mm", "% more than today", "recall, %",
        "blind, %", "slots",
    )  # fmt: skip
    yield f"| {' | '.join(names)} |\n|{'---|' * len(names)}"
    today = works.get(list(WAYS)[TODAY])
    for name, work in works.items():
        base = today or Work()
        less = [100 - 100 * own / its for own, its in zip(work.cpu_ms, base.cpu_ms, strict=False)]
        more = [
            100 * own / its - 100 for own, its in zip(work.error_mm, base.error_mm, strict=False)
        ]
        figures = (
            ("{:.0f}", work.cpu_ms), ("{:.0f}", less), ("{:.2f}", work.looks),
            ("{:.1f}", work.look_ms), ("{:.2f}", work.frames), ("{:.1f}", work.frame_ms),
            ("{:.1f}", work.error_mm), ("{:+.0f}", more), ("{:.1f}", work.recall),
            ("{:.0f}", work.blind), ("{:d}", work.slots),
        )  # fmt: skip
        cells = [", ".join(form.format(value) for value in each) for form, each in figures]
        yield f"| {' | '.join([name, *cells])} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--ways", default="", help="numbers of rows to run; all by default")
    parser.add_argument("--network", default=NETWORK)
    parser.add_argument("--model", type=Path, help="its weights; those of the cache by default")
    parser.add_argument("--slots", type=int, default=300)
    parser.add_argument("--slot-s", type=float, default=0.4, help="seconds that a slot takes")
    parser.add_argument("--runs", type=int, default=1)
    options = parser.parse_args()
    numbers = [int(each) for each in options.ways.split(",") if each] or range(len(WAYS))
    with tempfile.TemporaryDirectory(prefix="e3pose-work-") as name:
        folder = Path(name)
        footage = clip(folder, options.slots, options.network, options.model)
        works = {way: Work() for n, way in enumerate(WAYS) if n in numbers}
        for number in range(options.runs):
            for index, (way, work) in enumerate(works.items()):
                run(footage, way, options.slot_s, folder / f"{number}-{index}", work)
        print("\n".join(lines(works)), flush=True)


if __name__ == "__main__":
    main()
