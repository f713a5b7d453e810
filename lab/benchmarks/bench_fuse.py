"""Measure matching and triangulation: time of the compiled kernels, and quality of the poses.

A row "with lenses" is the same workload seen through lenses that distort. Without `--shared` (or
E3POSE_SHARED) the scenes are made up here; they are of the same kind.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats
from e3pose.estimate.per_slot.fuse import Fuser, FusionSettings
from e3pose.estimate.per_slot.fusion import MATCHERS
from e3pose.model.camera import Camera, Rig
from e3pose.model.people import People

sys.path.append(str(Path(__file__).resolve().parents[2]))  # plain forms of the tests

from tests.reference.fuse import ReferenceFuser

SIZES = ((5, 4), (5, 8), (5, 16), (12, 8), (28, 8))
DISTORTED = ((5, 4), (12, 8))
WITH_LENSES = " with lenses"
# OpenCV's coefficients, and whether of its fisheye model; the cameras have them in turn.
LENSES = (
    ((-0.28, 0.09, 0.0012, -0.0008, -0.01), False),
    ((0.4, 0.06, 0.0012, -0.0008, 0.003, 0.62, 0.11, 0.005), False),
    ((0.02, -0.008, 0.003, -0.0006), True),
)
NEAR_M = 0.3  # a found person this close to a true one is that person
REFERENCE_SLOTS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Workload:
    """Detections `(num_slots, num_cameras, max_persons, num_joints, ...)` and the exact truth."""

    rig: Rig
    keypoints_px: Floats
    scores: Floats
    counts: NDArray[np.int64]
    truth_m: Floats  # (num_slots, num_persons, num_joints, 3)


def load_workload(path: Path) -> Workload:
    with np.load(path, allow_pickle=False) as data:
        size = (int(data["size"][0]), int(data["size"][1]))
        rig = Rig(
            tuple(
                Camera.from_world_to_camera(f"c{i}", size, K, R, t)
                for i, (K, R, t) in enumerate(zip(data["K"], data["R"], data["t"], strict=True))
            )
        )
        detections = data["kpts"].astype(np.float64)
        return Workload(
            rig,
            np.ascontiguousarray(detections[..., :2]),
            np.ascontiguousarray(detections[..., 2]),
            data["n_det"].astype(np.int64),
            data["gt3d"].astype(np.float64),
        )


def make_workload(num_cameras: int, num_persons: int, num_slots: int = 40) -> Workload:
    """Make people who walk in a ring of cameras, seen with 2 px noise, hidden joints with 15 px."""
    rng = np.random.default_rng([num_cameras, num_persons])
    radius = 4.5 + 0.15 * num_persons
    cameras = []
    for index in range(num_cameras):
        angle = 2 * np.pi * index / num_cameras
        center = np.array([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(2.0, 2.8)])
        forward = np.array([0, 0, 0.9]) - center
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        R = np.stack([right, np.cross(forward, right), forward])
        K = np.array([[1050, 0, 515.5], [0, 1050, 387.5], [0, 0, 1.0]])
        cameras.append(Camera.from_world_to_camera(f"c{index}", (1032, 776), K, R, -R @ center))
    rig = Rig(tuple(cameras))
    body = rng.uniform((-0.2, -0.2, 0.1), (0.2, 0.2, 1.7), (17, 3))
    grid = np.stack(np.meshgrid(np.arange(4), np.arange(4)), axis=-1).reshape(-1, 2) - 1.5
    spots = rng.permutation(grid)[:num_persons] * 0.8
    phase = rng.uniform(0, 2 * np.pi, num_persons)[None] + np.arange(num_slots)[:, None] * 0.05
    walk = spots[None] + 0.2 * np.stack([np.cos(phase), np.sin(phase)], axis=-1)
    truth = np.repeat(body[None, None], num_slots, axis=0).repeat(num_persons, axis=1)
    truth[..., :2] += walk[:, :, None]
    shape = (num_cameras, num_slots, num_persons, 17)
    hidden = rng.random(shape) < 0.01 * num_persons
    scores = np.where(hidden, rng.uniform(0.1, 0.4, shape), rng.uniform(0.7, 1.0, shape))
    keypoints = rig.project(truth)
    keypoints += rng.normal(size=keypoints.shape) * np.where(hidden, 15.0, 2.0)[..., None]
    counts = np.full((num_slots, num_cameras), num_persons, np.int64)
    return Workload(
        rig,
        np.ascontiguousarray(np.swapaxes(keypoints, 0, 1)),
        np.ascontiguousarray(np.swapaxes(scores, 0, 1)),
        counts,
        truth,
    )


def distort(bench: Workload) -> Workload:
    """Let the cameras have `LENSES`, and move every keypoint to where its lens puts it."""
    cameras = []
    keypoints = bench.keypoints_px.copy()
    for index, camera in enumerate(bench.rig.cameras):
        coefficients, fisheye = LENSES[index % len(LENSES)]
        cameras.append(replace(camera, distortion=np.array(coefficients), fisheye=fisheye))
        seen = camera.center_m + camera.rays(keypoints[:, index])
        keypoints[:, index] = cameras[index].project(seen)
    return replace(bench, rig=Rig(tuple(cameras)), keypoints_px=keypoints)


def run(
    bench: Workload,
    settings: FusionSettings,
    make: type[Fuser] = Fuser,
    num_slots: int | None = None,
) -> list[People]:
    fuser = make(bench.rig, bench.scores.shape[-1], settings)
    slots = zip(
        bench.keypoints_px[:num_slots],
        bench.scores[:num_slots],
        bench.counts[:num_slots],
        strict=True,
    )
    return [fuser.fuse_arrays(*slot).people for slot in slots]


def quality(found: list[People], truth_m: Floats) -> dict[str, float]:
    """Return recall, precision and MPJPE of people assigned one to one within `NEAR_M`."""
    right = num_found = num_true = 0
    errors: list[Floats] = []
    for poses, truth in zip(found, truth_m, strict=False):
        num_found, num_true = num_found + len(poses), num_true + len(truth)
        distance = np.linalg.norm(poses.joints_m[:, None] - truth[None], axis=-1)
        seen = np.isfinite(distance)
        mean = np.where(seen, distance, 0).sum(axis=-1) / np.maximum(seen.sum(axis=-1), 1)
        for row, column in zip(*linear_sum_assignment(np.minimum(mean, 1.0)), strict=True):
            if mean[row, column] < NEAR_M:
                right += 1
                errors.append(distance[row, column][seen[row, column]])
    return {
        "recall": right / num_true,
        "precision": right / max(num_found, 1),
        "mpjpe_mm": 1000 * float(np.concatenate(errors).mean()) if errors else float("nan"),
    }


def measure(bench: Workload, settings: FusionSettings, seconds: float) -> dict[str, float]:
    """Time `Fuser.fuse_arrays` over and over the slots, and numpy, by rays, over a few of them."""
    num_joints = bench.scores.shape[-1]
    slots = list(zip(bench.keypoints_px, bench.scores, bench.counts, strict=True))
    fuser = Fuser(bench.rig, num_joints, settings)
    fuser.warm_up()
    for slot in slots:
        fuser.fuse_arrays(*slot)
    times: list[float] = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        for slot in slots:
            start = time.perf_counter()
            fuser.fuse_arrays(*slot)
            times.append(time.perf_counter() - start)
    reference = ReferenceFuser(bench.rig, num_joints, replace(settings, matcher="rays"))
    reference_times: list[float] = []
    for slot in slots[:REFERENCE_SLOTS]:
        start = time.perf_counter()
        reference.fuse_arrays(*slot)
        reference_times.append(time.perf_counter() - start)
    median = float(np.median(times))
    return {
        "median_ms": 1e3 * median,
        "p99_ms": 1e3 * float(np.quantile(times, 0.99)),
        "reference_ms": 1e3 * float(np.median(reference_times)),
        "speedup": float(np.median(reference_times)) / median,
    }


def workloads(
    sizes: Iterable[tuple[int, int]], distorted: Container[tuple[int, int]], shared: str | None
) -> Iterator[tuple[str, Workload]]:
    """Yield workloads and their titles, and some of them again as lenses that distort see them.

    Args:
        sizes: numbers of cameras and people.
        distorted: those to see through lenses, too.
        shared: folder that has the workloads; without it they are made up.
    """
    for cameras, people in sizes:
        if shared:
            bench = load_workload(Path(shared) / "bench" / f"workload_c{cameras}_k{people}.npz")
        else:
            bench = make_workload(cameras, people)
        yield f"{cameras}x{people}", bench
        if (cameras, people) in distorted:
            yield f"{cameras}x{people}{WITH_LENSES}", distort(bench)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shared", default=os.environ.get("E3POSE_SHARED"))
    parser.add_argument("--seconds", type=float, default=2.0, help="of timing for each workload")
    parser.add_argument("--matcher", choices=MATCHERS, default="rays")
    options = parser.parse_args()
    settings = FusionSettings(matcher=options.matcher)
    rows: dict[str, dict[str, float]] = {}
    print(f"matching and triangulation, one thread, {settings}")
    print("scenes: " + ("workloads of --shared" if options.shared else "made up"))
    print("cameras x people  median ms   p99 ms  reference ms  ratio  recall  precis.  MPJPE mm")
    for title, one in workloads(SIZES, DISTORTED, options.shared):
        row = measure(one, settings, options.seconds) | quality(run(one, settings), one.truth_m)
        if title.endswith(WITH_LENSES):
            row["price"] = row["median_ms"] / rows[title.removesuffix(WITH_LENSES)]["median_ms"]
        rows[title] = row
        print(
            f"{title:>16}  {row['median_ms']:9.4f}  {row['p99_ms']:7.4f}  "
            f"{row['reference_ms']:12.2f}  {row['speedup']:5.0f}  {row['recall']:6.3f}  "
            f"{row['precision']:7.3f}  {row['mpjpe_mm']:8.1f}"
            + (f"  {row['price']:.2f} times the row above" if "price" in row else "")
        )
    print(f"load of the machine: {os.getloadavg()[0]:.1f}; other work shows in the p99")


if __name__ == "__main__":
    main()
