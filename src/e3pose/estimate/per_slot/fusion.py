"""Settings and results of fusing the views of a slot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from e3pose.base.arrays import Floats, Integers
from e3pose.base.errors import InputError
from e3pose.model.people import People

# joints_m, scores, members, reprojection_error_px
Fused = tuple[Floats, Floats, Integers, Floats]

Matcher = Literal["rays", "epipolar", "tanke-gall"]
MATCHERS: tuple[Matcher, ...] = ("rays", "epipolar", "tanke-gall")
# Mean distance from epipolar lines up to which two views show one person, by default: simulated
# scenes (`docs/research/paper-comparison.md`); Tanke and Gall, whose 40 is the sum of both ways.
EPIPOLAR_PX: Mapping[str, float] = {"epipolar": 30.0, "tanke-gall": 20.0}
MAX_EPIPOLAR_PX = 1000.0  # capacity: the most that may be asked for
OUTLIER_STEPS = 4  # numerics: reweighting converges more slowly than plain least squares


@dataclass(frozen=True, slots=True)
class FusionSettings:
    """Matching and triangulation settings.

    Attributes:
        max_distance_m: mean distance between rays up to which poses are one person. Detector noise
            of 5 to 10 px at 5 m and 1000 px focal length is 3 to 5 cm between rays; of wild
            detections several times that. Chosen on simulated scenes,
            `docs/research/paper-comparison.md`.
        cap_m: the most that one joint may count in that mean. People who pass each other are
            seldom closer, so a larger distance carries no more information than this.
        duplicate_m: a pose nearer than this to a stronger one, as a mean over their joints, is
            the same person again: half the breadth of shoulders, no two bodies come closer.
            The matchers by epipolar lines leave such a pose as it is, as the paper does.
        min_joints: a person with fewer joints in 3D is a coincidence of scraps.
        refine_steps: Gauss-Newton steps on the reprojection error after the DLT; 0 gives exactly
            the paper's DLT.
        reject_outliers: let views that disagree about a joint lose their weight.
        matcher: `rays` merges the closest groups first, by distances in the world; the others
            match by distances from epipolar lines (`per_slot.epipolar`).
        max_epipolar_px: mean distance from epipolar lines up to which these take poses for one
            person; the matcher's own of `EPIPOLAR_PX` by default.

    Raises:
        InputError: naming the setting that is out of range.
    """

    max_distance_m: float = 0.15
    cap_m: float = 0.30
    duplicate_m: float = 0.25
    min_joints: int = 3
    refine_steps: int = 1
    reject_outliers: bool = False
    matcher: Matcher = "rays"
    max_epipolar_px: float | None = None

    def __post_init__(self) -> None:
        for name in ("max_distance_m", "cap_m", "duplicate_m"):
            value = getattr(self, name)
            lowest_ok = value >= 0 if name == "duplicate_m" else value > 0
            if not (math.isfinite(value) and lowest_ok):
                raise InputError(f"fusion: {name}: found {value}, expected metres above 0")
        if self.matcher not in MATCHERS:
            raise InputError("matcher", repr(self.matcher)[:60], " or ".join(MATCHERS))
        if not 0 < self.epipolar_px <= MAX_EPIPOLAR_PX:
            found = f"{self.epipolar_px:g} px"
            raise InputError(
                "max_epipolar_px", found, f"more than 0 and at most {MAX_EPIPOLAR_PX:g}"
            )
        if self.min_joints < 1:
            raise InputError(f"fusion: min_joints: found {self.min_joints}, expected 1 or more")
        if not 0 <= self.refine_steps <= 50:
            raise InputError(f"fusion: refine_steps: found {self.refine_steps}, expected 0 to 50")

    @property
    def epipolar_px(self) -> float:
        """The threshold of a matcher by epipolar lines."""
        usual = EPIPOLAR_PX.get(self.matcher, MAX_EPIPOLAR_PX)
        return usual if self.max_epipolar_px is None else self.max_epipolar_px

    @property
    def steps(self) -> int:
        """Gauss-Newton steps that will be taken."""
        return max(self.refine_steps, OUTLIER_STEPS) if self.reject_outliers else self.refine_steps


@dataclass(frozen=True, slots=True, eq=False)
class Fusion:
    """The people of one slot and their detections, the best supported person first.

    Attributes:
        people: by their row. The score of a joint is the mean score of the keypoints that saw
            it, each multiplied by how far it was believed (1 unless outliers are rejected).
        members: `(num_persons, num_cameras)` row of the person in each view, -1 if not in it.
        reprojection_error_px: `(num_persons, num_joints)` mean over the views that saw the joint,
            in undistorted pixels; NaN where the joint is missing.
    """

    people: People
    members: Integers
    reprojection_error_px: Floats
