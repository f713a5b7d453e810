"""`e3pose info`: describe a recording and report problems in it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from rich.table import Table
from rich.text import Text

from e3pose.base.quantities import plural
from e3pose.cli.output import JsonFile, is_stdout, write_json
from e3pose.cli.placed import problems_of
from e3pose.evaluate.columns import print_tables, table_console
from e3pose.model.noises import DEFAULT, detector_of
from e3pose.recording import load_recording
from e3pose.recording.description import CameraDescription, Description, describe
from e3pose.recording.problems import Problem

if TYPE_CHECKING:
    from rich.console import Console

    from e3pose.model.camera import Rig


def info(
    recording: Path,
    /,
    *,
    json_file: JsonFile = None,
) -> None:
    """Describe a recording and report problems in it.

    Example: `e3pose info recordings/shelf`

    Exit code: 0 if the recording is readable, with or without problems; 2 if it is not.

    Parameters
    ----------
    recording
        Recording folder.
    json_file
        Write the description and the problems here as JSON; - is standard output.
    """
    loaded = load_recording(recording)
    description = describe(loaded)
    problems = problems_of(loaded, recording)
    if not is_stdout(json_file):
        _print_description(table_console(200), description, problems, loaded.rig)
    if json_file is not None:
        content = {**msgspec.to_builtins(description), "problems": msgspec.to_builtins(problems)}
        write_json(json_file, content)


def _print_description(
    console: Console, description: Description, problems: list[Problem], rig: Rig
) -> None:
    facts = Table.grid(padding=(0, 2))
    first, end = description.scored_slots
    scored = "all" if (first, end) == (0, description.num_slots) else f"{first} to {end - 1}"
    noise = detector_of(description)
    rows = {
        "recording": description.name,
        "source": description.source or "-",
        "length": f"{plural(description.num_slots, 'slot')} at {description.fps:g} fps, "
        f"{description.duration_s:.2f} s",
        "scored slots": scored,
        "skeleton": description.skeleton,
        "detector": description.detector or "not stated",
        "noise model": f"{noise}: 1.5 x OpenPose, then learned online"
        if noise == DEFAULT
        else noise,
        "truth": _truth_line(description),
    }
    for label, value in rows.items():
        facts.add_row(Text(label, style="bold"), Text(value))
    console.print(facts)
    console.print()
    _print_cameras(console, description.cameras, rig)
    console.print()
    if not problems:
        console.print(Text("No problems found.", style="green"))
        return
    console.print(Text(f"{plural(len(problems), 'problem')}:", style="bold yellow"))
    for problem in problems:
        console.print(Text(f"  {problem.where}: {problem.message}"), soft_wrap=True)


def _print_cameras(console: Console, cameras: tuple[CameraDescription, ...], rig: Rig) -> None:
    titles = [camera.title for camera in rig.cameras]
    columns: dict[str, list[str]] = {
        **({"title": titles} if any(titles) else {}),
        "image": [f"{c.image_size[0]} x {c.image_size[1]}" for c in cameras],
        "lens": [c.lens for c in cameras],
        "centre, m": [
            " ".join(f"{value:.2f}" for value in c.center_m) if i in rig.placed_ones else "unknown"
            for i, c in enumerate(cameras)
        ],
        "views": [str(c.frames) for c in cameras],
        "lost": [str(c.lost) for c in cameras],
        "people, mean": [_number(c.mean_people, "{:.2f}") for c in cameras],
        "max": [str(c.max_people) for c in cameras],
        "missing keypoints": [_number(c.missing_keypoints, "{:.1%}") for c in cameras],
        "median score": [_number(c.median_score, "{:.2f}") for c in cameras],
        "video": [c.video or "-" for c in cameras],
    }
    left = ("camera", "title", "image", "lens", "centre, m", "video")
    print_tables(console, {"camera": [c.camera_id for c in cameras]}, columns, left=left)


def _truth_line(description: Description) -> str:
    truth = description.truth
    if truth is None:
        return "none"
    named = ", ".join(f"{name} in {slots}" for name, slots in truth.slots_of_person.items())
    if len(named) > 200:
        named = plural(len(truth.slots_of_person), "person", "people")
    everybody = "of everybody" if truth.complete else "of some of the people"
    return f"{truth.skeleton}, {everybody}, in {plural(truth.annotated_slots, 'slot')} ({named})"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
