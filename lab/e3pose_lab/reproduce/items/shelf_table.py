"""Table 1: PCP on Shelf, with the published methods, the paper's rows and ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from e3pose_lab.reproduce.items.base import Item, Scale
from e3pose_lab.reproduce.records import Basis, Cell, Headline, Line, Panel, Section, Spread, Table
from e3pose_lab.reproduce.replays import READINGS, SHELF, SHELF_FEEDBACK, Asked, Run, over_seeds
from e3pose_lab.reproduce.work import AnyPiece, Made

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
RAW_WEIGHTS = (1.0, 100.0, 1000.0)
COUNTS = (2, 4, 5)  # beside the paper's 3
SHORT = {"estimated": "as estimated", "shown": "filled", "skipped": "not counted"}
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
            f"E3Pose, V = {v:g} of IoU itself",
            Asked(SHELF, "e3pose", quality_weight=v, raw_weight=True),
        )
        for v in RAW_WEIGHTS
    ),
    *(
        Row(
            f"E3Pose, own predictor, V = {v:g}",
            Asked(SHELF, "e3pose", quality_weight=v, predictor="attention-lstm"),
        )
        for v in (1.0, 100.0)
    ),
    *(
        Row(
            f"E3Pose, C = {c}, V = 100",
            Asked(SHELF, "e3pose", cameras=c, quality_weight=100.0),
        )
        for c in COUNTS
    ),
    *(
        Row(
            f"true occlusion, V = {v:g}",
            Asked(SHELF, "e3pose", quality_weight=v, sees_all=True),
        )
        for v in (1.0, 100.0)
    ),
    Row("SA, matcher tanke-gall", Asked(SHELF, "all", matcher="tanke-gall")),
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
PAPER_SA, PAPER_OWN = 94.4, 97.1  # PCP of all five cameras, and of E3Pose with three
ACTORS = ("actor1", "actor2", "actor3", "average")
# Three standard deviations of single seeds, of five, about their mean.
RANDOM, OWN, WEIGHED = (89.5, 94.7), (92.2, 95.2), (93.4, 94.1)
UNCOUNTED = 96.9, 97.2
WITH_MEMORY = 96.2, 97.4


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
    averages = {
        reading: {row.name: _spread(runs[row], reading, "average") for row in rows}
        for reading in READINGS
    }
    shown, skipped = averages["shown"], averages["skipped"]
    theirs = {row.name: row.paper[3] for row in rows if row.paper}
    far = {name: abs(shown[name].mean - paper) for name, paper in theirs.items()}
    near = {name: gap for name, gap in far.items() if name != "E3Pose"}
    best = max((shown[f"E3Pose, V = {v:g}"].mean, v) for v in WEIGHTS)
    counts = {c: _of_count(skipped, c) for c in (2, 3, 4, 5)}
    detector = _detector(scale, SHELF)
    sa = "SA: all five"
    return Section(
        paper="The paper reports 97.1 for E3Pose with 3 of 5 cameras, above 94.4 with all five "
        "(SA), 92.9 for E3Pose-MV, 91.5 for random and 84.4 for independent decisions.",
        ours="A slot on its own lacks joints that fewer than two selected cameras see. Three "
        f"readings of the protocol: counted as wrong, E3Pose reaches "
        f"{averages['estimated']['E3Pose'].mean:.1f} and all five cameras "
        f"{averages['estimated'][sa].mean:.1f}; filled from the person's last pose, as the "
        f"pipeline shows them, {shown['E3Pose'].mean:.1f} ({best[0]:.1f} at V = {best[1]:g}) and "
        f"{shown[sa].mean:.1f}; not counted, {skipped['E3Pose'].mean:.1f} "
        f"({skipped['E3Pose, V = 100'].mean:.1f} at V = 100) and {skipped[sa].mean:.1f}. Filled, "
        f"the paper's rows but E3Pose are within {max(near.values()):.1f} points of the paper, "
        f"E3Pose within {abs(best[0] - theirs['E3Pose']):.1f} at its best V. Not counted, with "
        f"V = 100, two to five cameras reach "
        f"{', '.join(f'{spread.mean:.1f}' for spread in counts.values())}. E3Pose at V = 100 is "
        f"above all five cameras {_where_above(averages)}. With a memory and two "
        f"cameras, the policy of the paper reaches {shown['memory, e3pose, C = 2'].mean:.1f}.",
        why="The paper states neither its V nor what becomes of a joint that a slot lacks; its "
        "section 2 names post-processing. The detector is not the paper's: its network (ResNet18) "
        "and its detections are not published, so compare differences between rows. Actor 2 has "
        "37 labelled frames: half a point of the average means nothing. With a larger V the "
        "clearest views win, and budgets give way. An independent camera keeps no budget here, as "
        "in the paper; its threshold, which the paper does not state, was chosen on simulated "
        "scenes and motion capture.",
        how=f"Measured on Shelf, 301 frames, detections of {detector}, {scale.repeats(20, 2)} "
        "(draws and phases 0 and on) with their standard deviation; pipeline paper with the "
        "paper's matcher and the published network unless another is named (`own predictor`: the "
        "network with this system's changes, which `memory` uses), lead 1, warm-up slots with all "
        "cameras included. V counts camera slots unless `of IoU itself` says otherwise. Published "
        "rows are cited from the paper's table, and have other detectors: each names what found "
        "its keypoints where its publication says so."
        + (PIXELS if SEMANTIC in runs else NO_PIXELS),
        tables=(_table(scale, runs, averages), _actors(runs)),
        panels=(
            _rows_of(averages), _over_weights(averages, "shown"), _over_weights(averages, "skipped")
        ),
        headlines=(
            Headline("Table 1: PCP of SA on Shelf, filled", shown[sa].mean, 95.4, 96.0, PAPER_SA),
            Headline("Table 1: PCP of random on Shelf, filled", shown["RS: random"].mean,
                     *RANDOM, 91.5),
            Headline("Table 1: PCP of E3Pose on Shelf, filled, V = 1", shown["E3Pose"].mean, *OWN,
                     PAPER_OWN),
            Headline(
                "Table 1: PCP of E3Pose on Shelf, filled, V = 100",
                shown["E3Pose, V = 100"].mean, *WEIGHED, PAPER_OWN,
            ),
            Headline("Table 1: PCP of SA on Shelf, not counted", skipped[sa].mean, 96.1, 96.7,
                     PAPER_SA),
            Headline(
                "Table 1: PCP of E3Pose on Shelf, not counted, V = 100",
                skipped["E3Pose, V = 100"].mean, *UNCOUNTED, PAPER_OWN,
            ),
            Headline(
                "Table 1: PCP with a memory on Shelf, e3pose, C = 2",
                shown["memory, e3pose, C = 2"].mean, *WITH_MEMORY,
            ),
        ),
    )  # fmt: skip


def _where_above(averages: Mapping[str, Mapping[str, Spread]]) -> str:
    """Return in which readings E3Pose at V = 100 is above all five cameras."""
    above = [
        name
        for reading, name in READINGS.items()
        if averages[reading]["E3Pose, V = 100"].mean > averages[reading]["SA: all five"].mean
    ]
    count = f"{len(above)} of {len(READINGS)} readings"
    return f"in {count} ({'; '.join(above)})" if above else "in no reading"


def _spread(runs: Sequence[Run], reading: str, actor: str) -> Spread:
    return Spread.of([run.pcp[reading][actor] for run in runs])


def _of_count(averages: Mapping[str, Spread], cameras: int) -> Spread:
    """Return the average of E3Pose at V = 100, with so many cameras."""
    count = "" if cameras == 3 else f", C = {cameras}"
    return averages[f"E3Pose{count}, V = 100"]


def _detector(scale: Scale, data: str) -> str:
    name = scale.detectors.get(data, "an unnamed detector")
    return "OpenPose" if name == "openpose" else name


def _table(
    scale: Scale, runs: dict[Row, list[Run]], averages: Mapping[str, Mapping[str, Spread]]
) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (f"{name} (published)", "all 5", None, None, None, figures[3], detector)
        for name, *figures, detector in PUBLISHED
    ]
    if SEMANTIC not in runs:
        rows.append((f"{SEMANTIC.name}: not measured, no images", *(None,) * 6))
    for row, found in runs.items():
        mean = sum(run.cameras for run in found) / len(found)
        here = (
            averages[reading][row.name] if shows or reading == "shown" else None
            for shows in [row.asked.pipeline == "paper"]
            for reading in READINGS
        )
        theirs = row.paper[3] if row.paper else None
        detector = _detector(scale, row.asked.recording)
        rows.append((row.name, f"{mean:.2f}", *here, theirs, detector))
    columns = (
        "method", "cameras on", *READINGS.values(), "paper or publication", "2D detector"
    )  # fmt: skip
    return Table("table-1", "PCP on Shelf, %, average of actors 1 to 3", columns, tuple(rows))


def _actors(runs: dict[Row, list[Run]]) -> Table:
    """Return the paper's rows by actor, the paper's figures beside each."""
    rows: list[tuple[Cell, ...]] = []
    for row, found in runs.items():
        if row.paper:
            pairs = zip(ACTORS, row.paper, strict=True)
            cells = [cell for a, paper in pairs for cell in (_spread(found, "shown", a), paper)]
            rows.append((row.name, *cells))
    columns = tuple(name for actor in ACTORS for name in (actor, f"paper: {actor}"))
    title = "The paper's rows by actor, PCP on Shelf, %, filled"
    return Table("table-1-actors", title, ("method", *columns), tuple(rows))


def _over_weights(readings: Mapping[str, Mapping[str, Spread]], reading: str) -> Panel:
    averages = readings[reading]
    found = [averages[f"E3Pose, V = {v:g}"] for v in WEIGHTS]

    def level(name: str, mean: float, basis: Basis = "measured") -> Line:
        return Line(name, basis, WEIGHTS, (mean,) * len(WEIGHTS))

    return Panel(
        "table-1-v" if reading == "shown" else f"table-1-v-{reading}",
        f"PCP against V, 3 cameras, {SHORT[reading]}",
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


def _rows_of(averages: Mapping[str, Mapping[str, Spread]]) -> Panel:
    both = [row for row in ROWS if row.paper]
    names = tuple(row.name.partition(":")[0] for row in both)
    return Panel(
        "table-1-rows",
        "Average PCP, the paper's rows",
        "",
        "PCP, %",
        (
            Line("paper", "paper", names, tuple(row.paper[3] for row in both)),
            *(
                Line(
                    f"here, {name}",
                    "measured",
                    names,
                    tuple(found.mean for found in each),
                    tuple(found.mean - found.sd for found in each),
                    tuple(found.mean + found.sd for found in each),
                )
                for reading, name in SHORT.items()
                for each in [[averages[reading][row.name] for row in both]]
            ),
        ),
        kind="points",
    )


ITEM = Item(
    "table-1",
    "Accuracy on Shelf",
    "table:accuracyCompareOthers",
    pieces,
    section,
    needs=("shelf",),
)
