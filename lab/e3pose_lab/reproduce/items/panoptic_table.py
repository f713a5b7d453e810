"""Table 2 on real motion, with simulated detections before Panoptic's five cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from e3pose_lab.reproduce.items.base import Item, Scale
from e3pose_lab.reproduce.records import Cell, Headline, Line, Panel, Section, Spread, Table
from e3pose_lab.reproduce.replays import FRAGMENT, MOTION, Asked, Run, over_seeds
from e3pose_lab.reproduce.work import AnyPiece, Made

LIMITS = ("25", "50", "105", "150")
# AP at the four limits, people who are missed counted.
PUBLISHED = (
    ("ECCV 2020, Tu et al.", 83.5, 98.3, 99.7, 99.9),
    ("CVPR 2021, Lin and Lee", 92.1, 98.9, 99.8, 99.8),
)
# The paper's AP: the share of poses within each limit.
PAPER = {
    "SA": (86.3, 93.3, 95.5, 96.8),
    "RS": (66.3, 83.7, 91.3, 91.3),
    "ID": (40.6, 69.3, 86.2, 90.3),
    "E3Pose-MV": (76.7, 94.0, 98.0, 98.4),
    "E3Pose": (90.5, 98.6, 99.8, 100.0),
}
PAPER_CAMERAS: dict[str, str | None] = {
    "SA": "5",
    "RS": "3",
    "ID": None,
    "E3Pose-MV": "3",
    "E3Pose": "3",
}
# Three standard deviations of single seeds about the means of 5 s and of 30 s.
ALL_WITHIN, OWN_WITHIN = (92.0, 100.0), (45.0, 80.0)
ROWS = {
    "SA": Asked(MOTION, "all"),
    "RS": Asked(MOTION, "random"),
    "ID": Asked(MOTION, "independent"),
    "E3Pose-MV": Asked(MOTION, "e3pose-mv"),
    "E3Pose": Asked(MOTION, "e3pose"),
    "memory, SA": Asked(MOTION, "all", "memory"),
    "memory, e3pose, C = 2": Asked(MOTION, "e3pose", "memory", 2),
    "memory, information, C = 2": Asked(MOTION, "information", "memory", 2),
    "memory, information, C = 1": Asked(MOTION, "information", "memory", 1),
}


def _asked(scale: Scale) -> dict[tuple[str, str], tuple[Asked, int]]:
    """Return the replays and their numbers of seeds, by data and row."""
    seconds = float(scale.of(30, 5))
    table = {
        ("motion", name): (replace(asked, seconds=seconds), scale.seeds(5, 1))
        for name, asked in ROWS.items()
    }
    for name, asked in ROWS.items():
        if name in PAPER:
            table["fragment", name] = (replace(asked, recording=FRAGMENT), scale.seeds(20, 2))
    return table


def pieces(scale: Scale) -> Sequence[AnyPiece]:
    """Return a replay per data set, row and seed."""
    return [piece for asked, seeds in _asked(scale).values() for piece in over_seeds(asked, seeds)]


def section(scale: Scale, made: Made) -> Section:
    """Return the table and AP by limit."""
    runs = {
        key: [made(piece) for piece in over_seeds(asked, seeds)]
        for key, (asked, seeds) in _asked(scale).items()
    }
    found = {key: _within(each) for key, each in runs.items()}
    full, ours = found["motion", "SA"], found["motion", "E3Pose"]
    drawn, memory = found["motion", "RS"], found["motion", "memory, information, C = 2"]
    error_mm = {name: _error_mm(runs["motion", name]).mean for name in PAPER}
    best = min(error_mm[name] for name in PAPER if name != "E3Pose")
    return Section(
        paper="Within 50 mm are 98.6 % of E3Pose's poses with 3 of 5 cameras, above 93.3 % with "
        "all five; random 83.7, independent 69.3. MPJPE is 19.7 to 41.14 % lower than the "
        "baselines', by the text; no table has it.",
        ours=f"Here, on simulated detections, {ours[1].mean:.1f} % of E3Pose's poses are within "
        f"50 mm, with all five cameras {full[1].mean:.1f} %, random {drawn[1].mean:.1f} %; within "
        f"150 mm {ours[3].mean:.1f}, {full[3].mean:.1f} and {drawn[3].mean:.1f} %. So E3Pose above "
        f"all cameras does {'' if ours[1].mean > full[1].mean else 'not '}appear: its MPJPE is "
        f"{error_mm['E3Pose']:.1f} mm, that of the best baseline {best:.1f}. With a memory and "
        f"two cameras per slot (information) {memory[1].mean:.1f} and {memory[3].mean:.1f} %.",
        why="The keypoints are simulated, by a detector that guesses what is hidden as OpenPose "
        "does on Shelf and on the first half of `table-2`'s recording. In pictures of few people "
        "who stand apart its errors still follow occlusion less than those of real detectors "
        "(`occlusion-error`). The rows compare with each other, not with the paper's. A slot on "
        "its own yields only joints that two selected cameras see, so fewer cameras mean more "
        "people missed, which lowers AP at every limit. The paper defines its AP as the share of "
        "poses within a limit, in which people who are missed cost nothing; the publications "
        "before it count them.",
        how="Simulated detections on Panoptic's calibration of HD cameras 3, 6, 12, 13, 23. "
        f"Motion: real motion of one person of 171026_pose3, cut into four parts that move at once "
        f"1.1 m from the middle, {scale.of(30, 5)} s at 29.97 fps, {scale.repeats(5, 1)}. "
        "Fragment: three people of 160906_band1, 20 frames, ten of them warm-up with all cameras, "
        f"{scale.repeats(20, 2)}. Ten warm-up slots are included. The shipped predictors "
        "learned no Panoptic motion.",
        tables=(_table(runs, found), _ap_table(runs)),
        panels=(_panel(found),),
        headlines=(
            Headline(
                "Table 2: SA within 150 mm, %, simulated", full[3].mean, *ALL_WITHIN, PAPER["SA"][3]
            ),
            Headline(
                "Table 2: E3Pose within 50 mm, %, simulated",
                ours[1].mean,
                *OWN_WITHIN,
                PAPER["E3Pose"][1],
            ),
        ),
    )


def _within(runs: Sequence[Run]) -> list[Spread]:
    return [Spread.of([run.within[limit] for run in runs]) for limit in LIMITS]


def _error_mm(runs: Sequence[Run]) -> Spread:
    return Spread.of([run.error_mm for run in runs])


def _cameras(runs: Sequence[Run]) -> str:
    return f"{sum(run.cameras for run in runs) / len(runs):.2f}"


def _table(
    runs: dict[tuple[str, str], list[Run]], found: dict[tuple[str, str], list[Spread]]
) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (f"{name} (paper)", PAPER_CAMERAS[name], *share, None, None, None)
        for name, share in PAPER.items()
    ]
    for (data, name), each in runs.items():
        recall = Spread.of([100 * (run.recall or 0.0) for run in each])
        rows.append(
            (f"{name}, {data}", _cameras(each), *found[data, name], _error_mm(each), recall,
             "simulated")
        )  # fmt: skip
    columns = (
        "method", "cameras on", *(f"within {limit} mm" for limit in LIMITS), "MPJPE, mm",
        "recall, %", "detections",
    )  # fmt: skip
    title = "Share of poses within a limit on simulated detections, %: the paper's AP"
    return Table("table-2-simulated", title, columns, tuple(rows))


def _ap_table(runs: dict[tuple[str, str], list[Run]]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (f"{name} (published)", "all 5", *figures) for name, *figures in PUBLISHED
    ]
    for (data, name), each in runs.items():
        ap = (Spread.of([run.ap[limit] for run in each]) for limit in LIMITS)
        rows.append((f"{name}, {data} (simulated)", _cameras(each), *ap))
    title = "Average precision on Panoptic as the publications before count it, %"
    columns = ("method", "cameras on", *(f"AP{limit}" for limit in LIMITS))
    return Table("table-2-simulated-ap", title, columns, tuple(rows), folded=True)


def _panel(found: dict[tuple[str, str], list[Spread]]) -> Panel:
    names = tuple(PAPER)
    return Panel(
        "table-2-simulated-rows",
        "Poses within 50 mm, the paper's rows",
        "",
        "%",
        (
            Line("paper", "paper", names, tuple(PAPER[name][1] for name in names)),
            Line(
                "here", "simulated", names, tuple(found["motion", name][1].mean for name in names)
            ),
        ),
        kind="bars",
    )


ITEM = Item(
    "table-2-simulated",
    "Accuracy on Panoptic's motion, simulated detections",
    "table:accuracyCompareBaselinesCMU",
    pieces,
    section,
    needs=("panoptic",),
)
