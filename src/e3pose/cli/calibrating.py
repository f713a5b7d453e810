"""`e3pose calibrate`: its verbs, of which `align` and `check` are told here, and the lab's `noise`.

The floor under a rig, and how good a calibration is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import App, Group, Parameter

from e3pose.base.atomic import check_output
from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within, length_m
from e3pose.calibrate.board import Board
from e3pose.calibrate.board_views import find_board
from e3pose.calibrate.recordings import first_seconds
from e3pose.cli.calibrating_lenses import (
    DEFAULT_BOARD,
    board,
    check_picture,
    intrinsics,
    toml_path,
)
from e3pose.cli.calibrating_places import expected_values, extrinsics
from e3pose.cli.distributions import add_absent
from e3pose.cli.options import Flag, as_typed
from e3pose.cli.output import JsonFile, is_stdout, number_or_null, write_json
from e3pose.cli.placed import warn_of_problems, without_unplaced
from e3pose.cli.progress import stage_progress
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import load_recording
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.recording.calibration.world import require_placed, world_problem
from e3pose.recording.pairing import name_videos

if TYPE_CHECKING:
    from e3pose.calibrate.align import Move
    from e3pose.calibrate.judge import Judgement
    from e3pose.model.camera import Rig

Words = Annotated[list[str] | None, Parameter(negative="")]


@Parameter(name="*", group=Group("Floor", sort_key=1))
@dataclass(frozen=True, kw_only=True)
class FloorOptions:
    """Where the vertical and the floor come from."""

    up: str | None = None
    """Axis that points up in SOURCE: x, y, z, -x, -y or -z."""
    floor: Words = None
    """CAMERA=IMAGE: an image of the board lying on the floor; repeatable."""
    board: str = DEFAULT_BOARD
    """Board name, as printed on it."""
    points: Words = None
    """x,y,z in metres in the world of SOURCE; give it three times: the origin, a point on the x
    axis, and another point of the floor to the left of it."""
    height: str = "170cm"
    """Body height of the people, from which the height of their ankles follows."""
    seconds: float = 120.0
    """With a recording: use this many seconds from its start."""

    def move(self, rig: Rig, source: Path, is_recording: bool) -> tuple[Move, str] | None:
        """Return how the world moves, and why in words; None where nothing says it."""
        from e3pose.calibrate.align import from_axis

        if sum(value is not None for value in (self.up, self.floor, self.points)) > 1:
            raise InputError("--up, --floor, --points: found several, expected at most one")
        if self.up is not None:
            return from_axis(self.up), f"{self.up} became z"
        if self.floor is not None:
            found = _board_floor(rig, self.floor, self.board)
            return found, "floor of the board that lies on it"
        if self.points is not None:
            return _three_points(self.points), "floor of the three points"
        if is_recording:
            with as_typed({"": "--height"}):
                height_m = length_m(self.height)
            return _people_floor(source, height_m, self.seconds)
        return None


FLOOR = FloorOptions()


def align(
    source: Path,
    dest: str,
    /,
    *,
    floor: FloorOptions = FLOOR,
    origin: str = "keep",
    x_axis: str = "keep",
    update: Flag = False,
) -> None:
    """Align the world of a calibration: z up, floor at zero, origin and axes of your choice.

    Example: `e3pose calibrate align walk rig.toml --x-axis cam1`

    With a recording of people, the vertical comes from upright bodies and the floor from resting
    feet. Without one: --up if another axis points up, --floor for images of the board lying on the
    floor, or --points for three points of the floor.

    Parameters
    ----------
    source
        A recording with its calibration, or a calibration file for --up, --floor and --points.
    dest
        The calibration file (.toml) to write.
    origin
        New origin: `keep`, x,y in metres, or a camera (the floor below it).
    x_axis
        `keep`, or the camera or x,y in metres to which the x axis points.
    update
        With a recording: also replace its calibration.
    """
    from e3pose.calibrate.align import STAY, with_origin

    path = toml_path(dest)
    is_recording = (source / "recording.toml").is_file()
    if update and not is_recording:
        raise InputError("--update: expected only with a recording")
    chosen = (origin, x_axis) != ("keep", "keep")
    rig = load_rig(source / "calibration.toml" if is_recording else source)
    require_placed(rig, source)
    found = floor.move(rig, source, is_recording)
    if found is None and not chosen:
        raise InputError(
            f"{source}: found a calibration, expected --up, --floor or --points with it, or a "
            "recording of people"
        )
    move, words = found or (STAY, "the vertical and the floor are kept")
    moved = move.rig(rig)
    if chosen:
        moved = with_origin(moved, origin, x_axis).rig(moved)
    save_rig(moved, path)
    if update:
        save_rig(moved, source / "calibration.toml")
    if is_recording:
        warn_of_problems(replace(load_recording(source), rig=moved), source, path)
    angle = np.degrees(np.arccos(np.clip((np.trace(move.R) - 1) / 2, -1, 1)))
    print(f"{path}: {words}; the world turned by {angle:.1f} degrees")
    for camera in moved.cameras:
        x, y, z = (value + 0.0 for value in np.round(camera.center_m, 2).tolist())  # no -0.00
        print(f"  {camera.camera_id}: at {x:.2f} {y:.2f} {z:.2f} m")
    problem = world_problem(moved, path)[1]
    if problem:
        print(f"next: {problem}")


def check(
    recording: Path,
    /,
    *,
    calibration: Path | None = None,
    picture: Path | None = None,
    seconds: float = 120.0,
    noise: str | None = None,
    json_output: JsonFile = None,
) -> None:
    """Check a calibration with a recording of people: errors in pixels and in millimetres.

    Example: `e3pose calibrate check walk --picture error.png`

    Each camera is compared with the people that the other cameras triangulate (leave-one-out). The
    expected error of a camera is the difference from a calibration that is refined on these
    people, and how sure that one is; the 3D error over the floor follows from it and from keypoint
    noise. Use a recording that the calibration was not made from.

    Parameters
    ----------
    recording
        Recording folder: people who walk through the whole room.
    calibration
        Calibration file to check instead of the recording's own.
    picture
        Draw a map of the expected error over the floor here (.png or .svg).
    seconds
        Use this many seconds from the start of the recording.
    noise
        Keypoint noise model, as in `e3pose replay`.
    json_output
        Write the result here as JSON; - is standard output, which then contains nothing else.
    """
    from e3pose.calibrate.expected_error import draw_error
    from e3pose.calibrate.judge import judge

    check_within("--seconds", seconds, 1e-3, 3600)
    if picture is not None:
        check_picture("--picture", picture)
        check_output(picture)
    loaded = first_seconds(load_recording(recording), seconds)
    if calibration is not None:
        rig = load_rig(calibration)
        own = [rig.index(name) for name in loaded.rig.camera_ids]
        loaded = replace(loaded, rig=rig.subset(own))
    loaded = without_unplaced(loaded, calibration or recording)
    file = calibration or recording / "calibration.toml"
    require_placed(loaded.rig, calibration or recording)
    warn_of_problems(loaded, recording, file)
    with stage_progress() as progress:
        found = judge(loaded, load_noise(noise or detector_of(loaded)), progress)
    if picture is not None:
        draw_error(picture, found.room, loaded.rig)
    write_json(json_output, _values(loaded.rig, found))
    if not is_stdout(json_output):
        print("\n".join(_lines(loaded.rig, found)))


def _people_floor(path: Path, stature_m: float, seconds: float) -> tuple[Move, str]:
    from e3pose.calibrate.people_places import floor_of

    floor = floor_of(first_seconds(load_recording(path), seconds), stature_m)
    words = (
        f"floor and vertical of people ({floor.moments} upright moments, standing ankles spread "
        f"by {1000 * floor.spread_m:.0f} mm)"
    )
    return (
        floor.move,
        words if floor.tilted else f"{words}; in one place only, so the vertical is less certain",
    )


def _board_floor(rig: Rig, pictures: list[str], name: str) -> Move:
    from e3pose.calibrate.align import from_board
    from e3pose.calibrate.from_boards import board_on_floor
    from e3pose.calibrate.places import check_size

    board = Board.parse(name)
    board.check_oriented()
    corners = np.full((len(rig), len(board.corners_m), 2), np.nan)
    for camera_id, path in name_videos(pictures).items():
        views = find_board(camera_id, path, board, max_frames=30)
        check_size(rig, camera_id, views.image_size)
        if len(views.corners_px):
            most = np.isfinite(views.corners_px[..., 0]).sum(axis=1).argmax()
            corners[rig.index(camera_id)] = views.corners_px[most]
    placed = board_on_floor(rig, board.corners_m, corners)
    middle = np.eye(4)
    middle[:2, 3] = np.array([board.columns, board.rows]) * board.square_m / 2
    return from_board(placed @ middle, rig)


def _three_points(words: list[str]) -> Move:
    from e3pose.calibrate.align import from_three_points

    try:
        places = [np.array([float(value) for value in word.split(",")]) for word in words]
    except ValueError:
        places = []
    if len(places) != 3 or any(place.shape != (3,) for place in places):
        raise InputError("--points: expected x,y,z three times, such as --points=0,0,0.1")
    return from_three_points(*places)


def _values(rig: Rig, found: Judgement) -> dict[str, Any]:
    from e3pose.calibrate.judge import poor_pairs

    total = found.room.total_mm
    known = total[np.isfinite(total)]
    return {
        "cameras": [
            {
                "camera": name,
                "reprojection_error_px": number_or_null(found.errors_px[i]),
                "shift_px": [number_or_null(value) for value in found.shifts_px[i]],
                "sigma_px": number_or_null(found.sigma_px[i]),
                "keypoints": int(found.joints[i]),
                **expected_values(found.errors, i),
                "people_turn_it_deg": number_or_null(found.errors.moved_deg[i]),
                "people_move_it_mm": number_or_null(found.errors.moved_mm[i]),
            }
            for i, name in enumerate(rig.camera_ids)
        ],
        "expected_error_mm": {
            "median": number_or_null(np.median(known)) if len(known) else None,
            "worst": number_or_null(known.max()) if len(known) else None,
            "from_noise": number_or_null(np.nanmedian(found.room.noise_mm)) if len(known) else None,
            "x_m": found.room.x_m.tolist(),
            "y_m": found.room.y_m.tolist(),
            "map": [[number_or_null(value) for value in row] for row in total],
        },
        "poor_pairs": poor_pairs(rig, found),
        "next": found.next_steps,
    }


def _lines(rig: Rig, found: Judgement) -> list[str]:
    from e3pose.calibrate.judge import poor_pairs

    width = max(len(name) for name in rig.camera_ids)
    lines = [f"{'camera':{max(width, 6)}}  error px  shift px       expected error"]
    for i, name in enumerate(rig.camera_ids):
        if np.isnan(found.errors_px[i]):
            lines.append(f"{name:{max(width, 6)}}  no person seen that others saw: not judged")
            continue
        shift = f"({found.shifts_px[i, 0]:+.1f}, {found.shifts_px[i, 1]:+.1f})"
        words = found.errors.expected_text(i)
        lines.append(f"{name:{max(width, 6)}}  {found.errors_px[i]:8.1f}  {shift:13}  {words}")
    total = found.room.total_mm
    if np.isfinite(total).any():
        parts = [f"noise {np.nanmedian(found.room.noise_mm):.0f}"]
        if np.isfinite(found.room.calibration_mm).any():
            parts.append(f"calibration {np.nanmedian(found.room.calibration_mm):.0f}")
        lines.append(
            f"expected error of a joint: {np.nanmedian(total):.0f} mm in the median over the floor "
            f"({', '.join(parts)}), {np.nanmax(total):.0f} at worst"
        )
    lines += [f"poor pair: {words}" for words in poor_pairs(rig, found)]
    lines += [f"next: {words}" for words in found.next_steps]
    return lines


calibrate_app = App(
    name="calibrate", help="Calibrate cameras, check a calibration, and measure keypoint noise."
)
for _verb in (board, intrinsics, extrinsics, align, check):  # in the order in which they are called
    calibrate_app.command(_verb)
add_absent(calibrate_app)
