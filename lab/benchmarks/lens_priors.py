"""What bones, uprightness and floors say of the focal lengths of unknown lenses.

    python lab/benchmarks/lens_priors.py [--what simulated cmu pizza]

Pizza (its first half) and motion capture need the recordings that E3POSE_SHARED names.

Each case is calibrated with unknown lenses. Then the focal lengths are held at a few shares of what
was found, and all else is adjusted again. A row has the largest errors over the cameras against the
truth, as `bench_calibration.py` has them; and what a prior would look at:

- `misfit`: the mean square of residuals, as the robust loss counts it, in thousandths above the
  least; one observation in 100 tells something new, so it counts a hundredth per observation;
- `bones`: the standard deviation of the logarithm of a limb's length about its person's median,
  in percent, from the median deviation;
- `upright`: likewise, degrees between the bodies of people who stand and their mean;
- `floor`: spread of standing ankles about a plane, mm.

Two more rows hold all principal points, or all focal lengths, where the truth has them.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench_calibration import declared, recordings
from e3pose.base.errors import InputError
from e3pose.calibrate.align import floor_from_people
from e3pose.calibrate.from_people import PeopleRig, solve_people
from e3pose.calibrate.from_points import OUTLIER_SIGMAS, adjust_all
from e3pose.calibrate.people_3d import People3D, place_people
from e3pose.calibrate.people_places import scale_of
from e3pose.calibrate.places import KnownLength
from e3pose.calibrate.recordings import first_seconds
from e3pose.calibrate.uncertainty import distances, rays_apart
from e3pose.model.camera import Rig
from e3pose.model.rotations import similarity
from e3pose.recording import load_recording
from e3pose.recording.record import Recording

Floats = NDArray[np.float64]

SHARES = (0.97, 1.03)
HELD = 1e-10  # variance of what may not move
POINTS = 3000
HALF_S = 15.0  # of pizza; the second half is kept
LIMBS = tuple(
    (f"{side}_{first}", f"{side}_{second}")
    for side in ("left", "right")
    for first, second in (
        ("shoulder", "elbow"),
        ("elbow", "wrist"),
        ("hip", "knee"),
        ("knee", "ankle"),
    )
)
ACROSS = (("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"))
ROBUST = 1.4826  # standard deviation over median deviation


def cases(what: list[str]) -> Iterator[tuple[str, Recording]]:
    """Yield recordings whose rigs are the truth."""
    shared = Path(os.environ.get("E3POSE_SHARED", ""))
    if "pizza" in what:
        pizza = load_recording(shared / "data/pizza/recording")
        yield "pizza, first half", first_seconds(pizza, HALF_S)
    if "cmu" in what:
        from predictor_in_the_loop import captured, seen

        takes = [joints_m for kind, joints_m in captured(shared) if kind == "CMU"]
        yield "CMU motion", seen(max(takes, key=len), 30.0)
    if "simulated" in what:
        yield from recordings(["axes beside the middle", "errors that follow the view"], False)


def held(found: PeopleRig, parameters: list[int]) -> Floats:
    """Return what was expected of lenses, with some of their parameters held where they are."""
    assert found.solved.lenses is not None
    lenses = found.solved.lenses.copy()
    cameras = np.arange(len(lenses))
    for number in parameters:
        lenses[:, number] = 0.0
        lenses[:, :, :, number] = 0.0
        lenses[cameras, number, cameras, number] = HELD
    return np.asarray(lenses)


def with_lenses(rig: Rig, focal_px: Floats, middles_px: Floats) -> Rig:
    """Return the rig with focal lengths `(num_cameras,)` and principal points `(.., 2)`."""
    cameras = []
    for camera, focal, middle in zip(rig.cameras, focal_px, middles_px, strict=True):
        K = camera.K.copy()
        K[0, 0] = K[1, 1] = focal
        K[:2, 2] = middle
        cameras.append(replace(camera, K=K))
    return replace(rig, cameras=tuple(cameras))


def spread_of(values: Floats, person: NDArray[np.int64]) -> Floats:
    """Return deviations of finite values from the median of their person."""
    off = np.full(len(values), np.nan)
    for each in np.unique(person):
        mine = (person == each) & np.isfinite(values)
        if mine.sum() >= 20:
            off[mine] = values[mine] - np.median(values[mine])
    return np.asarray(off[np.isfinite(off)])


def upright_deg(people: People3D) -> float:
    """Return how far bodies with straight legs lean from their mean."""
    hips = people.of("left_hip", "right_hip")
    knees, ankles = (people.of(f"left_{j}", f"right_{j}") for j in ("knee", "ankle"))
    thigh, shank, body = hips - knees, knees - ankles, hips - ankles
    total = np.linalg.norm(thigh, axis=1) + np.linalg.norm(shank, axis=1)
    straight = np.linalg.norm(body, axis=1) > 0.985 * total
    if straight.sum() < 20:
        return float("nan")
    directions = body[straight] / np.linalg.norm(body[straight], axis=1, keepdims=True)
    mean = np.median(directions, axis=0)
    cosines = directions @ (mean / np.linalg.norm(mean))
    return float(np.degrees(np.median(np.arccos(np.clip(cosines, -1, 1)))))


def row(
    recording: Recording, found: PeopleRig, rig: Rig, lenses: Floats | None
) -> tuple[str, float]:
    """Return the columns of one adjustment, and its misfit."""
    joints, truth = found.joints, recording.rig
    solved = adjust_all(
        rig, joints.keypoints_px, joints.sigma_px, np.ones(len(rig), dtype=bool), lenses,
        most_points=POINTS,
    )  # fmt: skip
    assert solved is not None
    rig, residuals = solved.adjusted.rig, solved.adjusted.residuals
    square = (residuals[np.isfinite(residuals[..., 0])] ** 2).sum(axis=-1)
    misfit = float(np.mean(OUTLIER_SIGMAS**2 * np.log1p(square / OUTLIER_SIGMAS**2)))
    degrees, millimetres = distances(rig, truth)
    focal = [c.K[0, 0] / t.K[0, 0] - 1 for c, t in zip(rig.cameras, truth.cameras, strict=True)]
    people = place_people(rig, joints, recording.skeleton, recording.fps)
    factor = similarity(rig.centers_m, truth.centers_m)[0]
    people = people.scaled(factor, np.eye(3), np.zeros(3))
    bones = [
        spread_of(np.log(np.linalg.norm(people.of(a) - people.of(b), axis=1)), people.person)
        for a, b in (*LIMBS, *ACROSS)
    ]
    stature = scale_of(rig, place_people(rig, joints, recording.skeleton, recording.fps), ANY)
    try:
        floor_mm = (
            1000
            * floor_from_people(
                people.scaled(stature.factor / factor, np.eye(3), np.zeros(3))
            ).spread_m
        )
    except InputError:
        floor_mm = float("nan")
    columns = [
        f"{100 * np.mean(focal):+.1f}", f"{degrees.max():.2f}",
        f"{rays_apart(rig, truth).max():.2f}", f"{millimetres.max():.0f}",
        f"{100 * ROBUST * np.median(np.abs(np.concatenate(bones))):.3f}",
        f"{upright_deg(people):.2f}", f"{floor_mm:.1f}",
    ]  # fmt: skip
    return " | ".join(columns), misfit


ANY = KnownLength(None, None, None)


def table(name: str, recording: Recording) -> None:
    """Print the rows of a case."""
    from tests.calibrate.people_scenes import without_calibration  # where bench_calibration looks

    blind = without_calibration(replace(recording, truth=None))
    found = solve_people(blind, declared("1", recording), None)
    rig, truth = found.solved.adjusted.rig, recording.rig
    focal = np.array([camera.K[0, 0] for camera in rig.cameras])
    middles = np.stack([camera.K[:2, 2] for camera in rig.cameras])
    true_focal = np.array([np.sqrt(c.K[0, 0] * c.K[1, 1]) for c in truth.cameras])
    true_middles = np.stack([camera.K[:2, 2] for camera in truth.cameras])
    trials = {
        "as found": (rig, found.solved.lenses),
        **{
            f"focal x {share:.2f}": (with_lenses(rig, share * focal, middles), held(found, [0]))
            for share in SHARES
        },
        "focal of truth": (with_lenses(rig, true_focal, middles), held(found, [0])),
        "axes of truth": (with_lenses(rig, focal, true_middles), held(found, [2, 3])),
    }
    rows = {each: row(recording, found, *trial) for each, trial in trials.items()}
    least = min(misfit for _, misfit in rows.values())
    for each, (columns, misfit) in rows.items():
        print(f"| {name} | {each} | {columns} | {1000 * (misfit - least):.2f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--what", nargs="+", default=["pizza", "cmu", "simulated"],
        choices=("pizza", "cmu", "simulated"),
    )  # fmt: skip
    options = parser.parse_args()
    print(
        "| case | held | focal % | degrees | rays | mm | bones % | upright, degrees | floor mm "
        "| misfit |"
    )
    print("|---" * 10 + "|")
    for name, recording in cases(options.what):
        table(name, recording)


if __name__ == "__main__":
    main()
