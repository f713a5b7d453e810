"""Draw the accuracy-energy frontier from what `e3pose evaluate` and `adaptive_choice.py` wrote.

python lab/benchmarks/frontier.py shelf docs/images/frontier-shelf.svg paper=a.json memory=b.json
python lab/benchmarks/frontier.py scenes docs/images/frontier-scenes.svg adaptive.jsonl --lead 4
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from e3pose.evaluate.drawing import COLOURS, INK, MARKERS, PALE, picture
from paired import errors_with_misses, mean_interval

Row = Mapping[str, Any]

POLICY_STYLE = {
    "all": (INK, "*"),
    "random": (PALE, MARKERS[4]),
    "round-robin": (COLOURS[0], MARKERS[0]),
    "e3pose": (COLOURS[1], MARKERS[1]),
    "information": (COLOURS[2], MARKERS[2]),
}
COLUMNS = 3


def shelf(out: Path, sources: Sequence[str], lead: int) -> None:
    """PCP and MPJPE against the cameras on: one line per estimator and policy."""
    rows = [
        {**row, "pipeline": name}
        for name, path in (source.split("=", 1) for source in sources)
        for row in json.loads(Path(path).read_text())["rows"]
        if row["lead"] == lead
    ]
    with picture(out, 7.4, 3.4) as figure:
        axes = figure.subplots(1, 2)
        for axis, title, figure_of in (
            (axes[0], "PCP, %: higher is better", lambda row: row["metrics"]["pcp"]["average"]),
            (axes[1], "MPJPE, mm: lower is better", lambda row: row["metrics"]["mpjpe_mm"]),
        ):
            for (pipeline, policy), points in _lines(rows, figure_of).items():
                colour, marker = POLICY_STYLE[policy]
                x, y, sd = np.array(sorted(points)).T
                axis.errorbar(
                    x, y, sd, color=colour, marker=marker, capsize=2,
                    linestyle=":" if pipeline == "paper" else "-",
                    label=f"{policy}, {pipeline}",
                )  # fmt: skip
            axis.set_title(title)
            axis.set_xlabel("cameras on, mean of all slots")
        axes[0].set_ylim(bottom=max(axes[0].get_ylim()[0], 80))
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)


def _lines(
    rows: Sequence[Row], figure_of: Any
) -> dict[tuple[str, str], list[tuple[float, float, float]]]:
    lines: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    for row in rows:
        if row["policy"] not in POLICY_STYLE:
            continue
        value = figure_of(row)
        cameras = row["selection"]["mean_cameras"]["mean"]
        point = (cameras, value["mean"], value["sd"])
        line = lines.setdefault((row["pipeline"], row["policy"]), [])
        if point not in line:  # of `all`, every count is the same
            line.append(point)
    return lines


def scenes(out: Path, source: Path, lead: int) -> None:
    """Error, misses counted, against the cameras on in every scene: 95 % intervals over seeds."""
    lines = map(json.loads, source.read_text().splitlines())
    rows = [row for row in lines if row["lead"] == lead]
    names = list(dict.fromkeys(row["scene"] for row in rows))
    height = 1.9 * -(-len(names) // COLUMNS) + 0.6
    with picture(out, 7.4, height) as figure:
        axes = figure.subplots(-(-len(names) // COLUMNS), COLUMNS, squeeze=False).ravel()
        for axis, name in zip(axes, names, strict=False):
            runs = [run for row in rows if row["scene"] == name for run in row["runs"]]
            for policy in ("round-robin", "e3pose", "information"):
                colour, marker = POLICY_STYLE[policy]
                counts = sorted({run["count"] for run in runs if run["policy"] == policy})
                values = [
                    np.array(
                        [
                            (
                                run["cameras_on"],
                                *errors_with_misses([run["mpjpe_mm"]], [run["recall"]]),
                            )
                            for run in runs
                            if (run["policy"], run["count"]) == (policy, count)
                        ]
                    )
                    for count in counts
                ]
                intervals = [mean_interval(value[:, 1]) for value in values]
                x = [value[:, 0].mean() for value in values]
                y = [interval.mean for interval in intervals]
                half = [interval.high - interval.mean for interval in intervals]
                axis.errorbar(x, y, half, color=colour, marker=marker, capsize=2, label=policy)
            axis.set_title(name)
            axis.set_ylim(bottom=0)
        for axis in axes[len(names) :]:
            axis.set_visible(False)
        for axis in axes[max(0, len(names) - COLUMNS) : len(names)]:
            axis.set_xlabel("cameras on")
        for axis in axes[::COLUMNS]:
            axis.set_ylabel("error, mm")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("what", choices=("shelf", "scenes"))
    parser.add_argument("out", type=Path)
    parser.add_argument("sources", nargs="+")
    parser.add_argument("--lead", type=int, default=4, help="slots ahead that were decided")
    options = parser.parse_args()
    if options.what == "shelf":
        shelf(options.out, options.sources, options.lead)
    else:
        scenes(options.out, Path(options.sources[0]), options.lead)


if __name__ == "__main__":
    main()
