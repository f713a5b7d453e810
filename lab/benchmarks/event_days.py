"""How often ordinary life is told as a fall: days of simulated homes, in pieces.

    python lab/benchmarks/event_days.py DAYS --hours home-day=12,home-night=2,home-play=2
    python lab/benchmarks/event_days.py DAYS

The first makes what is missing of so many hours, a file of JSON in the folder DAYS for each ten
minutes, and goes on where it was ended; both print what was found. People of `home-day` do in a
quarter of an hour what others do in a day: what can be taken for a fall is counted by what was
done, so that a week is over when everything was done as often as `ORDINARY` has it in a week.
`empty` is `home` without anybody.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from e3pose.evaluate.replay import ReplaySettings
from e3pose.simulate.scenes import ORDINARY
from e3pose.simulate.settings import SceneSettings
from event_detection import Tally, home, rate_bound

PIECE_S = 600.0
FIRST_SEED = 950  # 900 and up took no part in choosing anything
LEAD_S = 0.32  # from a decision to its slot, as 4 slots of 12.5 a second
DAYS = 7


def piece(scene: str, seed: int, fps: float, cameras: float) -> dict[str, Any]:
    """Count the episodes and the events told in ten minutes."""
    made = SceneSettings(
        scene="home" if scene == "empty" else scene, seconds=PIECE_S, fps=fps,
        people=0 if scene == "empty" else None,
    )  # fmt: skip
    lead = max(round(LEAD_S * fps), 1)
    tally = Tally()
    home(made, seed, ReplaySettings(lead_slots=lead, num_selected=cameras), tally)
    return {
        "scene": scene, "seed": seed, "fps": fps, "cameras": cameras, "hours": tally.hours,
        "done": dict(tally.other), "false": dict(tally.false), "took_s": tally.took_s,
        "slots": tally.slots,
        "found": [[*key, tally.found[key], tried] for key, tried in tally.tried.items()],
    }  # fmt: skip


def main() -> None:
    """Make the pieces that are missing, and print what all of them have."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--hours", default="", help="SCENE=HOURS, comma-separated")
    parser.add_argument("--fps", type=float, default=6.0)
    parser.add_argument("--cameras", type=float, default=2.0, help="per slot")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help="900 and up are kept")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for asked in filter(None, options.hours.split(",")):
        scene, _, hours = asked.partition("=")
        for number in range(round(float(hours) * 3600 / PIECE_S)):
            seed = options.first_seed + number
            name = f"{scene}-{options.cameras:g}-{options.fps:g}-{seed}.json"
            path = options.folder / name
            if not path.exists():
                made = piece(scene, seed, options.fps, options.cameras)
                path.write_text(json.dumps(made))
    report(options.folder)


def report(folder: Path) -> None:
    """Print a paragraph for each scene."""
    pieces = defaultdict[str, list[dict[str, Any]]](list)
    for path in sorted(folder.glob("*.json")):
        made = json.loads(path.read_text())
        pieces[f"{made['scene']}, {made['cameras']:g} cameras, {made['fps']:g} per second"].append(
            made
        )
    for name, made in pieces.items():
        hours = sum(one["hours"] for one in made)
        done = sum((Counter(one["done"]) for one in made), Counter[str]())
        cost_ms = 1e3 * sum(one["took_s"] for one in made) / sum(one["slots"] for one in made)
        print(f"{name}: {hours:.1f} h, {done.total()} episodes, {cost_ms:.2f} ms of CPU a slot")
        print(f"    done: {dict(done.most_common())}")
        found, tried = Counter[str](), Counter[str]()
        for kind, what, hits, times in (row for one in made for row in one["found"]):
            found[what if kind == "fall" else kind] += hits
            tried[what if kind == "fall" else kind] += times
        print(f"    found: {', '.join(f'{one} {found[one]} of {n}' for one, n in tried.items())}")
        weeks = {kind: done[kind] / (DAYS * times) for kind, times in ORDINARY.items()}
        least = min(weeks, key=lambda kind: weeks[kind])
        whole = name.startswith("home-day")
        if whole:
            print(f"    that is {weeks[least]:.1f} weeks of one person, by the rarest: {least}")
        for kind in sorted({kind for one in made for kind in one["false"]} | {"fall"}):
            alarms = [line for one in made for line in one["false"].get(kind, ())]
            bound = rate_bound(len(alarms))
            counts = whole and weeks[least] > 0
            week = f", {bound / weeks[least]:.2f} a week of one person" if counts else ""
            print(
                f"    false {kind}: {len(alarms)}; at most {bound / hours:.2f} an hour{week} (95 %)"
            )
            for line in alarms:
                print(f"        {line}")


if __name__ == "__main__":
    main()
