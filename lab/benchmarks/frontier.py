"""Which error do how many active cameras reach? What `e3pose power plan` answers from.

python lab/benchmarks/frontier.py --people 3 --seeds 4 --out frontier.jsonl
python lab/benchmarks/frontier.py --out frontier.jsonl --write   # what the plan reads

Simulated people in a ring of cameras, `information` at lead 4 and 12.5 slots per second.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from adaptive_choice import ADAPTIVE, FPS, figures
from e3pose.simulate import SceneSettings, simulate

PEOPLE, CAMERAS, ACTIVE = (1, 3, 6), (2, 3, 4, 6), (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
FIRST_SEED, SECONDS, LEAD = 1400, 20.0, 4
COLUMNS = ["people", "cameras", "active", "error_mm", "recall"]
PLAN = Path(__file__).parents[2] / "src/e3pose/energy/frontier.json"
HOW = f"simulated ring, information, lead {LEAD}, {FPS:g} slots per second, {SECONDS:g} s"


def run(people: int, seed: int, out: Path) -> None:
    for cameras in CAMERAS:
        settings = SceneSettings(people=people, cameras=cameras, seconds=SECONDS, fps=FPS)
        recording = simulate(settings, seed)
        for count in (each for each in ACTIVE if each < cameras):
            found = figures(recording, ADAPTIVE, count, seed, LEAD)
            row = {"people": people, "cameras": cameras, "seed": seed, "active": count}
            row |= {"mm": found["mpjpe_mm"], "recall": found["recall"]}
            with out.open("a") as file:
                file.write(json.dumps(row) + "\n")


def table(out: Path) -> dict[str, Any]:
    """Return the mean over seeds, by people, cameras and active cameras."""
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    groups: dict[tuple[int, int, float], list[tuple[float, float]]] = {}
    for row in rows:
        key = row["people"], row["cameras"], row["active"]
        groups.setdefault(key, []).append((row["mm"], row["recall"]))
    means = [
        [*key, round(float(np.mean([mm for mm, _ in values])), 1),
         round(float(np.mean([recall for _, recall in values])), 3)]
        for key, values in sorted(groups.items())
    ]  # fmt: skip
    seeds = len({row["seed"] for row in rows})
    return {"source": f"{HOW}, mean of {seeds} seeds", "rows": means}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", type=int, nargs="*", default=PEOPLE)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=FIRST_SEED)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    if not asked.write:
        for people in asked.people:
            for seed in range(asked.first, asked.first + asked.seeds):
                run(people, seed, asked.out)
    made = table(asked.out)
    lines = ",\n".join(f"  {json.dumps(row)}" for row in made["rows"])
    text = (
        f'{{\n "source": {json.dumps(made["source"])},\n "columns": {json.dumps(COLUMNS)},\n'
        f' "rows": [\n{lines}\n ]\n}}\n'
    )
    print(text)
    if asked.write:
        PLAN.write_text(text)


if __name__ == "__main__":
    main()
