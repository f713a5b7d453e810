"""Whether a watched site notices that a camera was knocked, how soon, and how often for nothing.

    python lab/benchmarks/knocks.py            knocks of 0.5 to 5 degrees
    python lab/benchmarks/knocks.py --calm     no knocks, long runs

Replay of simulated recordings with two cameras in each slot, or all: halfway, one camera is turned
by so many degrees about a random axis, while the calibration stays as it was.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.edge.knock_watch import KnockWatch
from e3pose.evaluate.replay import ReplaySettings, replay, selected_views
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate

sys.path.append(str(Path(__file__).resolve().parents[2]))  # scenes of the tests

from tests.calibrate.people_scenes import knocked

FPS = 12.5
KNOCK_S = 30.0
AFTER_S = 60.0


def watched(
    recording: Recording, cameras: int
) -> tuple[list[tuple[float, int | None, float]], Floats, float]:
    """Return the events by camera and time, the turns at every look, and ms per slot.

    The camera is None where one is said to stand as calibrated again.
    """
    number = len(recording.rig)
    settings = ReplaySettings(
        policy="all" if cameras >= number else "e3pose", num_selected=min(cameras, number)
    )
    watch, turns, spent = KnockWatch(recording.rig), [], 0.0
    reported: list[tuple[float, int | None, float]] = []
    for record in replay(recording, settings):
        views = selected_views(recording, record.slot, record.arrived)
        begun = time.perf_counter()
        watch.observe(record, views)
        news = watch.events()
        spent += time.perf_counter() - begun
        if news:
            knock = watch.knock
            camera, degrees = (knock.camera, knock.degrees) if knock else (None, 0.0)
            reported.append((record.time_s, camera, degrees))
        if watch.knock is not None:
            turns.append([record.time_s, watch.knock.camera, watch.knock.degrees])
    return reported, np.array(turns).reshape(-1, 3), 1000 * spent / recording.num_slots


def main() -> None:
    """Print a row per run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calm", action="store_true")
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--seeds", default="701,702,703")
    parser.add_argument("--degrees", default="0.5,1,2,5")
    parser.add_argument("--scenes", default="ring")
    parser.add_argument("--awake", default="2,99")
    options = parser.parse_args()
    awakes = [int(word) for word in options.awake.split(",")]
    for name in options.scenes.split(","):
        people, cameras = (2, 4) if name == "ring" else (None, None)
        for seed in map(int, options.seeds.split(",")):
            seconds = 60 * options.minutes if options.calm else KNOCK_S + AFTER_S
            settings = SceneSettings(name, people, seconds, fps=FPS, cameras=cameras)
            calm = simulate(settings, seed)
            if options.calm:
                for awake in awakes:
                    reported, _, ms = watched(calm, awake)
                    print(
                        f"{name} {seed}, {awake} awake: reported {reported}, {ms:.2f} ms",
                        flush=True,
                    )
                continue
            index = seed % len(calm.rig)
            for degrees in map(float, options.degrees.split(",")):
                recording = knocked(calm, index, degrees, seed, KNOCK_S)
                for awake in awakes:
                    _report(
                        f"{name} {seed}, {awake} awake, {degrees:g} degrees",
                        recording,
                        index,
                        awake,
                    )


def _report(what: str, recording: Recording, index: int, awake: int) -> None:
    reported, turns, ms = watched(recording, awake)
    right = turns[(turns[:, 0] > KNOCK_S) & (turns[:, 1] == index)]
    found = "not found"
    if len(right):
        found = f"after {right[0, 0] - KNOCK_S:.0f} s, {right[-1, 2]:.2f} degrees at the end"
    wrong = [each for each in reported if each[1] not in (index, None) or each[0] <= KNOCK_S]
    print(f"{what}: {found}; wrong {wrong}, {ms:.2f} ms", flush=True)


if __name__ == "__main__":
    main()
