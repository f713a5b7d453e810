"""What camera selection gains by the expected distance in place of log det, in `G(S)`.

    python lab/benchmarks/choice_by_distance.py --seeds 701,702 --counts 2 --leads 2,4,6
    python lab/benchmarks/choice_by_distance.py --seeds 701,702,704 --counts 2 --leads 1

The row `distance` is the policy `information` with G(S) = 3 log(d() / d(S)): d(S) is the mean over
people and joints of the root mean square distance that is expected after the views of S. `with
truth` is an oracle: it knows how far the estimate of each joint will be off before the views, and
how much of that the filter's own gain will correct. It needs lead 1: with orders in flight the
filter would correct a part before. Gains over round robin in percent, of people who are found.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from adaptive_choice import ADAPTIVE, SPREAD
from e3pose.base.arrays import Flags, Floats
from e3pose.select.expected_information import Foresight
from oracle_choice import CUT_M, SCENES, UPPER, Figures, Run, Teller, figures, in_order, recorded

LOG_DET, DISTANCE, WITH_TRUTH = "log det", "distance", "with truth"
DIMENSIONS = 3  # of a position: so many nats for a distance that is down to 1/e


@dataclass(frozen=True, slots=True, eq=False)
class Distances(Foresight):
    """A foresight that values sets of cameras by the distance which they leave.

    Attributes:
        squares_m2: `(num_tracks, num_joints, 3, 3)` mean squared errors before the views, which
            need not be the covariance that the filter reports.
    """

    squares_m2: Floats = field(kw_only=True)

    def information(self, subsets: Flags) -> Floats:
        """See `Foresight.information`."""
        if not self.prior.size:
            return np.zeros(len(subsets))
        known, views = matrices(self.prior), matrices(self.views)
        views = views * self.counted[..., None, None, None]
        added = np.einsum("sc,ctjab->stjab", subsets, views)
        after = np.linalg.inv(known + added)
        kept = after @ known
        left = kept @ self.squares_m2 @ np.swapaxes(kept, -1, -2) + after @ added @ after
        before_m, after_m = self._mean_m(self.squares_m2), self._mean_m(left)
        return np.asarray(DIMENSIONS * np.log(before_m / after_m))

    def _mean_m(self, squares_m2: Floats) -> Floats:
        distances = np.sqrt(np.trace(squares_m2, axis1=-2, axis2=-1)).mean(axis=-1)
        return np.asarray(distances @ np.maximum(self.weights, 1e-9))


@dataclass(frozen=True, slots=True)
class ByDistance:
    """The policy with another G(S).

    Attributes:
        inner: the policy.
        teller: knows how far estimates will be off.
        with_truth: whether the policy knows it too.
    """

    inner: Any
    teller: Teller
    with_truth: bool

    def select(self, situation: Any) -> Flags:
        """See `Policy.select`."""
        seen = situation.foresight
        squares_m2 = np.asarray(np.linalg.inv(matrices(seen.prior)), dtype=np.float64)
        if self.with_truth:
            off_m = self.teller.off_m
            known = np.isfinite(off_m).all(axis=-1)
            squares_m2[known] = (off_m[..., :, None] * off_m[..., None, :])[known]
        parts = {item.name: getattr(seen, item.name) for item in fields(Foresight)}
        other = Distances(**parts, squares_m2=squares_m2)
        return np.asarray(self.inner.select(replace(situation, foresight=other)))


def matrices(entries: Floats) -> Floats:
    """Return `(*batch, 3, 3)` of upper entries `(*batch, 6)`."""
    full = np.zeros((*entries.shape[:-1], 3, 3))
    full[..., UPPER[0], UPPER[1]] = full[..., UPPER[1], UPPER[0]] = entries
    return full


def measure(scene: str, seed: int, count: int, lead: int) -> dict[str, Figures]:
    """Return the figures of every row for one recording."""
    run = Run(recorded(scene, seed), count, seed, lead)
    reference = in_order(run, run.pipeline(SPREAD, lead))
    found = {LOG_DET: figures(in_order(run, run.pipeline(ADAPTIVE, lead)), reference)}
    for row in (DISTANCE, WITH_TRUTH) if lead == 1 else (DISTANCE,):
        pipeline = run.pipeline(ADAPTIVE, lead)
        teller = Teller(pipeline.estimator, run.recording, lead, positions=False)
        policy: Any = ByDistance(pipeline.policy, teller, row == WITH_TRUTH)
        other = replace(pipeline, estimator=teller, policy=policy)
        found[row] = figures(in_order(run, other), reference)
    return found


def line(row: str, found: Sequence[dict[str, Figures]]) -> str:
    """Return a row of the table: means, and changes with their standard errors."""
    mine = np.array([each[row] for each in found])
    change = mine - np.array([each[LOG_DET] for each in found])
    error = change.std(axis=0, ddof=1) / len(change) ** 0.5 if len(change) > 1 else 0 * change[0]
    cells = [f"{mean:.1f}" for mean in mine.mean(axis=0)]
    pairs = zip(change.mean(axis=0), error, strict=True)
    cells += [f"{mean:+.1f} +- {spread:.1f}" for mean, spread in pairs]
    return f"| {row} | " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--seeds", default="701,702")
    parser.add_argument("--counts", default="1,2")
    parser.add_argument("--leads", default="2,4,6")
    options = parser.parse_args()
    scenes, seeds = options.scenes.split(","), [int(seed) for seed in options.seeds.split(",")]
    cut = f"gain, errors cut at {1000 * CUT_M:.0f} mm"
    for count in map(int, options.counts.split(",")):
        for lead in map(int, options.leads.split(",")):
            found = [measure(scene, seed, count, lead) for scene in scenes for seed in seeds]
            print(f"\n| C = {count}, lead {lead} | gain % | {cut} | recall, points | changes | | |")
            print("|---|---|---|---|---|---|---|")
            for row in found[0]:
                print(line(row, found), flush=True)


if __name__ == "__main__":
    main()
