"""What bones, uprightness and floors say of the focal lengths of unknown lenses.

    e3pose calibrate extrinsics RECORDING-WITHOUT-CALIBRATION FOUND.toml
    python lab/benchmarks/lens_priors.py RECORDING FOUND.toml [--seconds 15]

`RECORDING` has the true calibration, `FOUND.toml` the one found with unknown lenses. People are
matched by the latter; then focal lengths are held at a few shares of what was found, and all else
is adjusted again. A row has the largest errors over the cameras against the truth, as
`bench_calibration.py` has them; and what a prior would look at:

- `bones`: the standard deviation of the logarithm of a limb's length about its person's median,
  in percent, from the median deviation;
- `upright`: median degrees between the bodies of people who stand and their mean;
- `floor`: spread of standing ankles about a plane, mm;
- `misfit`: the mean square of residuals, as the robust loss counts it;
  one observation in 100 tells something new.

Two more rows hold all focal lengths, or all principal points, where the truth has them; the last
has the people whom the true calibration places.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench_calibration import cost
from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.align import floor_from_people
from e3pose.calibrate.from_points import adjust_all
from e3pose.calibrate.lenses import final_lenses
from e3pose.calibrate.matched_people import Joints, match_people
from e3pose.calibrate.moved_cameras import distances
from e3pose.calibrate.people_3d import People3D, place_people
from e3pose.calibrate.people_places import scale_of
from e3pose.calibrate.places import KnownLength
from e3pose.calibrate.recordings import first_seconds
from e3pose.calibrate.uncertainty import rays_apart
from e3pose.model.camera import Rig
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import load_recording
from e3pose.recording.calibration import load_rig
from e3pose.recording.record import Recording

SHARES = (0.97, 1.0, 1.03)
POINTS = 2000
SIDES = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
LIMBS = (
    *((f"{side}_{a}", f"{side}_{b}") for side in ("left", "right") for a, b in SIDES),
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
)
ROBUST = 1.4826  # standard deviation over median deviation
STRAIGHT = 0.985  # of thigh and shank, from which a leg is straight


def held(rig: Rig, parameters: list[int]) -> Floats:
    """Return what is expected of lenses, with some of their parameters held where they are."""
    lenses = final_lenses(rig, np.arange(len(rig)))
    assert lenses is not None
    lenses[:, parameters] = 0.0
    lenses[:, :, :, parameters] = 0.0
    return np.asarray(lenses)


def with_lenses(rig: Rig, focal_px: Floats, middles_px: Floats) -> Rig:
    """Return the rig with focal lengths `(num_cameras,)` and principal points `(.., 2)`."""
    cameras = []
    for camera, focal, middle in zip(rig.cameras, focal_px, middles_px, strict=True):
        K = camera.K.copy()
        K[0, 0] = K[1, 1] = focal
        K[:2, 2] = middle
        cameras.append(replace(camera, K=K, lens_assumed=True))
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
    straight = np.linalg.norm(body, axis=1) > STRAIGHT * total
    if straight.sum() < 20:
        return float("nan")
    directions = body[straight] / np.linalg.norm(body[straight], axis=1, keepdims=True)
    mean = np.median(directions, axis=0)
    cosines = directions @ (mean / np.linalg.norm(mean))
    return float(np.degrees(np.median(np.arccos(np.clip(cosines, -1, 1)))))


def said(recording: Recording, joints: Joints, rig: Rig) -> str:
    """Return the columns of what people say of a rig, and the truth of it."""
    truth = recording.rig
    degrees, millimetres = distances(rig, truth)
    focal = [c.K[0, 0] / t.K[0, 0] - 1 for c, t in zip(rig.cameras, truth.cameras, strict=True)]
    people = place_people(rig, joints, recording.skeleton, recording.fps)
    metres = scale_of(rig, people, KnownLength()).factor
    people = people.scaled(metres, np.eye(3), np.zeros(3))
    bones = [
        spread_of(np.log(np.linalg.norm(people.of(a) - people.of(b), axis=1)), people.person)
        for a, b in LIMBS
    ]
    try:
        floor = f"{1000 * floor_from_people(people).spread_m:.1f}"
    except InputError:
        floor = "-"
    return " | ".join([
        f"{100 * np.mean(focal):+.1f}", f"{degrees.max():.2f}",
        f"{rays_apart(rig, truth).max():.2f}", f"{millimetres.max():.0f}",
        f"{100 * ROBUST * np.median(np.abs(np.concatenate(bones))):.3f}",
        f"{upright_deg(people):.2f}", floor,
    ])  # fmt: skip


def adjusted(joints: Joints, rig: Rig, lenses: Floats) -> tuple[Rig, float]:
    """Return a rig adjusted again, and its misfit."""
    everyone = np.ones(len(rig), dtype=bool)
    solved = adjust_all(
        rig, joints.keypoints_px, joints.sigma_px, everyone, lenses, most_points=POINTS
    )
    assert solved is not None
    return solved.adjusted.rig, cost(solved.adjusted, None)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("found", type=Path)
    parser.add_argument("--seconds", type=float, default=15.0)
    options = parser.parse_args()
    recording = first_seconds(load_recording(options.recording), options.seconds)
    truth, found = recording.rig, load_rig(options.found)
    found = found.subset([found.index(name) for name in truth.camera_ids])
    noise = load_noise(detector_of(recording))
    joints = match_people(replace(recording, rig=found), noise, found)
    focal = np.array([camera.K[0, 0] for camera in found.cameras])
    middles = np.stack([camera.K[:2, 2] for camera in found.cameras])
    true_focal = np.array([np.sqrt(c.K[0, 0] * c.K[1, 1]) for c in truth.cameras])
    true_middles = np.stack([camera.K[:2, 2] for camera in truth.cameras])
    trials = {
        **{f"focal x {share:.2f}": (share * focal, middles, [0]) for share in SHARES},
        "focal of truth": (true_focal, middles, [0]),
        "axes of truth": (focal, true_middles, [2, 3]),
    }
    print("| held | focal % | degrees | rays | mm | bones % | upright | floor mm | misfit |")
    print("|---" * 9 + "|")
    for name, (lengths, points, parameters) in trials.items():
        start = with_lenses(found, lengths, points)
        rig, misfit = adjusted(joints, start, held(start, parameters))
        print(f"| {name} | {said(recording, joints, rig)} | {misfit:.4f} |", flush=True)
    print(f"| truth | {said(recording, joints, truth)} | |", flush=True)


if __name__ == "__main__":
    main()
