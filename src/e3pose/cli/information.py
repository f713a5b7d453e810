"""`e3pose info`: describe a recording and say what is wrong with it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from e3pose.plural import counted

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from e3pose.recording.description import CameraDescription, Description
    from e3pose.recording.problems import Problem


def info(
    recording: Path,
    *,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Describe a recording and say what is wrong with it.

    Exits with 0 if the recording can be read, whatever is wrong with it, and with 2 if it cannot.

    Example: e3pose info recordings/shelf

    Parameters
    ----------
    recording
        A recording folder.
    json
        Print JSON in the place of tables.
    """
    from e3pose.recording import load_recording
    from e3pose.recording.description import describe
    from e3pose.recording.problems import find_problems

    loaded = load_recording(recording)
    description = describe(loaded)
    problems = find_problems(loaded, recording)
    if json:
        _print_json(description, problems)
    else:
        from rich.console import Console

        # A pipe gets whole lines; only a terminal has a width to fold to.
        console = Console(highlight=False, width=None if sys.stdout.isatty() else 200)
        _print_tables(console, description, problems)


def _print_json(description: Description, problems: list[Problem]) -> None:
    import msgspec

    content = {**msgspec.to_builtins(description), "problems": msgspec.to_builtins(problems)}
    text = msgspec.json.format(msgspec.json.encode(content), indent=2)
    sys.stdout.write(text.decode() + "\n")


def _noise_line(description: Description) -> str:
    from e3pose.model.noises import DEFAULT, detector_of

    name = detector_of(description)
    return f"{name}: OpenPose's and half of it, then learned" if name == DEFAULT else name


def _print_tables(console: Console, description: Description, problems: list[Problem]) -> None:
    from rich.table import Table
    from rich.text import Text

    facts = Table.grid(padding=(0, 2))
    first, end = description.scored_slots
    scored = "all" if (first, end) == (0, description.num_slots) else f"{first} to {end - 1}"
    rows = {
        "recording": description.name,
        "source": description.source or "-",
        "length": f"{counted(description.num_slots, 'slot')} at {description.fps:g} fps, "
        f"{description.duration_s:.2f} s",
        "scored slots": scored,
        "skeleton": description.skeleton,
        "detector": description.detector or "not stated",
        "noise file": _noise_line(description),
        "truth": _truth_line(description),
    }
    for label, value in rows.items():
        facts.add_row(Text(label, style="bold"), Text(value))
    console.print(facts)
    console.print()
    console.print(_camera_table(description.cameras))
    console.print()
    if not problems:
        console.print(Text("Nothing looks wrong.", style="green"))
        return
    console.print(
        Text(
            f"{len(problems)} {'thing looks' if len(problems) == 1 else 'things look'} wrong:",
            style="bold yellow",
        )
    )
    for problem in problems:
        console.print(Text(f"  {problem.where}: {problem.message}"), soft_wrap=True)


def _camera_table(cameras: tuple[CameraDescription, ...]) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False)
    table.add_column("camera")
    for title in ("image", "lens", "centre, m", "views", "lost", "people mean", "max"):
        table.add_column(title, justify="right")
    for title in ("keypoints missing", "median score", "video"):
        table.add_column(title, justify="right")
    for camera in cameras:
        cells = (
            camera.camera_id,
            f"{camera.image_size[0]} x {camera.image_size[1]}",
            camera.lens,
            " ".join(f"{value:.2f}" for value in camera.center_m),
            str(camera.frames),
            str(camera.lost),
            _number(camera.mean_people, "{:.2f}"),
            str(camera.max_people),
            _number(camera.missing_keypoints, "{:.1%}"),
            _number(camera.median_score, "{:.2f}"),
            camera.video or "-",
        )
        table.add_row(*(Text(cell) for cell in cells))
    return table


def _truth_line(description: Description) -> str:
    truth = description.truth
    if truth is None:
        return "none"
    named = ", ".join(f"{name} in {slots}" for name, slots in truth.slots_of_person.items())
    if len(named) > 200:
        named = counted(len(truth.slots_of_person), "person", "people")
    everybody = "of everybody" if truth.complete else "of some of the people"
    return f"{truth.skeleton}, {everybody}, in {counted(truth.annotated_slots, 'slot')} ({named})"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
