"""Table 1: PCP on Shelf, with the published methods, the paper's rows and ours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from e3pose.reproduce.items.base import Item, Scale
from e3pose.reproduce.records import Basis, Cell, Headline, Line, Panel, Section, Spread, Table
from e3pose.reproduce.replays import SHELF, SHELF_FEEDBACK, Asked, Run, over_seeds
from e3pose.reproduce.work import AnyPiece, Made

# PCP of actors 1-3 and their average as the paper cites them, and what found the keypoints: Dong et
# al. by their paper, Chen et al. by the README of their data (github.com/longcw/
# crossview_3d_pose_tracking), Lin and Lee by that of their code (github.com/jiahaoLjh/
# PlaneSweepPose), Belagiannis et al. by their method. The paper itself names none.
PUBLISHED = (
    ("CVPR 2014, Belagiannis et al.", 66.1, 65.0, 83.2, 71.4, "body-part detectors, no network"),
    ("ECCV 2014, Belagiannis et al.", 75.0, 67.0, 86.0, 76.0, "body-part detectors, no network"),
    ("CVPR 2019, Dong et al.", 98.8, 94.1, 97.8, 96.9, "Cascaded Pyramid Network"),
    ("CVPR 2020, Chen et al.", 99.6, 93.2, 97.4, 96.7, "Cascaded Pyramid Network (Dong et al.)"),
    ("CVPR 2021, Lin and Lee", 99.3, 96.5, 98.0, 97.9, "Mask R-CNN and HRNet (VoxelPose)"),
    ("RSS 2021, Bultmann and Behnke", 99.3, 95.7, 97.3, 97.4, "not stated"),
)
WEIGHTS = (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0)
MEMORY_CAMERAS = (1.0, 2.0, 3.0)


@dataclass(frozen=True, slots=True)
class Row:
    """A row that is measured here.

    Attributes:
        name: shown.
        asked: what to replay.
        paper: the paper's PCP of actors 1-3 and average; empty where it has none.
    """

    name: str
    asked: Asked
    paper: tuple[float, ...] = ()


ROWS = (
    Row("SA: all five", Asked(SHELF, "all"), (98.7, 86.7, 97.7, 94.4)),
    Row("RS: random", Asked(SHELF, "random"), (95.8, 83.2, 95.5, 91.5)),
    Row("ID: independent", Asked(SHELF, "independent"), (89.1, 78.6, 85.6, 84.4)),
    Row("E3Pose-MV", Asked(SHELF, "e3pose-mv"), (97.2, 84.5, 96.9, 92.9)),
    Row("E3Pose", Asked(SHELF, "e3pose"), (99.9, 91.9, 99.4, 97.1)),
    *(Row(f"E3Pose, V = {v:g}", Asked(SHELF, "e3pose", quality_weight=v)) for v in WEIGHTS),
    *(
        Row(
            f"E3Pose, own predictor, V = {v:g}",
            Asked(SHELF, "e3pose", quality_weight=v, predictor="attention-lstm"),
        )
        for v in (1.0, 100.0)
    ),
    *(
        Row(
            f"true occlusion, V = {v:g}",
            Asked(SHELF, "e3pose", quality_weight=v, sees_all=True),
        )
        for v in (1.0, 100.0)
    ),
    Row("SA, matcher rays", Asked(SHELF, "all", matcher="rays")),
    Row("E3Pose, matcher rays", Asked(SHELF, "e3pose", matcher="rays")),
    Row("memory, all five", Asked(SHELF, "all", pipeline="memory")),
    *(
        Row(f"memory, {policy}, C = {count:g}", Asked(SHELF, policy, "memory", count))
        for policy in ("round-robin", "e3pose", "information")
        for count in MEMORY_CAMERAS
    ),
)
SEMANTIC = Row("SA + feedback", Asked(SHELF_FEEDBACK, "all"))
NO_PIXELS = (
    " SA + feedback (RSS 2021) is not measured: it needs the images of Shelf, which are not with "
    "the detections that these rows use; docs/how-to/reproduce.md says how to add it."
)
PIXELS = " SA + feedback has detections of its own, from the images; docs/how-to/reproduce.md."
ACTORS = ("actor1", "actor2", "actor3", "average")


def _seeds(scale: Scale, row: Row) -> int:
    return 1 if row.asked.policy == "all" else scale.seeds(20, 2)


def _rows(scale: Scale) -> tuple[Row, ...]:
    """Return the rows that can be measured."""
    return (*ROWS[:1], SEMANTIC, *ROWS[1:]) if SHELF_FEEDBACK in scale.data else ROWS


def pieces(scale: Scale) -> Sequence[AnyPiece]:
    """Return a replay per row and seed."""
    return [piece for row in _rows(scale) for piece in over_seeds(row.asked, _seeds(scale, row))]


def section(scale: Scale, made: Made) -> Section:
    """Return the table, and PCP against V."""
    rows = _rows(scale)
    runs = {row: [made(p) for p in over_seeds(row.asked, _seeds(scale, row))] for row in rows}
    averages = {row.name: Spread.of([run.average for run in runs[row]]) for row in rows}
    found, detector = averages["E3Pose"], _detector(scale, SHELF)
    best = max((averages[f"E3Pose, V = {v:g}"].mean, v) for v in WEIGHTS)
    gap = averages["SA: all five"].mean - found.mean
    return Section(
        paper="The paper reports 97.1 for E3Pose with 3 of 5 cameras, above 94.4 with all five "
        "(SA), 92.9 for E3Pose-MV, 91.5 for random and 84.4 for independent decisions.",
        ours=f"Here E3Pose reaches {found.mean:.1f}, all five cameras "
        f"{averages['SA: all five'].mean:.1f}, random {averages['RS: random'].mean:.1f}; at best "
        f"over V, E3Pose reaches {best[0]:.1f} (V = {best[1]:g}). With a memory and two cameras, "
        f"the policy of the paper reaches {averages['memory, e3pose, C = 2'].mean:.1f}.",
        why="The detector is not the paper's: its network (ResNet18) and its detections are not "
        "published, so compare differences between rows. A slot on its own yields only joints that "
        f"two selected cameras see, which costs three of five cameras {gap:.1f} points at the "
        "default V. With a larger V the clearest views win, and budgets give way; the paper does "
        "not state its V. Its gain over all five cameras appears at no V, nor with the true "
        "occlusion.",
        how=f"Measured on Shelf, 301 frames, detections of {detector}, {scale.repeats(20, 2)} "
        "(draws and phases 0 and on) with their standard deviation; pipeline paper with the "
        "paper's matcher and the published network unless another is named (`own predictor`: the "
        "network with this system's changes, which `memory` uses), lead 1, warm-up slots with all "
        "cameras included. Published rows are cited from the paper's table, and have other "
        "detectors: each names what found its keypoints where its publication says so."
        + (PIXELS if SEMANTIC in runs else NO_PIXELS),
        tables=(_table(scale, runs, averages),),
        panels=(_over_weights(averages), _bars(averages, detector)),
        headlines=(
            Headline("Table 1: PCP of SA on Shelf", averages["SA: all five"].mean, 93.5, 95.5),
            Headline("Table 1: PCP of E3Pose on Shelf, C = 3", found.mean, 84.0, 92.0),
            Headline(
                "Table 1: PCP with a memory on Shelf, e3pose, C = 2",
                averages["memory, e3pose, C = 2"].mean, 96.0, 98.0,
            ),
        ),
    )  # fmt: skip


def _detector(scale: Scale, data: str) -> str:
    return scale.detectors.get(data, "an unnamed detector")


def _table(scale: Scale, runs: dict[Row, list[Run]], averages: dict[str, Spread]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (f"{name} (published)", "all 5", *figures, None, detector)
        for name, *figures, detector in PUBLISHED
    ]  # fmt: skip
    if SEMANTIC not in runs:
        rows.append((f"{SEMANTIC.name}: not measured, no images", *(None,) * 7))
    for row, found in runs.items():
        actors = (Spread.of([run.pcp[actor] for run in found]) for actor in ACTORS[:3])
        mean = sum(run.cameras for run in found) / len(found)
        theirs = row.paper[3] if row.paper else None
        detector = _detector(scale, row.asked.recording)
        rows.append((row.name, f"{mean:.2f}", *actors, averages[row.name], theirs, detector))
    columns = (
        "method", "cameras on", "actor 1", "actor 2", "actor 3", "average",
        "paper: average (OpenPose, ResNet18)", "2D detector",
    )  # fmt: skip
    return Table("table-1", "PCP on Shelf, %", columns, tuple(rows))


def _over_weights(averages: dict[str, Spread]) -> Panel:
    found = [averages[f"E3Pose, V = {v:g}"] for v in WEIGHTS]

    def level(name: str, mean: float, basis: Basis = "measured") -> Line:
        return Line(name, basis, WEIGHTS, (mean,) * len(WEIGHTS))

    return Panel(
        "table-1-v",
        "PCP against V, 3 of 5 cameras",
        "V",
        "PCP, %",
        (
            Line(
                "E3Pose", "measured", WEIGHTS, tuple(f.mean for f in found),
                tuple(f.mean - f.sd for f in found), tuple(f.mean + f.sd for f in found),
            ),
            level("random", averages["RS: random"].mean),
            level("all five", averages["SA: all five"].mean),
            level("paper, E3Pose", 97.1, "paper"),
        ),
        logarithmic=True,
    )  # fmt: skip


def _bars(averages: dict[str, Spread], detector: str) -> Panel:
    both = [row for row in ROWS if row.paper]
    names = tuple(row.name.partition(":")[0] for row in both)
    return Panel(
        "table-1-rows",
        "Average PCP, the paper's rows",
        "",
        "PCP, %",
        (
            Line("paper, its detector", "paper", names, tuple(row.paper[3] for row in both)),
            Line(
                f"here, {detector}",
                "measured",
                names,
                tuple(averages[row.name].mean for row in both),
            ),
        ),
        kind="bars",
    )


ITEM = Item(
    "table-1",
    "Accuracy on Shelf",
    "table:accuracyCompareOthers",
    pieces,
    section,
    needs=("shelf",),
)
