"""The steps that solve and check: cameras from the people of a walk, floor and axes; a judge."""

from __future__ import annotations

import base64
from dataclasses import replace
from typing import Any

import numpy as np

from e3pose.base.errors import InputError
from e3pose.calibrate.align import with_origin
from e3pose.calibrate.judge import Judgement, judge, poor_pairs
from e3pose.calibrate.people_3d import People3D
from e3pose.calibrate.people_places import floor_of, from_people, people_of
from e3pose.calibrate.places import KnownLength, Places
from e3pose.calibrate.recordings import first_seconds, known_lenses
from e3pose.model.camera import Rig
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import Recording, load_recording
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.site.setup.session import SetupSession, keep_before
from e3pose.site.setup.tasks import Task
from e3pose.site.setup.walking import Snapshots

SECONDS = 120.0  # of a walk that are used, as `calibrate extrinsics` has it
LEAST_CM, MOST_CM = 50.0, 250.0
GOOD_MM, POOR_MM = 40.0, 80.0  # expected errors below the first are good, above the second poor
RECORDED_RIG = "calibration.toml"


def solve_command(setup: SetupSession, height_cm: float) -> str:
    """Return the command lines that solve."""
    walk, rig = (
        setup.shown(setup.folder / (setup.plan().walk or "walk")),
        setup.shown(setup.calibration),
    )
    height = f" --height {height_cm:g}cm" if height_cm else ""
    return (
        f"e3pose calibrate extrinsics {walk} {rig}{height} --update\n"
        f"e3pose calibrate align {walk} {rig}{height} --update"
    )


def start_solving(setup: SetupSession, height_cm: float) -> None:
    """Calibrate from the newest walk in the background.

    Args:
        setup: whose site.
        height_cm: of the person who walked; 0 if nobody knows.

    Raises:
        InputError: for a height that no person has, or where no walk was recorded.
    """
    if height_cm and not LEAST_CM <= height_cm <= MOST_CM:
        raise InputError("height", f"{height_cm:g} cm", f"{LEAST_CM:g} to {MOST_CM:g} cm")
    plan = setup.plan()
    if not plan.walk:
        raise InputError("walk", "none", "a recorded walk first")
    command = solve_command(setup, height_cm)
    setup.change(lambda now: replace(now, height_cm=height_cm))

    def solve(task: Task) -> None:
        path = setup.folder / plan.walk
        task.progress("reading the walk", 0, 0)
        recording = first_seconds(load_recording(path), SECONDS)
        noise = load_noise(detector_of(recording))
        known = KnownLength(height_cm / 100 if height_cm else None)
        places = from_people(recording, noise, None, known, task.progress)
        task.progress("finding the floor", 0, 0)
        rig, notes = known_lenses(places.rig), places.notes
        try:
            stature_m = height_cm / 100 if height_cm else 1.7
            rig = floor_of(replace(recording, rig=rig), stature_m).move.rig(rig)
        except InputError as error:  # the floor is not found: it stays as it came
            notes = [*notes, str(error)]
        keep_before(setup.calibration)
        save_rig(rig, setup.calibration)
        save_rig(rig, path / RECORDED_RIG)
        setup.change(lambda now: replace(now, picked_origin=False, second=""))
        setup.keep_result("check", None)
        setup.keep_result("solve", _result(replace(places, rig=rig, notes=notes)))

    setup.start(Task("solve", "Finding the cameras", command), solve)


def _result(places: Places) -> dict[str, Any]:
    names = places.rig.camera_ids
    return {
        "cameras": [
            {
                "id": name,
                "words": camera_words(places, i),
                "grade": grade(_expected_mm(places, i)),
                "shared": int(places.together[i].sum() - places.together[i, i]),
            }
            for i, name in enumerate(names)
        ],
        "scale": "" if places.scale is None else (
            f"Sizes are from {places.scale.known_from}, good to about "
            f"{100 * places.scale.share:.1g} %."
        ),
        "notes": places.notes,
    }  # fmt: skip


def _expected_mm(places: Places, camera: int) -> float:
    return np.nan if places.expected is None else float(places.expected.expected_mm[camera])


def camera_words(places: Places, camera: int) -> str:
    """Return how well a camera was placed, in words."""
    if places.expected is None or np.isnan(places.expected.expected_deg[camera]):
        return "Found; two cameras cannot tell each other's error."
    mm, degrees = _expected_mm(places, camera), float(places.expected.expected_deg[camera])
    return f"Placed to within about {mm:.0f} mm and {degrees:.1f} degrees."


def grade(expected_mm: float) -> str:
    """Return good, fair or poor for an expected error; unknown for NaN."""
    if np.isnan(expected_mm):
        return "unknown"
    return "good" if expected_mm <= GOOD_MM else "fair" if expected_mm <= POOR_MM else "poor"


def move_world(setup: SetupSession, camera_id: str, x: float, y: float, what: str) -> str:
    """Put the origin or the x axis at a clicked point of a picture.

    Args:
        setup: whose site.
        camera_id: in whose picture.
        x: of the click, pixels of the full image.
        y: likewise.
        what: `origin` or `x-axis`.

    Returns:
        The command line that does the same.

    Raises:
        InputError: where the click meets no floor, or nothing is calibrated.
    """
    setup.tasks.check_free()
    rig = load_rig(setup.calibration)
    place = floor_at(rig, camera_id, (x, y))
    words = f"{place[0]:.3f},{place[1]:.3f}"
    origin, facing = (words, "keep") if what == "origin" else ("keep", words)
    move = with_origin(rig, origin, facing)
    keep_before(setup.calibration)
    save_rig(move.rig(rig), setup.calibration)
    path = setup.folder / setup.plan().walk / RECORDED_RIG
    if setup.plan().walk and path.exists() and (walked := load_rig(path)).placed:
        save_rig(move.rig(walked), path)
    setup.change(lambda plan: replace(plan, picked_origin=True))
    results = setup.results()
    if results.get("check"):  # its map is of the world of before
        setup.keep_result("check", None)
    option = "--origin" if what == "origin" else "--x-axis"
    files = " ".join(2 * [setup.shown(setup.calibration)])
    return f"e3pose calibrate align {files} {option}={words}"


def floor_at(rig: Rig, camera_id: str, pixel: tuple[float, float]) -> tuple[float, float]:
    """Return where a pixel of a camera shows the floor, metres.

    Raises:
        InputError: for another camera, a rig without places, or a pixel above the horizon.
    """
    if not rig.placed:
        raise InputError("calibration", "lenses without places", "a solved one")
    camera = rig.cameras[rig.index(camera_id)]
    width, height = camera.image_size
    if not (0 <= pixel[0] <= width and 0 <= pixel[1] <= height):
        raise InputError("click", f"{pixel[0]:g}, {pixel[1]:g}", "a place in the picture")
    ray = camera.rays(np.array([pixel]))[0]
    if ray[2] > -0.02 or camera.center_m[2] <= 0:
        raise InputError("click", "a place that shows no floor", "one on the floor")
    x, y = (camera.center_m - ray * (camera.center_m[2] / ray[2]))[:2].tolist()
    return float(x), float(y)


def overlays(setup: SetupSession, snapshots: Snapshots) -> dict[str, Any]:
    """Return a picture per camera, with the solved people and the measured keypoints.

    Raises:
        InputError: where nothing is solved.
    """
    plan = setup.plan()
    if not plan.walk or not setup.placed():
        raise InputError("calibration", "none", "a solved walk first")
    recording = first_seconds(load_recording(setup.folder / plan.walk), SECONDS)
    recording = replace(recording, rig=load_rig(setup.calibration))
    people = people_of(recording)
    return {
        "limbs": [list(limb) for limb in recording.skeleton.limbs],
        "cameras": [_overlay(recording, people, snapshots, i) for i in range(len(recording.rig))],
        "axes": [_axes(recording.rig, i) for i in range(len(recording.rig))],
    }


def _overlay(
    recording: Recording, people: People3D, snapshots: Snapshots, camera: int
) -> dict[str, Any]:
    seen = recording.rig.cameras[camera]
    taken = {picture.slot: picture for picture in snapshots.pictures.get(seen.camera_id, ())}
    slots = np.unique(people.slot)
    chosen = [slot for slot in taken if slot in slots] or slots.tolist()
    best, most = None, -1
    for slot in chosen if taken else chosen[:: max(1, len(chosen) // 50)]:
        view = recording.view(slot, camera)
        joints = 0 if view is None else int((view.scores > 0).sum())
        if joints > most:
            best, most = slot, joints
    picture = taken.get(best) if best is not None else None
    view = None if best is None else recording.view(best, camera)
    solved: Any = [] if best is None else seen.project(people.joints[people.slot == best])
    return {
        "id": seen.camera_id,
        "size": seen.image_size,
        "jpeg": None if picture is None else base64.b64encode(picture.jpeg).decode(),
        "measured": [] if view is None else [
            _pixels(np.where((scores > 0)[:, None], keypoints, np.nan))
            for keypoints, scores in zip(view.keypoints_px, view.scores, strict=True)
        ],
        "solved": [_pixels(person) for person in solved],
    }  # fmt: skip


def _axes(rig: Rig, camera: int) -> list[list[float] | None]:
    """Return where a camera sees the origin, and a metre along x and y; None if it does not."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    lens = rig.cameras[camera]
    ahead = (points - lens.center_m) @ lens.R[2] > 0.1
    return _pixels(np.where(ahead[:, None], lens.project(points), np.nan))


def _pixels(points_px: Any) -> list[list[float] | None]:
    return [
        [round(float(x), 1), round(float(y), 1)] if np.isfinite([x, y]).all() else None
        for x, y in points_px
    ]


def check_command(setup: SetupSession) -> str:
    """Return the command line that checks."""
    walk = setup.shown(setup.folder / (setup.plan().second or "second"))
    return (
        f"e3pose calibrate check {walk} --calibration {setup.shown(setup.calibration)} "
        "--picture error.png"
    )


def start_checking(setup: SetupSession) -> None:
    """Judge the calibration by the second walk, in the background.

    Raises:
        InputError: where no second walk was recorded.
    """
    plan = setup.plan()
    if not plan.second:
        raise InputError("second walk", "none", "one that the calibration was not made from")

    def check(task: Task) -> None:
        task.progress("reading the second walk", 0, 0)
        recording = first_seconds(load_recording(setup.folder / plan.second), SECONDS)
        rig = load_rig(setup.calibration)
        rig = rig.subset([rig.index(name) for name in recording.rig.camera_ids])
        noise = load_noise(detector_of(recording))
        found = judge(replace(recording, rig=rig), noise, task.progress)
        setup.keep_result("check", result(rig, found))

    setup.start(Task("check", "Checking the calibration", check_command(setup)), check)


def result(rig: Rig, found: Judgement) -> dict[str, Any]:
    """Return a judgement for the page."""
    total = found.room.total_mm
    known = total[np.isfinite(total)]
    median, worst = (float(np.median(known)), float(known.max())) if len(known) else (np.nan,) * 2
    shares = [float(part.mean()) for part in (
        known <= GOOD_MM, (known > GOOD_MM) & (known <= POOR_MM), known > POOR_MM
    )] if len(known) else []  # fmt: skip
    return {
        "good_mm": GOOD_MM,
        "poor_mm": POOR_MM,
        "verdict": verdict(median, worst, shares),
        "grade": grade(median),
        "x_m": found.room.x_m.round(3).tolist(),
        "y_m": found.room.y_m.round(3).tolist(),
        "map_mm": [[round(v, 1) if np.isfinite(v) else None for v in row] for row in total],
        "centers": [
            {"id": camera.camera_id, "x": float(camera.center_m[0]), "y": float(camera.center_m[1])}
            for camera in rig.cameras
        ],
        "cameras": [
            {
                "id": name,
                "words": f"{found.errors_px[i]:.1f} px off where the others see people"
                if np.isfinite(found.errors_px[i]) else "saw no person that others saw",
                "expected": found.errors.expected_text(i),
            }
            for i, name in enumerate(rig.camera_ids)
        ],
        "next": [*found.next_steps, *(f"poor pair: {words}" for words in poor_pairs(rig, found))],
    }  # fmt: skip


def verdict(median_mm: float, worst_mm: float, shares: list[float]) -> str:
    """Return in one sentence how good a calibration is.

    Args:
        median_mm: of the error expected over the floor; NaN if it is known nowhere.
        worst_mm: likewise, the largest.
        shares: of the floor that is good, fair, poor.
    """
    if np.isnan(median_mm):
        return "No place of the floor was seen by two cameras at once."
    quality = {"good": "Good", "fair": "Usable", "poor": "Poor"}[grade(median_mm)]
    return (
        f"{quality}: a joint is expected to be {median_mm:.0f} mm off in the median over the "
        f"floor, {worst_mm:.0f} mm at the worst place; {100 * shares[0]:.0f} % of the floor is "
        "green."
    )
