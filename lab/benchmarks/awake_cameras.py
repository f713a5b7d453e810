"""Who stays awake? Cameras that sleep for seconds, chosen on a time scale of their own.

    python lab/benchmarks/awake_cameras.py --scenes two-rooms,ring,one-sided --seeds 702,703

Every `--block` seconds a planner selects K cameras that stay awake; of these, `information` selects
C per slot, as in the product, and all others sleep. A row of the table is a rule of the planner:

* `random`: any K cameras;
* `slot`: the information of the best C of them about the people who are known;
* `set`: the information of all K together: cameras that repeat each other are worth less;
* `set+cover`: and the share of the floor that one and that two of the K see, for people to come.

`set+cover` also wakes a camera at once where somebody waits whom the awake ones cannot start.
Cameras take `--wake` seconds to wake, and those that they relieve stay awake as long. The policy is
wrapped from outside: these rules came before the product's own plan (`select/rest_plan.py`,
measured by `day.py`). Watts are the shipped profile's; `ASLEEP_W` is a
suspended board of that kind.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from adaptive_choice import ACTIVE_W, FPS, IDLE_W
from e3pose.base.arrays import Flags, Floats
from e3pose.select.floor import seen_floor

ASLEEP_W = 0.5  # assumed: a suspended board, from which its own clock wakes it
WARMUP_SLOTS = 10
RULES = ("random", "slot", "set", "set+cover")
COVER_NATS = 1.0  # of a floor that two cameras see everywhere
STAY_NATS = 0.02  # of a plan that wakes nobody
PRICE_NATS = 0.02  # of a slot in a queue, shared by the cameras awake
WAITING = 0.5  # people not started yet, for whom a camera is woken
STARTED_SHARE = 0.3  # of them: fewer than these are too few


@dataclass(eq=False)
class Planner:
    """A policy that remembers who is awake, around one that selects per slot.

    Attributes:
        inner: selects among the cameras awake.
        rule: one of `RULES`.
        num_awake: K.
        block_slots: slots from plan to plan.
        wake_slots: slots that waking takes.
        seen: `(num_cameras, num_cells)` see `seen_floor`.
        until: `(num_cameras,)` slot up to which each camera is awake; `ready` likewise, from which.
        awake: `(num_cameras,)` of each slot decided so far: whether it draws more than asleep.
        wakes: how often a camera was woken.
    """

    inner: Any
    rule: str
    num_awake: int
    block_slots: int
    wake_slots: int
    seen: Floats
    until: NDArray[np.int64]
    ready: NDArray[np.int64]
    next_plan: int = 0
    awake: list[Flags] = field(default_factory=list)
    wakes: int = 0

    def select(self, situation: Any) -> Flags:
        """See `Policy.select`."""
        slot = situation.slot
        self.ready = np.where(slot < self.until, self.ready, -1)
        if slot >= self.next_plan:
            plan = self._plan(situation)
            end = slot + self.wake_slots
            self.until = np.where(plan, end + self.block_slots, np.minimum(self.until, end))
            self._wake(plan, slot)
            self.next_plan = slot + self.block_slots
        elif self.rule == "set+cover":
            self._wake_for_newcomers(situation)
        on = slot < self.until
        usable = situation.online & on & (slot >= self.ready)
        self.awake.append(on)
        if not usable.any():
            usable = situation.online
        return np.asarray(self.inner.select(replace(situation, online=usable)))

    def _wake(self, wanted: Flags, slot: int) -> None:
        asleep = wanted & (self.ready < 0)
        self.ready = np.where(asleep, slot + self.wake_slots, self.ready)
        self.wakes += int(asleep.sum())

    def _wake_for_newcomers(self, situation: Any) -> None:
        entrants, slot = situation.foresight.entrants, situation.slot
        on = slot < self.until
        total = entrants.weights.sum()
        if total <= WAITING or on.sum() > self.num_awake:
            return
        if entrants.starts(on[None])[0] >= STARTED_SHARE * total:
            return
        others = np.flatnonzero(situation.online & ~on)
        if len(others):
            more = np.repeat(on[None], len(others), axis=0)
            more[np.arange(len(others)), others] = True
            best = others[int(np.argmax(entrants.starts(more)))]
            chosen = np.arange(len(on)) == best
            self.until = np.where(chosen, self.next_plan + self.wake_slots, self.until)
            self._wake(chosen, slot)

    def _plan(self, situation: Any) -> Flags:
        cameras = np.flatnonzero(situation.online)
        plans = subsets(cameras.tolist(), self.num_awake, len(situation.online))
        if self.rule == "random":
            draw = np.random.default_rng(situation.slot).integers(len(plans))
            return np.asarray(plans[int(draw)])
        foresight = situation.foresight
        if self.rule == "slot":
            value = np.array([self._best_nats(foresight, plan) for plan in plans])
        else:
            value = foresight.information(plans)
        value = value + foresight.entrants.starts(plans) + foresight.hidden.reveals(plans)
        if self.rule == "set+cover":
            looks = plans.astype(np.float64) @ self.seen
            value += COVER_NATS * ((looks >= 1).mean(axis=1) + (looks >= 2).mean(axis=1)) / 2
        stay = (plans & (situation.slot < self.until)).mean(axis=1)
        value += STAY_NATS * stay - PRICE_NATS * (plans @ situation.price) / self.num_awake
        return np.asarray(plans[int(np.argmax(value))])

    def _best_nats(self, foresight: Any, plan: Flags) -> float:
        count = int(np.ceil(self.inner.num_selected))
        choices = subsets(np.flatnonzero(plan).tolist(), count, len(plan))
        return float(foresight.information(choices).max())


def subsets(cameras: Sequence[int], count: int, num_cameras: int) -> Flags:
    """Return `(num_subsets, num_cameras)`: all sets of `count` of the cameras."""
    chosen = list(combinations(cameras, min(count, len(cameras))))
    found = np.zeros((len(chosen), num_cameras), dtype=bool)
    for row, members in enumerate(chosen):
        found[row, list(members)] = True
    return found


def one(
    recording: Any, seed: int, rule: str, count: int, num_awake: int, options: argparse.Namespace
) -> tuple[float, float, float, float]:
    """Replay once: error in mm, recall in %, watts per camera and wakes per camera and minute."""
    from e3pose.evaluate import replay as replays
    from e3pose.evaluate.summary import accuracy
    from e3pose.select.policies.information import Information

    num_cameras, phase = len(recording.rig), seed % 1000
    planner = Planner(
        Information(count, phase=phase),
        rule,
        num_awake,
        max(round(options.block / recording.interval_s), 1),
        round(options.wake / recording.interval_s),
        seen_floor(recording.rig)[1],
        np.full(num_cameras, 10**9),
        np.zeros(num_cameras, dtype=np.int64),
    )
    settings = replays.ReplaySettings(
        policy="information", num_selected=count, seed=phase, phase=phase, lead_slots=options.lead
    )
    usual, make = not rule, replays.make_pipeline

    def planned(*arguments: Any) -> Any:
        return replace(make(*arguments), policy=planner)

    with patch.object(replays, "make_pipeline", make if usual else planned):
        records = list(replays.replay(recording, settings))
    found = accuracy(recording, records)
    begin = WARMUP_SLOTS + options.lead
    selected = np.stack([record.selected for record in records])[begin:]
    awake = np.ones_like(selected) if usual else np.stack(planner.awake)[: len(selected)]
    watts = np.where(selected, ACTIVE_W, np.where(awake, IDLE_W, ASLEEP_W)).mean()
    minutes = len(selected) * recording.interval_s / 60
    recall = 100 * (found.recall_500mm or 0.0)
    return (found.mpjpe_mm or np.nan), recall, float(watts), planner.wakes / minutes / num_cameras


def main() -> None:
    """Print a table in Markdown."""
    from e3pose.simulate import SCENES, SceneSettings, simulate

    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenes", default="two-rooms,ring,one-sided,l-hall")
    parser.add_argument("--seeds", default="702,703")
    parser.add_argument("--cameras", default="2", help="C: active per slot, several with commas")
    parser.add_argument("--awake", default="4", help="K: awake, several with commas")
    parser.add_argument("--rules", default=",".join(RULES))
    parser.add_argument("--block", type=float, default=2.0, help="seconds from plan to plan")
    parser.add_argument("--wake", type=float, default=0.0, help="seconds that waking takes")
    parser.add_argument("--lead", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=24.0)
    options = parser.parse_args()
    print("| scene | C of K awake of N | rule | error mm | recall % | W per camera | wakes |")
    print("|---|---|---|---|---|---|---|")
    for scene in options.scenes.split(","):
        fps = FPS if SCENES[scene].fps > FPS else None
        settings = SceneSettings(scene=scene, seconds=options.seconds, fps=fps)
        scenes = [(simulate(settings, int(s)), int(s)) for s in options.seeds.split(",")]
        total = len(scenes[0][0].rig)
        for count in map(int, options.cameras.split(",")):
            rows = [("", total)]
            rows += [
                (r, int(k)) for k in options.awake.split(",") for r in options.rules.split(",")
            ]
            for rule, awake in rows:
                runs = [
                    one(recording, seed, rule, count, awake, options) for recording, seed in scenes
                ]
                error, recall, watts, wakes = np.mean(runs, axis=0)
                print(
                    f"| `{scene}` | {count} of {awake} of {total} | {rule or 'nobody sleeps'} | "
                    f"{error:.1f} | {recall:.1f} | {watts:.2f} | {wakes:.1f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
