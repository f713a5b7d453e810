"""Calibration from people against known truth: simulated scenes and published rigs.

    python lab/benchmarks/bench_calibration.py [--cases "NAME;..."] [--lenses known] [--real]
        [--others PYTHON]

`--real` adds the rigs of `E3POSE_SHARED`, against their published calibration. `--others` names the
interpreter of an environment with caliscope 0.11.8 and aniposelib 0.8.0, which calibrate from the
points that e3pose matched; aniposelib from a start 5 degrees and 20 cm off, as it has no other.

Errors are the largest over the cameras, after the similarity transform that fits the cameras best.
`rays` is how far the rays of the image's middle half are turned, which is what places people: where
the axis of a lens is beside the middle of its image, its camera seems turned, but its rays are not.
`of stated` is the largest error as a share of what `extrinsics` states for that camera. `cost` is
what the adjustment minimises, by observation. `from truth` is the true rig adjusted to the same
keypoints: its cost, degrees and mm. Where that is right at a lower cost, the search began wrongly;
where it ends at the same errors, these keypoints prefer them to the truth.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.calibrate.align import Move
from e3pose.calibrate.bundle import Adjusted, lens_precision
from e3pose.calibrate.from_people import FINAL_POINTS, PeopleRig, solve_people
from e3pose.calibrate.from_points import OUTLIER_SIGMAS, adjust_all
from e3pose.calibrate.moved_cameras import LENS, NUM_PARAMETERS, Cameras, distances
from e3pose.calibrate.uncertainty import camera_errors, likely_rigs, rays_apart
from e3pose.model.camera import Rig
from e3pose.model.noises import detector_of, load_noise
from e3pose.model.rotations import similarity
from e3pose.recording import load_recording
from e3pose.recording.calibration.world import assumed_rig
from e3pose.recording.record import Recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.scenes import GUESSES

sys.path.append(str(Path(__file__).resolve().parents[2]))  # scenes of the tests

from tests.calibrate.people_scenes import decentred, disturbed, without_calibration

from e3pose_lab.datasets import shared_folder

COLUMNS = (
    "case", "lenses", "degrees", "rays", "mm", "focal %", "of stated", "cost", "from truth",
)  # fmt: skip
WALK = SceneSettings(seconds=30.0, fps=5.0, cameras=4)
MOST_POINTS = 3000  # for the others
CASES: dict[str, tuple[SceneSettings, int]] = {
    "ring, one person": (replace(WALK, people=1), 821),
    "ring, six cameras": (replace(WALK, people=3, cameras=6), 822),
    "errors that follow the view": (replace(WALK, people=2, detector=GUESSES), 823),
    "axes beside the middle": (replace(WALK, people=2), 824),
    "meeting": (SceneSettings(scene="meeting", seconds=30.0, fps=5.0), 825),
    "buffet": (SceneSettings(scene="buffet", seconds=30.0, fps=5.0), 826),
    "reception": (SceneSettings(scene="reception", seconds=30.0, fps=5.0), 827),
    "round-table": (SceneSettings(scene="round-table", seconds=30.0, fps=5.0), 828),
    "lab": (SceneSettings(scene="lab", seconds=30.0, fps=5.0), 829),
    "operating-room": (SceneSettings(scene="operating-room", seconds=40.0), 830),
}
ASIDE = 0.015  # of the longer side, by which axes are beside the middle


def recordings(names: list[str], real: bool, seed: int | None) -> Iterator[tuple[str, Recording]]:
    """Yield what to calibrate; the rig is the truth."""
    for name in names:
        settings, own = CASES[name]
        number = own if seed is None else seed
        recording = simulate(settings, number)
        yield name, decentred(recording, ASIDE, number) if "axes" in name else recording
    if real:
        from e3pose_lab.datasets.shelf import import_shelf

        shared = shared_folder() / "data"
        yield "pizza", load_recording(shared / "pizza" / "recording")
        yield "Shelf", import_shelf(shared / "shelf" / "shelf.npz")


def cost(adjusted: Adjusted, lenses: Floats | None) -> float:
    """Return the robust square of residuals with what is expected of lenses, by observation.

    Args:
        adjusted: a rig.
        lenses: what was expected, as `AdjustOptions` has it; None for the residuals alone.
    """
    residuals = adjusted.residuals[np.isfinite(adjusted.residuals[..., 0])]
    squares = (residuals**2).sum(axis=-1)
    total = float(OUTLIER_SIGMAS**2 * np.log1p(squares / OUTLIER_SIGMAS**2).sum())
    off = np.zeros((len(adjusted.rig), NUM_PARAMETERS))
    off[:, LENS] = Cameras.of(adjusted.rig).lenses
    total += float(off.reshape(-1) @ lens_precision(lenses, len(off)) @ off.reshape(-1))
    return total / len(residuals)


def costs(truth: Rig, found: PeopleRig) -> str:
    """Return the cost of a rig from people; then cost and errors of the truth adjusted likewise."""
    solved, joints, rig = found.solved, found.joints, found.solved.adjusted.rig
    # Where outliers are placed depends on the origin, and with it one or two percent of the cost.
    there = Move(*similarity(truth.centers_m, rig.centers_m)).rig(truth)
    start = Rig(
        tuple(
            replace(true, lens_assumed=camera.lens_assumed)
            for true, camera in zip(there.cameras, rig.cameras, strict=True)
        )
    )
    other = adjust_all(
        start, joints.keypoints_px[:, solved.used], joints.sigma_px[:, solved.used],
        solved.placed, solved.lenses, most_points=FINAL_POINTS,
    )  # fmt: skip
    ours = f"{cost(solved.adjusted, solved.lenses):.3f}"
    if other is None:
        return f"{ours} | -"
    degrees, millimetres = distances(other.adjusted.rig, truth)
    theirs = cost(other.adjusted, solved.lenses)
    return f"{ours} | {theirs:.3f}, {degrees.max():.2f}, {millimetres.max():.0f}"


def row(truth: Rig, found: PeopleRig, fps: float) -> str:
    """Return the errors of a rig from people, and of what it states of them, as columns."""
    rig = found.solved.adjusted.rig
    degrees, millimetres = distances(rig, truth)
    stated = camera_errors(truth, found, likely_rigs(found, fps))
    shares = np.stack([degrees / stated.sure_deg, millimetres / stated.sure_mm])
    focal = [
        camera.K[0, 0] / true.K[0, 0] - 1
        for camera, true in zip(rig.cameras, truth.cameras, strict=True)
    ]
    judged = ", ".join(
        name for name, poor in zip(rig.camera_ids, found.fit.poor, strict=True) if poor
    )
    return (
        f"{degrees.max():.2f} | {rays_apart(rig, truth).max():.2f} | {millimetres.max():.0f} | "
        f"{100 * np.abs(focal).max():.1f} | {shares.max():.1f} | {costs(truth, found)} | "
        f"{judged and 'refused: ' + judged}"
    )


def by_others(python: str, tool: str, truth: Rig, found: PeopleRig, known: bool, seed: int) -> str:
    """Return degrees and millimetres of another program that has the points matched here."""
    joints = found.joints
    views = np.isfinite(joints.keypoints_px[..., 0]).sum(axis=0)
    chosen = np.flatnonzero(views >= 2)
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(MOST_POINTS, len(chosen))).astype(int)]
    start = disturbed(truth, 5.0, 0.2, seed)
    lenses = truth if known else assumed_rig({c.camera_id: c.image_size for c in truth.cameras})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "points.npz"
        np.savez(
            path, keypoints_px=joints.keypoints_px[:, chosen], joint=joints.joint[chosen],
            slot=joints.person[chosen] * 100_000 + joints.slot[chosen],
            sizes=np.array([camera.image_size for camera in truth.cameras]), known=known,
            K=np.stack([camera.K for camera in lenses.cameras]),
            distortions=np.stack([camera.lens.padded[:5] for camera in lenses.cameras]),
            R=np.stack([camera.R for camera in start.cameras]),
            t=np.stack([camera.t for camera in start.cameras]),
        )  # fmt: skip
        script = Path(__file__).with_name("calibration_others.py")
        done = subprocess.run(
            [python, str(script), tool, str(path)], capture_output=True, text=True, check=False,
            env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
        )  # fmt: skip
    if done.returncode:
        return f"failed: {done.stderr.strip().splitlines()[-1][:60]}"
    cameras = [
        type(true).from_world_to_camera(
            true.camera_id, true.image_size, true.K, place["R"], place["t"]
        )
        for true, place in zip(truth.cameras, json.loads(done.stdout), strict=True)
    ]
    degrees, millimetres = distances(Rig(tuple(cameras)), truth)
    return f"{degrees.max():.2f}, {millimetres.max():.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", default=";".join(CASES))
    parser.add_argument("--lenses", default="known;unknown")
    parser.add_argument("--real", action="store_true")
    parser.add_argument("--seed", type=int, help="of simulated cases, in place of their own")
    parser.add_argument("--others", help="interpreter with caliscope and aniposelib")
    options = parser.parse_args()
    names = [name for name in options.cases.split(";") if name]
    tools = ("caliscope", "aniposelib") if options.others else ()
    columns = [*COLUMNS, "", *(f"{tool}: degrees, mm" for tool in tools)]
    print(f"| {' | '.join(columns)} |")
    print("|---" * len(columns) + "|")
    for name, recording in recordings(names, options.real, options.seed):
        truth, recording = recording.rig, replace(recording, truth=None)
        for lenses in options.lenses.split(";"):
            known, label = lenses == "known", f"{name} | {lenses}"
            seen = recording if known else without_calibration(recording)
            try:
                found = solve_people(seen, load_noise(detector_of(recording)), None)
            except InputError as error:
                print(f"| {label} | refused: {str(error)[:80]} |", flush=True)
                continue
            theirs = [
                "refused" if tool == "caliscope" and not known
                else by_others(options.others, tool, truth, found, known, 1)
                for tool in tools
            ]  # fmt: skip
            cells = " | ".join([label, row(truth, found, recording.fps), *theirs])
            print(f"| {cells} |", flush=True)


if __name__ == "__main__":
    main()
