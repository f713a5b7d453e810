"""Who is missed for how long where views are lost: policies on simulated scenes.

python lab/benchmarks/lost_people.py --seeds 3 --cameras 1,2 --lead 4 --loss 0,0.3

Somebody is missed in a slot that shows nobody whose middle is within half a metre. Recordings with
batteries run on them. Means over recordings with their standard errors; `--out` keeps a line for
every replay, so that two versions can be compared recording by recording.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adaptive_choice import ACTIVE_W, ADAPTIVE, FPS, IDLE_W, PARTIAL, SECONDS, SYMMETRIC

FIRST_SEED = 701
MISSED_M = 0.5
LONG_S = 2.0  # of gaps that count as long
FIGURES = ("mpjpe_mm", "with_misses_mm", "recall", "false_percent", "longest_s", "long_percent")


def one(
    scene: str, seed: int, policy: str, cameras: float, lead: int, loss: float
) -> dict[str, Any]:
    """Simulate a scene, replay it and return its figures; times in seconds, shares in percent."""
    from e3pose.evaluate.replay import ReplaySettings, replay
    from e3pose.evaluate.summary import accuracy
    from e3pose.settings.faults import Faults
    from e3pose.simulate import SCENES, SceneSettings, simulate

    fps = FPS if SCENES[scene].fps > FPS else None
    recording = simulate(SceneSettings(scene=scene, seconds=SECONDS, fps=fps), seed)
    assert recording.truth is not None
    num_cameras, watts, budget = len(recording.rig), None, None
    if recording.battery_wh:
        watts = ((ACTIVE_W,) * num_cameras, (IDLE_W,) * num_cameras)
        hours = recording.num_slots * recording.interval_s / 3600
        mean_w = np.array([recording.battery_wh[i] for i in recording.rig.camera_ids]) / hours
        share = np.clip((mean_w - IDLE_W) / (ACTIVE_W - IDLE_W), 0.01, 1.0)
        budget = tuple(share.tolist()) if policy == ADAPTIVE else None
    settings = ReplaySettings(
        pipeline="memory", policy=policy, num_selected=cameras, seed=seed % 1000,
        phase=seed % 1000, budget=budget, lead_slots=lead, faults=Faults(loss=loss, watts=watts),
    )  # fmt: skip
    records = list(replay(recording, settings))
    found = accuracy(recording, records)
    true_m = recording.truth.joints_m
    missed = missed_in(true_m, [record.poses.joints_m for record in records])
    gaps_s = recording.interval_s * np.array(gaps(missed), dtype=np.float64)
    there_s = recording.interval_s * np.isfinite(true_m[..., 0, 0]).sum()
    recall, precision = found.recall_500mm or 0.0, found.precision_500mm
    return {
        "mpjpe_mm": found.mpjpe_mm,
        "with_misses_mm": recall * (found.mpjpe_mm or 0.0) + 500 * (1 - recall),
        "recall": 100 * recall,
        "false_percent": 0.0 if precision is None else 100 * (1 - precision),
        "longest_s": gaps_s.max(initial=0.0),
        "long_percent": 100 * gaps_s[gaps_s > LONG_S].sum() / there_s,
    }


def missed_in(true_m: Any, shown_m: Sequence[Any]) -> Any:
    """Return `(num_slots, num_persons)`: whether a person is present with nobody shown nearby."""
    missed = np.zeros(true_m.shape[:2], dtype=bool)
    for slot, joints_m in enumerate(shown_m):
        for person in np.flatnonzero(np.isfinite(true_m[slot]).any(axis=(1, 2))):
            middle = np.nanmean(true_m[slot, person], axis=0)
            away = [np.linalg.norm(np.nanmean(joints, axis=0) - middle) for joints in joints_m]
            missed[slot, person] = min(away, default=np.inf) > MISSED_M
    return missed


def gaps(missed: Any) -> list[int]:
    """Return the lengths in slots of all runs of misses of one person."""
    edges = np.diff(np.pad(missed.astype(np.int64), ((1, 1), (0, 0))), axis=0)
    return [
        int(stop - start)
        for column in edges.T
        for start, stop in zip(np.flatnonzero(column > 0), np.flatnonzero(column < 0), strict=True)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", default=",".join((*PARTIAL, *SYMMETRIC)))
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--policies", default="information")
    parser.add_argument("--cameras", default="1,2", help="numbers per slot")
    parser.add_argument("--lead", default="4", help="slots ahead, several")
    parser.add_argument("--loss", default="0,0.3", help="shares of the views that are lost")
    parser.add_argument("--out", type=Path, help="a file that gets a line for every replay")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    print(f"| policy | cameras | lead | loss | {' | '.join(FIGURES)} |")
    print("|---|---|---|---|" + "---|" * len(FIGURES))
    for policy in options.policies.split(","):
        for cameras in map(float, options.cameras.split(",")):
            for lead in map(int, options.lead.split(",")):
                for loss in map(float, options.loss.split(",")):
                    asked = {"policy": policy, "cameras": cameras, "lead": lead, "loss": loss}
                    rows = [
                        {"scene": scene, "seed": seed, **asked, **one(scene, seed, **asked)}
                        for seed in seeds
                        for scene in options.scenes.split(",")
                    ]
                    print(f"| {policy} | {cameras:g} | {lead} | {loss:g} | {_cells(rows)} |")
                    if options.out is not None:
                        with options.out.open("a") as file:
                            file.writelines(json.dumps(row) + "\n" for row in rows)


def _cells(rows: Sequence[dict[str, Any]]) -> str:
    columns = np.array([[row[name] for name in FIGURES] for row in rows], dtype=np.float64)
    means = np.nanmean(columns, axis=0)
    errors = np.nanstd(columns, axis=0) / max(len(rows) - 1, 1) ** 0.5
    return " | ".join(f"{m:.2f} ± {e:.2f}" for m, e in zip(means, errors, strict=True))


if __name__ == "__main__":
    main()
