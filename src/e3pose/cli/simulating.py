"""`e3pose simulate`: a recording of simulated people, with exact truth."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from e3pose.base.atomic import check_free
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.cli.options import Flag, Whole
from e3pose.cli.progress import bar
from e3pose.recording import Recording, save_recording
from e3pose.recording.calibration import load_rig
from e3pose.simulate import DetectorSettings, Guessing, SceneSettings, adjusted
from e3pose.simulate import simulate as run
from e3pose.simulate.feet import with_skeleton
from e3pose.simulate.films import check_people
from e3pose.simulate.scenes import scene_by_name
from e3pose.site.simulated_films import write_films

if TYPE_CHECKING:
    from e3pose.model.camera import Rig

RESOLUTION = re.compile(r"(\d{1,6})[xX](\d{1,6})")


@Parameter(name="*", group=Group("Cameras", sort_key=1))
@dataclass(frozen=True, kw_only=True)
class RingOptions:
    """The cameras of the scene."""

    cameras: Whole | None = None
    """Number of cameras. Default: set by the scene; 5 in a ring."""
    radius: float | None = None
    """Distance of the cameras from the centre, metres."""
    height: float | None = None
    """Height of the cameras, metres."""
    resolution: str | None = None
    """Image size. Default: 1032x776."""
    calibration: Path | None = None
    """Use the cameras of this calibration file (z up, floor at z = 0)."""

    def rig(self) -> Rig | None:
        """Return the cameras of the calibration file; None without one."""
        if self.calibration is None:
            return None

        for name in ("cameras", "radius", "height", "resolution"):
            if (value := getattr(self, name)) is not None:
                raise InputError(
                    f"simulate: --{name}: found {value} beside --calibration, expected one of them"
                )
        return load_rig(self.calibration)

    def image_size(self) -> tuple[int, int]:
        """Return width and height in pixels."""
        if self.resolution is None:
            return (1032, 776)
        return size_of("simulate: resolution", self.resolution)


@Parameter(name="*", group=Group("Detector", sort_key=2))
@dataclass(frozen=True, kw_only=True)
class ErrorOptions:
    """Errors of the simulated detector."""

    errors: Literal["situation", "score"] | None = None
    """situation: hidden and cut joints are guessed, errors last as long as view and posture do, as
    on real recordings. score: errors depend on the score alone, which is kinder than reality.
    Default: situation for round-table, buffet, reception, operating-room and lab, score for the
    others."""
    set_error: Annotated[list[str] | None, Parameter(negative="")] = None
    """NAME=VALUE: change one figure of the errors, such as taken=0 (no joint is put on the person
    in front), lasting=0 (errors forget the situation), overconfidence=1, noise=2, ghosts=0;
    repeatable. docs/reference/simulation.md lists them."""
    exact: Flag = False
    """Perfect detections: every joint inside the image, without noise."""

    def detector(self, scene: str) -> DetectorSettings:
        """Return how the detector errs in a scene."""
        if self.exact:
            if self.errors or self.set_error:
                raise InputError("simulate: --exact: found errors beside it, expected one of them")
            return DetectorSettings(perfect=True)
        detector = scene_by_name(scene).detector
        if self.errors == "score":
            detector = replace(detector, guessing=None)
        elif self.errors == "situation":
            detector = replace(detector, guessing=detector.guessing or Guessing())
        return adjusted(detector, dict(_figure(word) for word in self.set_error or ()))


def _figure(word: str) -> tuple[str, float]:
    name, _, value = word.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise InputError(
            f"simulate: --set-error: found {word[:40]!r}, expected NAME=VALUE such as lasting=0.5"
        ) from None


RING = RingOptions()
ERRORS = ErrorOptions()


def simulate(
    dest: Path,
    /,
    *,
    scene: str = "ring",
    people: Whole | None = None,
    seconds: float = 60.0,
    fps: float | None = None,
    ring: RingOptions = RING,
    errors: ErrorOptions = ERRORS,
    seed: Whole = 0,
    skeleton: str = "coco17",
    videos: Flag = False,
    overwrite: bool = False,
) -> None:
    """Simulate a recording: people, calibrated cameras, realistic detections, exact truth.

    Example: `e3pose simulate my-table --scene round-table --cameras 5 --seed 3`

    The scenes round-table, buffet, reception, operating-room and lab are as hard as real
    recordings: people stay for minutes and hide each other, cameras hang unevenly, and the detector
    guesses what it does not see. The other scenes are older and kinder: policies that win on them
    lose on real recordings. They stay for comparison. The same options and seed give the same
    recording.

    Parameters
    ----------
    dest
        Recording folder to create.
    scene
        round-table, buffet, reception (a standing crowd), operating-room, lab. Old and kind: ring,
        crossing, crowd, meeting; pillar, shaft, one-sided, poor-view (cameras with unequal views);
        two-rooms, l-hall (no camera sees everybody); unequal-batteries, dying-cameras, slow.
    people
        Number of people. Default: set by the scene.
    seconds
        Length of the recording.
    fps
        Frames per second. Default: 25; scene `slow`: 10; `operating-room`: 6.
    seed
        Random seed.
    skeleton
        Skeleton of detections and truth, or its TOML file; body25 and halpe26 have feet, coco133
        has hands and a face, too.
    videos
        Also write a film per camera into the recording's `videos` folder: the detections drawn as
        coloured joints, which the detector `drawn` reads back. At most three people.
    overwrite
        Replace DEST.
    """
    check_free(dest, overwrite)
    if videos:
        if skeleton != "coco17":
            raise InputError("--skeleton", f"{skeleton} with --videos", "coco17, which films show")
        check_people(scene_by_name(scene).people if people is None else people)
    settings = SceneSettings(
        scene=scene,
        people=people,
        seconds=seconds,
        fps=fps,
        cameras=ring.cameras,
        radius_m=ring.radius,
        height_m=ring.height,
        image_size=ring.image_size(),
        rig=ring.rig(),
        detector=errors.detector(scene),
    )
    with bar("simulate") as progress:
        made = run(settings, seed, lambda share: progress(share, 1))
        recording = with_skeleton(made, skeleton, seed)
    save_recording(recording, dest, overwrite)
    if videos:
        with bar("films") as progress:
            write_films(recording, dest, lambda share: progress(share, 1))
    _print(recording, dest)


def _print(recording: Recording, dest: Path) -> None:
    poses = sum(len(series.scores) for series in recording.views)
    print(
        f"Wrote {dest}: {recording.name}: {plural(len(recording.rig), 'camera')}, "
        f"{plural(recording.num_slots, 'slot')} at "
        f"{recording.fps:g} fps, {plural(poses, 'detected pose')}"
    )


def size_of(thing: str, resolution: str) -> tuple[int, int]:
    """Read `(width, height)` as people write it; errors name the thing."""
    match = RESOLUTION.fullmatch(resolution.strip())
    if match is None:
        raise InputError(
            f"{thing}: found {resolution[:40]!r}, expected WIDTHxHEIGHT such as 1032x776"
        )
    return int(match[1]), int(match[2])
