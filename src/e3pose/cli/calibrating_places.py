"""`e3pose calibrate extrinsics`: where cameras stand, by a board, a ball, a wand or people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import Group, Parameter

from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within, length_m, plural
from e3pose.calibrate.ball import check_colours
from e3pose.calibrate.board import Board
from e3pose.calibrate.points_file import load_markers, load_points
from e3pose.calibrate.recordings import first_seconds, known_lenses, with_lenses
from e3pose.cli.calibrating_lenses import DEFAULT_BOARD, camera_bar, toml_path
from e3pose.cli.calibrating_one import place_again
from e3pose.cli.detecting import camera_seconds
from e3pose.cli.options import Flag, as_typed
from e3pose.cli.output import JsonFile, is_stdout, number_or_null, write_json, wrote
from e3pose.cli.placed import warn_of_problems
from e3pose.cli.progress import stage_progress
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import load_recording
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.recording.pairing import name_videos

if TYPE_CHECKING:
    from e3pose.calibrate.places import KnownLength, Places
    from e3pose.calibrate.uncertainty import CameraErrors
    from e3pose.calibrate.wand import Wand
    from e3pose.model.camera import Rig
    from e3pose.recording.record import Recording

MOST_SECONDS = 3600.0


@Parameter(name="*", group=Group("Videos and points", sort_key=1))
@dataclass(frozen=True, kw_only=True)
class FilmOptions:
    """Options for videos and points: what they show, and their times."""

    board: str = DEFAULT_BOARD
    """Board name, as printed on it, with the measured side of a square."""
    ball: str | None = None
    """Follow a ball of this colour instead: red, orange, yellow, green, blue, pink, or bright (a
    light in the dark)."""
    wand: str | None = None
    """Follow balls on a stick instead: their colours, and distances from the first ball, such as
    green,red=500mm or green,blue,red=200mm,500mm. With points: the names of points."""
    offset: Annotated[list[str] | None, Parameter(negative="")] = None
    """CAMERA=SECONDS: start time of that video, if they did not start together; repeatable.
    `e3pose sync` finds it."""
    rate: float = 5.0
    """Images per second to use of the videos."""

    def carried(self, known: KnownLength) -> str | Wand | None:
        """Return the ball's colour or the wand; None for neither."""
        from e3pose.calibrate.wand import Wand

        if self.wand is None:
            return self.ball
        if self.ball is not None:
            raise InputError("--ball: found it beside --wand, which names its balls, expected one")
        if known.height_m is not None or known.distance is not None or known.limb is not None:
            raise InputError(
                "--height, --distance, --limb: the wand states the scale, expected none"
            )
        return Wand.parse(self.wand)


LEAST_HEIGHT_M, MOST_HEIGHT_M = 0.5, 2.5  # of people


@Parameter(name="*", group=Group("Scale", sort_key=2))
@dataclass(frozen=True, kw_only=True)
class ScaleOptions:
    """A known length."""

    height: str | None = None
    """Body height of the people, on average, such as 178cm."""
    distance: str | None = None
    """CAM1,CAM2=LENGTH, the distance between two lenses."""
    limb: str | None = None
    """JOINT1,JOINT2=LENGTH, the distance between two joints of the person, such as
    left_knee,left_ankle=43cm."""

    def known(self) -> KnownLength:
        """Return the length; raise `InputError` for several."""
        from e3pose.calibrate.places import KnownLength

        if sum(value is not None for value in (self.height, self.distance, self.limb)) > 1:
            raise InputError("--height, --distance, --limb: found several, expected at most one")
        with as_typed({"": "--height"}):
            height_m = None if self.height is None else length_m(self.height)
        if height_m is not None and not LEAST_HEIGHT_M <= height_m <= MOST_HEIGHT_M:
            limits = f"the height of people, {LEAST_HEIGHT_M:g} to {MOST_HEIGHT_M:g} m"
            raise InputError("--height", self.height, limits)
        return KnownLength(
            height_m,
            None if self.distance is None else _pair("--distance", self.distance),
            None if self.limb is None else _pair("--limb", self.limb),
        )


@Parameter(name="*", group=Group("Recordings of people", sort_key=3))
@dataclass(frozen=True, kw_only=True)
class PeopleOptions:
    """The part of a recording to use."""

    start: Path | None = None
    """Refine this calibration, which may be off by about 5 degrees and 20 cm. Its world and scale
    are kept."""
    seconds: float = 120.0
    """Use this many seconds from the start of the recording; with --only, from its end."""
    noise: str | None = None
    """Keypoint noise model, as in `e3pose replay`."""
    update: Flag = False
    """Also write the calibration into the recording, so that it can be replayed."""
    force: Flag = False
    """Write the calibration although cameras disagree with the others."""
    only: str | None = None
    """Calibrate only this camera, from people whom other cameras see too: in a recording, or in
    what the site records with `record = "keypoints"`."""


FILM, SCALE, PEOPLE = FilmOptions(), ScaleOptions(), PeopleOptions()


def extrinsics(
    *paths: str,
    intrinsics: Path | None = None,
    film: FilmOptions = FILM,
    scale: ScaleOptions = SCALE,
    people: PeopleOptions = PEOPLE,
    json_output: JsonFile = None,
) -> None:
    """Calibrate camera positions and orientations from a board, a ball, a wand or people.

    Example: `e3pose calibrate extrinsics cam1.mp4 cam2.mp4 rig.toml --intrinsics lenses.toml`

    From videos of a board: carry it through the room so that each camera sees it together with some
    other camera. --ball and --wand follow coloured balls instead; a .csv or .npz file has points
    that you found yourself.

    From people who walk about, recorded by `e3pose record` or `e3pose detect` without a
    calibration: `e3pose calibrate extrinsics walk rig.toml --height 178cm`. The error of each
    camera is estimated from how people and joints disagree; the truth is mostly within twice that.

    Only a camera that was knocked: `e3pose calibrate extrinsics room --only cam2`

    Parameters
    ----------
    paths
        VIDEO... DEST, POINTS DEST, or RECORDING DEST: the sources, then the calibration file to
        write (.toml). With --only: SITE, or RECORDING DEST.
    intrinsics
        Lenses: the file of `e3pose calibrate intrinsics`, or any calibration file. Needed for
        videos and points. Default for a recording: its own, or found from the people.
    json_output
        Write the result here as JSON; - is standard output, which then contains nothing else.
    """
    if people.only is not None:
        given = replace(people, only=None, seconds=PEOPLE.seconds, noise=None)
        if intrinsics is not None or (film, scale, given) != (FILM, SCALE, PEOPLE):
            raise InputError("--only: expected with --seconds, --noise and --json at most")
        place_again(paths, people.only, people.seconds, people.noise, json_output)
        return
    if len(paths) < 2:
        found = plural(len(paths), "path")
        raise InputError(
            f"VIDEO... DEST: found {found}, expected videos or a recording, then the file"
        )
    *sources, last = paths
    dest = toml_path(last)
    lenses = None if intrinsics is None else load_rig(intrinsics)
    places = _places(sources, lenses, film, scale.known(), people)
    save_rig(known_lenses(places.rig), dest)
    if people.update:
        save_rig(known_lenses(places.rig), Path(sources[0]) / "calibration.toml")
    write_json(json_output, _values(places))
    if not is_stdout(json_output):
        print("\n".join(_lines(places)))
        wrote(dest, f"{len(places.rig)} cameras, metres, z up")
    first = Path(sources[0])
    if (first / "recording.toml").is_file():
        warn_of_problems(replace(load_recording(first), rig=places.rig), first, dest)


def _places(
    sources: Sequence[str],
    lenses: Rig | None,
    film: FilmOptions,
    known: KnownLength,
    people: PeopleOptions,
) -> Places:
    """Calibrate from a recording, from points or from videos, whichever the sources are."""
    first = Path(sources[0])
    carried = film.carried(known)
    if len(sources) == 1 and (first / "recording.toml").is_file():
        if carried is not None or film.board != DEFAULT_BOARD:
            raise InputError(
                f"--board, --ball, --wand: found one beside {first}, a recording of people, "
                "expected videos"
            )
        return _people(first, lenses, known, people)
    if people.update:
        raise InputError("--update: expected only with a recording")
    if people.start is not None:
        raise InputError("--start: expected only with a recording")
    if lenses is None and len(sources) == 1 and not first.exists():
        raise InputError(f"{first}: file not found, expected a recording, or videos of two cameras")
    if lenses is None:
        raise InputError(
            "--intrinsics: found none, expected the file of e3pose calibrate intrinsics"
        )
    if len(sources) == 1 and first.suffix.lower() in (".csv", ".npz"):
        return _points(first, lenses, carried, known)
    return _films(sources, lenses, film, carried, known)


def _people(path: Path, lenses: Rig | None, known: KnownLength, people: PeopleOptions) -> Places:
    from e3pose.calibrate.people_places import from_people

    check_within("--seconds", people.seconds, 1e-3, MOST_SECONDS)
    recording = first_seconds(load_recording(path), people.seconds)
    _check_names(recording, known)
    if lenses is not None:
        recording = replace(recording, rig=with_lenses(recording.rig, lenses))
    rough = None
    if people.start is not None:
        rough = load_rig(people.start)
        if not rough.placed:
            raise InputError(
                f"{people.start}: holds lenses without places, expected a rough calibration"
            )
        rough = rough.subset([rough.index(name) for name in recording.rig.camera_ids])
    with stage_progress() as progress:
        return from_people(
            recording, load_noise(people.noise or detector_of(recording)), rough, known, progress,
            people.force,
        )  # fmt: skip


def _check_names(recording: Recording, known: KnownLength) -> None:
    """Refuse a joint or camera that the recording lacks before minutes of computing."""
    for option, given, names in (
        ("--limb", known.limb, recording.skeleton.joints),
        ("--distance", known.distance, recording.rig.camera_ids),
    ):
        for name in () if given is None else given[:2]:
            if name not in names:
                raise InputError(f"{option}: found {name!r}, expected two of {', '.join(names)}")


def _points(path: Path, lenses: Rig, carried: str | Wand | None, known: KnownLength) -> Places:
    from e3pose.calibrate.places import from_points_seen, from_wand_seen

    if isinstance(carried, str):
        raise InputError("--ball: expected films; of points, pass --distance or --wand")
    if carried is not None:
        return from_wand_seen(lenses, carried, load_markers(path, lenses, carried.markers))
    return from_points_seen(lenses, load_points(path, lenses), known)


def _films(
    sources: Sequence[str],
    lenses: Rig,
    film: FilmOptions,
    carried: str | Wand | None,
    known: KnownLength,
) -> Places:
    from e3pose.calibrate.places import from_ball_films, from_board_films

    rate = film.rate
    check_within("--rate", rate, 0.1, 240)
    named = name_videos(sources)
    used = lenses.subset([lenses.index(name) for name in named])
    offsets = camera_seconds(film.offset or [])
    for name in offsets:
        used.index(name)
    if len(used) < 2:
        raise InputError(f"VIDEO...: found {len(used)} video, expected at least two cameras")
    if carried is not None:
        if isinstance(carried, str):
            check_colours("--ball", (carried,))
        else:
            check_colours("--wand", carried.markers)
        return from_ball_films(named, used, carried, offsets, rate, known)
    if known.height_m is not None or known.distance is not None or known.limb is not None:
        raise InputError("--height, --distance, --limb: the board states the scale, expected none")
    with camera_bar() as bar:
        return from_board_films(named, used, Board.parse(film.board), offsets, rate, bar)


def _pair(option: str, word: str) -> tuple[str, str, float]:
    names, equals, length = word.rpartition("=")
    first, comma, second = names.partition(",")
    if not (equals and comma and first and second):
        raise InputError(f"{option}: found {word[:60]!r}, expected A,B=LENGTH such as a,b=3.2m")
    with as_typed({"": option}):
        return first, second, length_m(length)


def expected_values(errors: CameraErrors | None, camera: int) -> dict[str, float | None]:
    """Return the expected errors of cameras, for JSON; nothing where nobody asked."""
    if errors is None:
        return {}
    return {
        "expected_error_deg": number_or_null(errors.expected_deg[camera]),
        "expected_error_mm": number_or_null(errors.expected_mm[camera]),
        "expected_error_rays_deg": number_or_null(errors.expected_rays_deg[camera]),
        "focal_share": number_or_null(errors.focal_share[camera]),
    }


def _values(places: Places) -> dict[str, Any]:
    names = places.rig.camera_ids
    return {
        "source": places.source,
        "cameras": [
            {
                "camera": camera.camera_id,
                "center_m": camera.center_m.tolist(),
                "focal_px": float(camera.K[0, 0]),
                **expected_values(places.expected, i),
                "reprojection_error_px": float(places.errors_px[i]),
                "outliers": float(places.outliers[i]),
                "observations": int(places.observations[i]),
                "shared_with": {
                    names[j]: int(places.together[i, j]) for j in range(len(names)) if j != i
                },
            }
            for i, camera in enumerate(places.rig.cameras)
        ],
        "scale_from": None if places.scale is None else places.scale.known_from,
        "scale_share": None if places.scale is None else places.scale.share,
        "world": places.world,
        "next": places.notes,
    }


def _lines(places: Places) -> list[str]:
    names = places.rig.camera_ids
    lines = [f"from {places.source}; world: {places.world}"]
    if places.scale is not None:
        sure = f"{100 * places.scale.share:.1g} %"
        lines.append(f"scale: {places.scale.known_from}, good to about {sure}")
    lines += _table(places, names)
    return lines + [f"next: {words}" for words in places.notes]


def _table(places: Places, names: Sequence[str]) -> list[str]:
    """Return a row per camera, as narrow as a terminal is."""
    width = max(len("camera"), *(len(name) for name in names))
    heads = f"{'camera':{width}}  error px  outliers  points      x m    y m    z m  focal px"
    lines = [f"{heads}  shares with"]
    for i, camera in enumerate(places.rig.cameras):
        x, y, z = (value + 0.0 for value in np.round(camera.center_m, 2).tolist())  # no -0.00
        together = enumerate(places.together[i].tolist())
        most = sorted((-shared, j) for j, shared in together if j != i and shared > 0)
        others = ", ".join(names[j] for _, j in most[:2])
        found = "*" if camera.lens_assumed else " "
        lines.append(
            f"{names[i]:{width}}  {places.errors_px[i]:8.2f}  {100 * places.outliers[i]:6.0f} %  "
            f"{places.observations[i]:6d}  {x:7.2f}{y:7.2f}{z:7.2f}  {camera.K[0, 0]:7.0f}{found}"
            f"  {others}"
        )
    if any(camera.lens_assumed for camera in places.rig.cameras):
        lines += [
            "*: focal length found with the places. The principal point is weakly determined by",
            "   people, so the rotation error looks worse than its effect on 3D positions. Film a",
            "   board for better: e3pose calibrate intrinsics, then --intrinsics",
        ]
    if places.expected is not None:
        lines.append(f"{'camera':{width}}  expected error")
        lines += [
            f"{name:{width}}  {places.expected.expected_text(i)}{_focal(places, i)}"
            for i, name in enumerate(names)
        ]
    return lines


def _focal(places: Places, camera: int) -> str:
    """Return how sure a focal length is that was found, in words."""
    if places.expected is None or not places.rig.cameras[camera].lens_assumed:
        return ""
    return f"; focal length good to {100 * places.expected.focal_share[camera]:.1g} %"
