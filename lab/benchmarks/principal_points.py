"""How well people tell the principal points of unknown lenses, at best.

    python lab/benchmarks/principal_points.py [--cases "ring, one person"] [--real]

For each case, calibrated with unknown lenses: the largest errors over the cameras as
`bench_calibration.py` prints them, by how far principal points are expected to be from the middle
of the image (a share of its longer side); and the standard deviation of a principal point, in
degrees by which its camera seems turned, in the median over cameras and axes:

- `points found`: with the people's joints found along, were all errors of keypoints independent;
- `points known`: had each joint a place that is known exactly, likewise;
- `repeated`: the second, where one observation in 100 tells something new, as lenses assume.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from bench_calibration import CASES, declared, recordings
from e3pose.base.arrays import Floats
from e3pose.calibrate.from_people import FINAL_POINTS, PeopleRig, solve_people
from e3pose.calibrate.from_points import OUTLIER_SIGMAS, adjust_all
from e3pose.calibrate.least_squares import weights_of
from e3pose.calibrate.lenses import MIDDLE_SIGMA, REPEATED
from e3pose.calibrate.moved_cameras import LENS, NUM_PARAMETERS, distances
from e3pose.calibrate.uncertainty import normal_equations, rays_apart
from e3pose.model.camera import Rig
from e3pose.recording.calibration.world import ASSUMED_FOCAL

MIDDLES = (MIDDLE_SIGMA, 0.01, 0.001)
MIDDLE = slice(8, 10)  # of a camera's parameters


def expected(found: PeopleRig, middle: float) -> Floats:
    """Return what is expected of lenses, with principal points so far from the middle."""
    assert found.solved.lenses is not None
    lenses = found.solved.lenses.copy()
    cameras = np.arange(len(lenses))
    for axis in (2, 3):
        lenses[cameras, axis, cameras, axis] = (middle / ASSUMED_FOCAL) ** 2 / REPEATED
    return np.asarray(lenses)


def deviations_deg(found: PeopleRig) -> tuple[float, float]:
    """Return the deviation with points found, and with points known; errors are independent."""
    equations, number = normal_equations(found), len(found.other)
    deviations = np.zeros(number * NUM_PARAMETERS)
    deviations[equations.free] = np.sqrt(np.diag(equations.inverse(expected=1 / REPEATED)))
    joint = deviations.reshape(number, -1)[:, MIDDLE]
    system = equations.system
    root = np.sqrt(weights_of(system.residuals, OUTLIER_SIGMAS))[..., None, None]
    by_camera = (root * system.by_camera).reshape(number, -1, NUM_PARAMETERS)
    alone = np.linalg.inv(np.swapaxes(by_camera, -1, -2) @ by_camera)
    single = np.sqrt(np.einsum("cpp->cp", alone))[:, MIDDLE]
    return float(np.degrees(np.median(joint))), float(np.degrees(np.median(single)))


def row(truth: Rig, found: PeopleRig) -> str:
    """Return the columns of a case."""
    assert LENS.stop == MIDDLE.stop
    rig, joints, cells = found.solved.adjusted.rig, found.joints, []
    everyone = np.ones(len(rig), dtype=bool)
    for middle in MIDDLES:
        lenses = expected(found, middle)
        solved = adjust_all(
            rig, joints.keypoints_px, joints.sigma_px, everyone, lenses, most_points=FINAL_POINTS
        )
        assert solved is not None
        degrees, millimetres = distances(solved.adjusted.rig, truth)
        rays = rays_apart(solved.adjusted.rig, truth).max()
        cells.append(f"{degrees.max():.2f}, {rays:.2f}, {millimetres.max():.0f}")
    joint, single = deviations_deg(found)
    return " | ".join(
        [*cells, f"{joint:.2f}", f"{single:.2f}", f"{np.sqrt(REPEATED) * single:.2f}"]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", default="axes beside the middle;errors that follow the view")
    parser.add_argument("--real", action="store_true")
    options = parser.parse_args()
    from tests.calibrate.people_scenes import without_calibration  # where bench_calibration looks

    names = [name for name in options.cases.split(";") if name in CASES]
    shares = " | ".join(f"{100 * middle:g} %: degrees, rays, mm" for middle in MIDDLES)
    print(f"| case | {shares} | points found | points known | repeated |")
    print("|---" * (4 + len(MIDDLES)) + "|")
    for name, recording in recordings(names, options.real, None):
        blind = without_calibration(replace(recording, truth=None))
        found = solve_people(blind, declared("1", recording), None)
        print(f"| {name} | {row(recording.rig, found)} |", flush=True)


if __name__ == "__main__":
    main()
