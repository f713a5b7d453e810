"""`e3pose simulate`: a recording of people who never were, with exact truth."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from e3pose.cli.options import Whole
from e3pose.errors import InputError
from e3pose.plural import counted

RESOLUTION = re.compile(r"(\d{1,6})[xX](\d{1,6})")


def simulate(
    dest: Path,
    *,
    scene: str = "ring",
    people: Whole | None = None,
    seconds: float = 60.0,
    fps: float | None = None,
    cameras: Whole | None = None,
    radius: float | None = None,
    height: float | None = None,
    resolution: str | None = None,
    calibration: Path | None = None,
    seed: Whole = 0,
    exact: bool = False,
    overwrite: bool = False,
) -> None:
    """Make a recording of simulated people, with exact truth.

    Example: `e3pose simulate my-scene --scene crossing --people 6 --cameras 8 --seed 3`

    People walk, stop and gesture, sit, leave and come back; the detections err as those of a real
    detector do. The same options and seed give the same recording.

    Parameters
    ----------
    dest
        Folder to write the recording to.
    scene
        What goes on: ring, crossing, crowd or meeting; pillar, shaft, one-sided or poor-view, where
        cameras see unequally well; two-rooms or l-hall, where no camera sees everybody;
        unequal-batteries, dying-cameras or slow.
    people
        How many individuals take part; by default as many as suit the scene.
    seconds
        Length of the recording.
    fps
        Frames a second; 25, but 10 in the scene `slow`.
    cameras
        How many cameras; by default as many as the scene has places for, or 5 in a ring.
    radius
        Distance of the cameras from the middle, in metres.
    height
        Height of the cameras, in metres.
    resolution
        Width and height of the images; 1032x776 by default.
    calibration
        Use the cameras of this calibration file (z up, floor at z = 0) instead of a ring.
    seed
        Another seed gives another recording.
    exact
        Perfect detectors: every joint inside the image, at its exact place, and nothing else.
    overwrite
        Replace DEST if it exists.
    """
    from e3pose.files.atomic import check_free
    from e3pose.recording import save_recording
    from e3pose.simulate import DetectorSettings, SceneSettings
    from e3pose.simulate import simulate as run

    check_free(dest, overwrite)
    rig = None
    if calibration is not None:
        from e3pose.calibration import load_rig

        _refuse_ring_options(cameras=cameras, radius=radius, height=height, resolution=resolution)
        rig = load_rig(calibration)
    settings = SceneSettings(
        scene=scene,
        people=people,
        seconds=seconds,
        fps=fps,
        cameras=cameras,
        radius_m=radius,
        height_m=height,
        image_size=(1032, 776) if resolution is None else _size(resolution),
        rig=rig,
        detector=DetectorSettings(perfect=exact),
    )
    with _bar("simulate") as progress:
        recording = run(settings, seed, progress)
    save_recording(recording, dest, overwrite)
    poses = sum(len(series.scores) for series in recording.views)
    print(
        f"{dest}: {recording.name}: {counted(len(recording.rig), 'camera')}, "
        f"{counted(recording.num_slots, 'slot')} at "
        f"{recording.fps:g} fps, {counted(poses, 'detected pose')}"
    )


def _size(resolution: str) -> tuple[int, int]:
    match = RESOLUTION.fullmatch(resolution.strip())
    if match is None:
        raise InputError(
            f"simulate: resolution: found {resolution[:40]!r}, "
            "expected WIDTHxHEIGHT such as 1032x776"
        )
    return int(match[1]), int(match[2])


def _refuse_ring_options(**options: object) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(
                f"simulate: --{name}: found {value} beside --calibration, "
                "expected one or the other: a rig of its own has its cameras"
            )


@contextmanager
def _bar(label: str) -> Iterator[Callable[[float], None]]:
    """Yield a function that moves a bar on standard error; silent without a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda share: bar.update(task, completed=share)
