"""How far could any policy get, that knows who walks where? An oracle of who looks, and how.

    python lab/benchmarks/look_oracle.py --scene two-rooms,one-sided,ring --seeds 731,732
    python lab/benchmarks/look_oracle.py --scene ring --busy 0.25 --seconds 100 --seeds 741,742
    python lab/benchmarks/look_oracle.py --recordings pizza,shelf --seeds 0

In the slot that it decides, the oracle knows who is in which image. Each camera then

* does nothing, suspended, where its image holds nobody, or `information` chooses others of those
  whose image holds somebody. It falls asleep and wakes at once and for nothing;
* looks at all of its image where somebody is in it whom no track explains; the two cameras that
  see this person largest look;
* runs only its motion gate where everybody in its image is within `STILL_PX` of its last look;
* otherwise looks at the part, or the crops, in which the edge expects people (semantic feedback).

`information` chooses as many as `--counts` says per slot, by what it expects: knowing motion gains
a choice of cameras nothing (`oracle_choice.py`). A look at a part is
charged its share of the input pixels of a whole look, and a gate `GATE_SHARE`, of what looking
draws beyond idling. Both are favourable: capturing and decoding cost as much as ever, and live, a
part takes more than its share of pixels. A gated look shows what a whole one would. It is a high
mark, no proof: a policy that plans looks over time could do better. Scenes, profile and the
columns are those of `day.py`; the first row is its two per slot with all cameras awake. Of
`--recordings`, people are where the offline smoother over all cameras sees them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import day
from clip_error import references
from e3pose import pipeline as loop
from e3pose.base.arrays import Flags, Floats
from e3pose.energy.rest_costs import RestCosts
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose.model.expected import ExpectedView
from e3pose.model.noises import detector_of, load_noise
from e3pose.model.pose import Poses2D
from e3pose.recording import Recording, load_recording
from e3pose.select.feedback import Feedback
from e3pose.select.policies.base import selected_by
from e3pose.simulate import SceneSettings, simulate
from feedback import NETWORKS, Cropped

GATE_SHARE = 0.05  # of a look: docs/experiments/2026-11-26-cheaper-looks.md, of standing images
STILL_PX = 3.0  # joints that moved less, in images of 1920 pixels
IN_VIEW = 0.5  # share of the joints of somebody who is in an image
TRACKED_M = 0.5
MOVENET = "movenet-multipose"
SECONDS = 24.0
WAYS = ("nothing", "gate", "part", "whole")


@dataclass
class Oracle:
    """Decides who looks and how, and adds up what that draws.

    Attributes:
        recording: what is replayed.
        joints_m: `(num_slots, num_persons, num_joints, 3)` where people are; NaN where not there.
        network: that cuts looks to parts.
        pixels: `(num_cameras, num_slots, num_persons, num_joints, 2)` of them.
        inside: `(num_cameras, num_slots, num_persons)` who is in which image.
        tracked_m: `(num_tracks, 3)` where tracks are expected in the slot that is decided.
        whole: whether the cameras of the slot that is decided look at all of their images.
        cost: `(num_slots, num_cameras)` of looks, in shares of a whole one.
        looked: `(num_slots, num_cameras)` who looked.
        last: `(num_cameras,)` slot of each camera's newest look with a network; -1: none.
    """

    recording: Recording
    joints_m: Floats
    network: Cropped
    pixels: Floats = field(init=False)
    inside: Flags = field(init=False)
    tracked_m: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    whole: bool = False
    cost: Floats = field(init=False)
    looked: Flags = field(init=False)
    last: list[int] = field(init=False)

    def __post_init__(self) -> None:
        rig = self.recording.rig
        self.pixels = rig.project(self.joints_m)
        sizes = rig.image_sizes[:, None, None, None]
        with np.errstate(invalid="ignore"):
            within = (self.pixels >= 0) & (self.pixels < sizes)
        self.inside = within.all(axis=-1).mean(axis=-1) >= IN_VIEW
        self.cost = np.zeros((self.recording.num_slots, len(rig)))
        self.looked = np.zeros(self.cost.shape, dtype=bool)
        self.last = [-1] * len(rig)

    def select(self, policy: Any, situation: Any) -> Flags:
        """Return who looks in the slot that is decided; see `pipeline.selected_by`."""
        slot = min(situation.slot, len(self.joints_m) - 1)
        inside = self.inside[:, slot]
        two = inside.sum(axis=0) >= 2  # nobody is estimated elsewhere
        useful = situation.online & inside[:, two].any(axis=1)
        chosen: Flags = selected_by(policy, replace(situation, online=useful))
        self.whole = False
        for person in np.flatnonzero(two & ~self._tracked(slot)).tolist():
            self.whole = True
            shown = useful & inside[:, person]
            height = np.where(shown, self._height_px(slot, person), -1.0)
            chosen[np.argsort(-height)[: min(2, int(shown.sum()))]] = True
        return chosen

    def _tracked(self, slot: int) -> Flags:
        middle_m = day._middle_m(self.joints_m[slot])
        apart_m = np.linalg.norm(middle_m[:, None] - self.tracked_m[None], axis=-1)
        return np.asarray(apart_m.min(axis=1, initial=np.inf) < TRACKED_M)

    def _height_px(self, slot: int, person: int) -> Floats:
        rows = self.pixels[:, slot, person, :, 1]
        known = np.isfinite(rows)
        low, high = np.where(known, rows, np.inf).min(1), np.where(known, rows, -np.inf).max(1)
        return np.asarray(np.where(known.any(axis=1), high - low, 0.0))

    def view(self, slot: int, camera: int, expected: ExpectedView | None) -> Poses2D | None:
        """Return what a camera sees; see `ReadView`."""
        self.looked[slot, camera] = True
        if self._still(slot, camera):
            self.cost[slot, camera] = GATE_SHARE
            return self.recording.view(slot, camera)
        self.last[camera] = slot
        view = self.network(slot, camera, expected)
        self.cost[slot, camera] = self.network.costs[-1] if slot >= day.WARMUP_SLOTS else 1.0
        return view

    def _still(self, slot: int, camera: int) -> bool:
        last, inside = self.last[camera], self.inside[camera]
        if last < 0 or (inside[slot] != inside[last]).any():
            return False
        there = inside[slot]
        moved = self.pixels[camera, slot, there] - self.pixels[camera, last, there]
        moved_px = np.nan_to_num(np.linalg.norm(moved, axis=-1)).max(initial=0.0)
        scale = max(self.recording.rig.cameras[camera].image_size) / 1920
        return bool(moved_px < STILL_PX * scale)

    def records(self, settings: ReplaySettings) -> list[Any]:
        """Replay with the oracle in place of the policy."""
        situation_of = loop._situation

        def noted(pipeline: Any, state: Any, *others: Any) -> Any:
            outlook = pipeline.estimator.outlook(state.memory, pipeline.ahead_s)
            self.tracked_m = day._middle_m(outlook.joints_m)
            return situation_of(pipeline, state, *others)

        with (
            patch.object(loop, "_situation", noted),
            patch.object(loop, "selected_by", self.select),
            patch.object(Feedback, "is_due", lambda *_: self.whole),
        ):
            return list(replay(self.recording, settings, read_view=self.view))

    def watts(self, costs: RestCosts, begin: int) -> float:
        """Return the mean draw of a camera from a slot on."""
        awake_w = costs.idle_w + self.cost * costs.look_w
        return float(np.where(self.looked, awake_w, costs.rest_w)[begin:].mean())

    def shares(self, begin: int) -> list[float]:
        """Return the shares of `WAYS` from a slot on."""
        cost, looked = self.cost[begin:], self.looked[begin:]
        gated = looked & (cost == GATE_SHARE)
        whole = looked & (cost >= 1)
        parts = looked & ~gated & ~whole
        return [float(each.mean()) for each in (~looked, gated, parts, whole)]


def people_m(recording: Recording) -> Floats:
    """Return where people are: the simulation's truth, else the smoother over all cameras."""
    if recording.truth is not None and recording.name.startswith("simulated"):
        return recording.truth.joints_m
    people = references(recording, load_noise(detector_of(recording)))
    return np.stack([[p.at(slot) for p in people] for slot in range(recording.num_slots)])


def figures(
    recording: Recording, costs: RestCosts, lead: int, seed: int, counts: Sequence[float]
) -> list[dict[str, Any]]:
    """Return a row for two per slot, all awake, and one for each count of the oracle."""
    today = day.ways(lead, seed, costs)[0]
    rows = [{**day.row(recording, today, costs, lead), "shares": None}]
    joints_m, begin = people_m(recording), day.WARMUP_SLOTS + lead
    for count in counts:
        settings = ReplaySettings(
            lead_slots=lead, seed=seed, phase=seed, num_selected=count, feedback=True
        )
        oracle = Oracle(recording, joints_m, Cropped(recording, NETWORKS[MOVENET]))
        records = oracle.records(settings)
        found = accuracy(recording, records)
        rows.append(
            {
                "name": f"oracle, {count:g} per slot",
                "watts": oracle.watts(costs, begin),
                "error_mm": found.mpjpe_mm,
                "recall": found.recall_500mm,
                "pcp": None if found.pcp is None else found.pcp.actors["average"],
                "waits_s": day.seconds_until_found(recording, records),
                "shares": oracle.shares(begin),
            }
        )
    return rows


def line(same: Sequence[dict[str, Any]], first: Sequence[dict[str, Any]]) -> str:
    """Return a row of the table: means over recordings, beside those of the first row."""
    keys = ("error_mm", "recall", "pcp", "watts")
    mine, today = (
        {k: day._mean([each[k] for each in rows]) for k in keys} for rows in (same, first)
    )
    waits = [wait for each in same for wait in each["waits_s"]]
    late = f"{np.median(waits):.2f}; {np.percentile(waits, 95):.2f} ({len(waits)})" if waits else ""
    shares = np.mean([each["shares"] for each in same], axis=0) if same[0]["shares"] else []
    cells = [
        same[0]["name"],
        f"{mine['error_mm']:.1f}",
        f"{mine['error_mm'] / today['error_mm']:.2f}",
        f"{100 * mine['recall']:.1f}",
        f"{mine['pcp']:.2f}",
        f"{mine['watts']:.2f}",
        f"{100 * mine['watts'] / today['watts']:.0f}",
        " ".join(f"{100 * share:.0f}" for share in shares),
        late,
    ]
    return "| " + " | ".join(cells).replace("nan", "") + " |"


def main() -> None:
    """Print a table for every scene or recording."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scene", default="two-rooms,one-sided,ring")
    parser.add_argument("--recordings", default="", help="folders, in place of scenes; with commas")
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--busy", type=float, default=1.0, help="share of the time with people")
    parser.add_argument("--seeds", default="731")
    parser.add_argument("--lead", type=int, default=4)
    parser.add_argument("--counts", default="1,1.5,2", help="cameras per slot of the oracle")
    parser.add_argument("--profile", default="xavier-nx")
    options = parser.parse_args()
    seeds = [int(each) for each in options.seeds.split(",")]
    counts = [float(each) for each in options.counts.split(",")]
    folders = [Path(each) for each in options.recordings.split(",") if each]

    def recorded(place: str | Path, seed: int) -> Recording:
        if isinstance(place, Path):
            return day.with_truth(load_recording(place))
        if options.busy < 1:
            return day.day(place, options.seconds, options.busy, seed)
        return simulate(SceneSettings(place, fps=day.FPS, seconds=options.seconds), seed)

    head = (
        "cameras", "error, mm", "times", "recall, %", "PCP", "W per camera", "% of today's",
        f"{', '.join(WAYS)}, %", "found after, s: median; 95 % (of)",
    )  # fmt: skip
    for place in folders or options.scene.split(","):
        recordings = [recorded(place, seed) for seed in seeds]
        costs = day.costs_of(options.profile, len(recordings[0].rig))
        print(f"\n`{place}`, lead {options.lead}\n\n| {' | '.join(head)} |", flush=True)
        print(f"|{'---|' * len(head)}", flush=True)
        pairs = zip(recordings, seeds, strict=True)
        found = [figures(each, costs, options.lead, seed, counts) for each, seed in pairs]
        for rows in zip(*found, strict=True):
            print(line(rows, [each[0] for each in found]), flush=True)


if __name__ == "__main__":
    main()
