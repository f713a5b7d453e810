"""What the demo did, what it saved and where to look, in plain words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SLOWER = 3  # how much slower than life the movie plays; the clip lasts under two seconds
FILES = {
    "report.html": "open this first: turn and play the skeletons, see who was awake and why",
    "overlay.webm": f"the 3D skeletons on the pictures, {SLOWER} times slower than life",
    "overlay.png": "the same as one picture: the fullest moment of each quarter",
    "poses.parquet": "the 3D poses as a table, metres (poses.csv has the same)",
    "summary.json": "the figures",
    "recording": "cameras, 2D poses and videos, for `e3pose replay` and `e3pose evaluate`",
}


@dataclass(frozen=True, slots=True)
class DemoReport:
    """What the demo did.

    Attributes:
        dest: the folder it left.
        real: whether it ran on the real clip.
        not_fetched: what could not be had and why, one line each.
        num_cameras: of the rig.
        network: which searched the frames for people.
        num_frames: images that were searched for people; 0 if simulated.
        people: mean number of people in 3D a slot.
        people_all: the same with every camera awake.
        summary: the replay's figures.
        seconds: it took in all.
    """

    dest: Path
    real: bool
    not_fetched: tuple[str, ...]
    num_cameras: int
    network: str
    num_frames: int
    people: float
    people_all: float
    summary: dict[str, Any] = field(repr=False)
    seconds: float


def words(report: DemoReport) -> list[str]:
    """Say what the demo did, what it saved and where to look."""
    where = [f"  {report.dest / name}: {what}" for name, what in _files(report.dest).items()]
    return [*story(report), f"Done in {report.seconds:.0f} s. Where to look:", *where]


def about(report: DemoReport, folder: Path) -> str:
    """Return the text to leave beside the results in `folder`."""
    where = [f"  {name}: {what}" for name, what in _files(folder).items()]
    return "\n".join(["What e3pose demo left here", "", *story(report), "", *where, ""])


def story(report: DemoReport) -> list[str]:
    """Say what the demo did and what it saved, one sentence or two a line."""
    summary = report.summary
    settings, energy = summary["settings"], summary["energy"]
    if report.real:
        did = [
            f"Took a real recording of {report.num_cameras} cameras and looked for people in "
            f"{report.num_frames} of its frames with the network {report.network}."
        ]
    else:
        did = [
            *(f"Could not fetch {problem}" for problem in report.not_fetched),
            f"So this ran on a simulated scene with {report.num_cameras} cameras instead.",
        ]
    return [
        *did,
        f"For each of {summary['slots']} slots, chose {settings['num_selected']} cameras to stay "
        f"awake (all in the first {settings['warmup_slots']}), and placed the people in 3D from "
        "what those saw.",
        f"Saved: {summary['selection']['mean_cameras']:.1f} of {report.num_cameras} cameras were "
        f"awake on average. That is {energy['saving_percent']:.0f} % less energy for processors, "
        f"WiFi and memory, {energy['device_saving_percent']:.0f} % less for the whole cameras, "
        f"reckoned with the power profile {energy['profile']}.",
        f"The price: {report.people:.1f} people a slot in 3D, {report.people_all:.1f} with all "
        "cameras awake. A new person is shown once three cameras have seen them, or ten views.",
        *_accuracy(summary),
    ]


def _accuracy(summary: Mapping[str, Any]) -> list[str]:
    error_mm = summary["metrics"].get("mpjpe_mm")
    if error_mm is None:
        return []
    return [f"The joints it placed are {error_mm:.0f} mm from the truth on average."]


def _files(folder: Path) -> dict[str, str]:
    return {name: what for name, what in FILES.items() if (folder / name).exists()}
