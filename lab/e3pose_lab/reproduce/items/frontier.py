"""Past the paper: error against cameras on, for every policy, estimator and lead; identities."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean, geometric_mean

from e3pose.energy.profiles import load_profile
from e3pose_lab.reproduce.identity_scores import IdentitiesAsked, IdentityFigures, identity_figures
from e3pose_lab.reproduce.items.base import Item, Scale
from e3pose_lab.reproduce.power import TX2, XAVIER, saving_percent
from e3pose_lab.reproduce.records import Cell, Headline, Line, Panel, Section, Spread, Table
from e3pose_lab.reproduce.replays import Asked, Run, over_seeds
from e3pose_lab.reproduce.work import AnyPiece, Made, Piece

IdentityPiece = Piece[IdentitiesAsked, IdentityFigures]
Runs = dict[Asked, list[Run]]

SECONDS, FPS = 16.0, 12.5
SEEDS = 5, 1
PAPER_COUNTS, MEMORY_COUNTS = (2.0, 3.0), (1.0, 1.5, 2.0, 3.0)
TARGETS_MM, SHOWN_TARGET_MM = (30.0, 40.0, 60.0), 40.0
ALONE = ("all", "independent")  # policies that no C means anything to
POLICIES = (
    "all", "random", "round-robin", "independent", "central-2d", "e3pose-mv", "e3pose",
    "information",
)  # fmt: skip
DRAWN = ("random", "round-robin", "e3pose-mv", "e3pose", "information")
AHEAD = ("e3pose-mv", "e3pose", "information")  # policies that foresee the slot they decide for
LEADS, SHOWN_LEAD, SHOWN_COUNT = (1, 2, 4, 6), 4, 2.0
EVERY_LEAD = (1.0, 2.0)  # counts at which every lead is tried
TURN = "memory", "round-robin"  # what others are compared with


def _scenes(scale: Scale) -> tuple[str, ...]:
    return ("ring",) if scale.quick else ("ring", "crossing", "one-sided", "two-rooms", "pillar")


def _leads(scale: Scale) -> tuple[int, ...]:
    return (SHOWN_LEAD,) if scale.quick else LEADS


def _leads_of(scale: Scale, policy: str, count: float) -> tuple[int, ...]:
    """Return the leads of a policy; to one that does not look ahead, a lead is a longer warm-up."""
    return _leads(scale) if policy in AHEAD and count in EVERY_LEAD else (SHOWN_LEAD,)


def _ways(scale: Scale) -> list[tuple[str, str]]:
    """Return estimators with policies."""
    quick = {"round-robin", "e3pose", "information"}
    return [
        (pipeline, policy)
        for pipeline in ("paper", "memory")
        for policy in POLICIES
        if not scale.quick or policy in quick
    ]


def _counts(scale: Scale, pipeline: str, policy: str) -> tuple[float, ...]:
    if scale.quick or policy in ALONE:
        return (SHOWN_COUNT,)
    return PAPER_COUNTS if pipeline == "paper" else MEMORY_COUNTS


def _seeds(scale: Scale) -> int:
    return scale.seeds(*SEEDS)


def _ask(scale: Scale, scene: str, pipeline: str, policy: str, count: float, lead: int) -> Asked:
    return Asked(scene, policy, pipeline, count, lead=lead, seconds=_seconds(scale), fps=FPS)


def _asked(scale: Scale) -> list[Asked]:
    return [
        _ask(scale, scene, pipeline, policy, count, lead)
        for scene in _scenes(scale)
        for pipeline, policy in _ways(scale)
        for count in _counts(scale, pipeline, policy)
        for lead in _leads_of(scale, policy, count)
    ]


def _targets(scale: Scale) -> list[Asked]:
    return [
        Asked(scene, "information", "memory", None, lead=lead, target_mm=target,
              seconds=_seconds(scale), fps=FPS)
        for scene in _scenes(scale)
        for target in ((SHOWN_TARGET_MM,) if scale.quick else TARGETS_MM)
        for lead in (_leads(scale) if target == SHOWN_TARGET_MM else (SHOWN_LEAD,))
    ]  # fmt: skip


def _seconds(scale: Scale) -> float:
    return SECONDS if not scale.quick else 6.0


def _identities(scale: Scale) -> dict[tuple[str, str], list[IdentityPiece]]:
    return {
        (scene, policy): [
            Piece(
                identity_figures,
                IdentitiesAsked(Asked(scene, policy, "memory", 2, lead=SHOWN_LEAD, seed=seed,
                                      seconds=_seconds(scale), fps=FPS)),
            )
            for seed in range(_seeds(scale))
        ]
        for scene in _scenes(scale)
        for policy in ("all", "round-robin", "information")
    }  # fmt: skip


def pieces(scale: Scale) -> Sequence[AnyPiece]:
    """Return the replays of simulated scenes."""
    made: list[AnyPiece] = []
    for asked in [*_asked(scale), *_targets(scale)]:
        made += over_seeds(asked, _seeds(scale))
    for some in _identities(scale).values():
        made += some
    return made


def section(scale: Scale, made: Made) -> Section:
    """Return the frontier, targets and identities."""
    every = [*_asked(scale), *_targets(scale)]
    runs = {asked: [made(piece) for piece in over_seeds(asked, _seeds(scale))] for asked in every}
    ids = {key: [made(piece) for piece in some] for key, some in _identities(scale).items()}
    return Section(
        paper="Not in the paper.",
        ours=_said(scale, runs),
        why="A memory carries people over slots in which fewer than two cameras see them; the "
        "policy matters most where cameras do not all see everybody.",
        how=f"Simulated scenes (people, cameras, detections), {scale.repeats(*SEEDS)} from 1000, "
        f"on which nothing was chosen, {_seconds(scale):.0f} s at {FPS:g} slots per second. Every "
        "table and figure states its lead, in slots; to policies that do not look ahead, a lead is "
        f"a longer warm-up, so they have lead {SHOWN_LEAD} alone. Error with misses: a person "
        "not found counts as 500 mm off. Over scenes: the geometric mean; standard deviations are "
        "over seeds. All and independent take no C. Energy is modelled from the shares of slots; "
        "processor time is not measured, as no camera program runs. "
        "IDF1 and HOTA with matches up to 0.5 m of mean joint distance; HOTA is the mean over "
        "similarities of 0.05 to 0.95.",
        tables=(
            _over_leads(scale, runs), _over_scenes(scale, runs), _target_table(scale, runs),
            _identity_table(ids), _frontier(scale, runs),
        ),
        panels=(
            *(_panel(scale, runs, scene) for scene in _scenes(scale)),
            *((_lead_panel(scale, runs),) if len(_leads(scale)) > 1 else ()),
        ),
        headlines=(
            Headline(
                "Frontier: error of information, ring, 2 cameras, lead 4, mm",
                _error(runs[_ask(scale, "ring", "memory", "information", 2.0, SHOWN_LEAD)]).mean,
                25.0, 75.0,
            ),
        ),
    )  # fmt: skip


def _said(scale: Scale, runs: Runs) -> str:
    names = ("paper", "e3pose"), TURN, ("memory", "e3pose"), ("memory", "information")
    found = [_over(scale, runs, *each, SHOWN_LEAD).mean for each in names]
    where = "the scene ring" if scale.quick else f"{len(_scenes(scale))} scenes"
    return (
        f"In {where} at lead {SHOWN_LEAD} with two cameras, misses counted as 500 mm: "
        f"{found[0]:.0f} mm with the paper's pipeline and policy. With a memory, {found[1]:.0f} mm "
        f"in turn, {found[2]:.0f} mm with the paper's policy, {found[3]:.0f} mm by information."
    )


def _error(runs: list[Run]) -> Spread:
    return Spread.of([run.error_with_misses_mm for run in runs])


def _cameras(runs: Sequence[Run]) -> float:
    return fmean(run.cameras for run in runs)


def _by_seed(scale: Scale, runs: Runs, pipeline: str, policy: str, lead: int) -> list[float]:
    """Return errors with misses with two cameras, geometric means over scenes, by seed."""
    scenes = [
        runs[_ask(scale, scene, pipeline, policy, SHOWN_COUNT, lead)] for scene in _scenes(scale)
    ]
    return [
        geometric_mean(run.error_with_misses_mm for run in found)
        for found in zip(*scenes, strict=True)
    ]


def _over(scale: Scale, runs: Runs, pipeline: str, policy: str, lead: int) -> Spread:
    return Spread.of(_by_seed(scale, runs, pipeline, policy, lead))


def _over_leads(scale: Scale, runs: Runs) -> Table:
    """Return every policy with two cameras at every lead, beside taking turns."""
    turn = _by_seed(scale, runs, *TURN, SHOWN_LEAD)
    rows: list[tuple[Cell, ...]] = []
    for pipeline, policy in _ways(scale):
        found = [
            runs[_ask(scale, scene, pipeline, policy, SHOWN_COUNT, SHOWN_LEAD)]
            for scene in _scenes(scale)
        ]
        own = _by_seed(scale, runs, pipeline, policy, SHOWN_LEAD)
        beside = Spread.of([100 * (a / b - 1) for a, b in zip(own, turn, strict=True)])
        rows.append(
            (
                f"{pipeline}: {policy}", _cameras([run for some in found for run in some]),
                *(
                    _over(scale, runs, pipeline, policy, lead)
                    if lead in _leads_of(scale, policy, SHOWN_COUNT)
                    else None
                    for lead in _leads(scale)
                ),
                beside,
            )
        )  # fmt: skip
    leads = [f"lead {lead}, mm" for lead in _leads(scale)]
    columns = (
        "pipeline: policy", f"cameras on, lead {SHOWN_LEAD}", *leads,
        f"against memory: round-robin, lead {SHOWN_LEAD}, %",
    )  # fmt: skip
    title = "Error with misses by lead, C = 2, over scenes (simulated)"
    return Table("frontier-leads", title, columns, tuple(rows))


def _over_scenes(scale: Scale, runs: Runs) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (
            f"{pipeline}: {policy}",
            *(
                _error(runs[_ask(scale, scene, pipeline, policy, SHOWN_COUNT, SHOWN_LEAD)])
                for scene in _scenes(scale)
            ),
        )
        for pipeline, policy in _ways(scale)
    ]
    columns = "pipeline: policy", *(f"{scene}, mm" for scene in _scenes(scale))
    title = f"Error with misses by scene, C = 2, lead {SHOWN_LEAD} (simulated)"
    return Table("frontier-scenes", title, columns, tuple(rows))


def _frontier(scale: Scale, runs: Runs) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (
            asked.recording, f"{asked.pipeline}: {asked.policy}",
            None if asked.policy in ALONE else f"{asked.cameras:g}", f"{asked.lead}",
            f"{_cameras(runs[asked]):.2f}", Spread.of([run.error_mm for run in runs[asked]]),
            Spread.of([100 * (run.recall or 0.0) for run in runs[asked]]), _error(runs[asked]),
        )
        for asked in _asked(scale)
    ]  # fmt: skip
    columns = (
        "scene", "pipeline: policy", "C", "lead", "cameras on", "MPJPE, mm", "recall, %",
        "error with misses, mm",
    )  # fmt: skip
    title = f"Every scene, policy, C and lead: {len(rows)} rows (simulated)"
    return Table("frontier", title, columns, tuple(rows), folded=True)


def _target_table(scale: Scale, runs: Runs) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for asked in _targets(scale):
        duty = fmean(fmean(run.duty) for run in runs[asked])
        rows.append(
            (
                f"{asked.recording}: target {asked.target_mm:g} mm", f"{asked.lead}",
                f"{_cameras(runs[asked]):.2f}", Spread.of([run.error_mm for run in runs[asked]]),
                Spread.of([100 * (run.recall or 0.0) for run in runs[asked]]),
                saving_percent(load_profile(XAVIER), duty), saving_percent(load_profile(TX2), duty),
            )
        )  # fmt: skip
    columns = (
        "scene and target", "lead", "cameras on", "MPJPE, mm", "recall, %",
        "saved, Xavier NX, % (modelled)", "saved, TX2, % (modelled)",
    )  # fmt: skip
    return Table("targets", "Target errors and their energy (simulated)", columns, tuple(rows))


def _identity_table(scenes: dict[tuple[str, str], list[IdentityFigures]]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (
            f"{scene}: {policy}", f"{SHOWN_LEAD}",
            Spread.of([100 * each.idf1 for each in found]),
            Spread.of([100 * each.hota for each in found]),
            Spread.of([each.returned for each in found]),
            Spread.of([each.swapped for each in found]),
            Spread.of([each.lost for each in found]),
        )
        for (scene, policy), found in scenes.items()
    ]  # fmt: skip
    columns = (
        "scene and policy", "lead", "IDF1, %", "HOTA, %", "changes: returned", "swapped", "lost",
    )  # fmt: skip
    title = "Identities, memory, two cameras (all: every camera; simulated)"
    return Table("identities", title, columns, tuple(rows))


def _panel(scale: Scale, runs: Runs, scene: str) -> Panel:
    """Return one scene: policies with a memory, and the paper's pipeline."""
    lines = []
    for pipeline, policy in [*(("memory", name) for name in DRAWN), ("paper", "e3pose")]:
        if (pipeline, policy) not in _ways(scale):
            continue
        found = [
            runs[_ask(scale, scene, pipeline, policy, count, SHOWN_LEAD)]
            for count in _counts(scale, pipeline, policy)
        ]
        name = policy if pipeline == "memory" else f"{policy}, pipeline paper"
        x = tuple(_cameras(some) for some in found)
        lines.append(Line(name, "simulated", x, tuple(_error(some).mean for some in found)))
    return Panel(
        f"frontier-{scene}", f"{scene}, lead {SHOWN_LEAD}", "cameras on", "error with misses, mm",
        tuple(lines), logarithmic_y=True,
    )  # fmt: skip


def _lead_panel(scale: Scale, runs: Runs) -> Panel:
    lines = []
    for policy in DRAWN:
        own = _leads_of(scale, policy, SHOWN_COUNT)
        leads = [lead if lead in own else SHOWN_LEAD for lead in LEADS]
        found = [_over(scale, runs, "memory", policy, lead) for lead in leads]
        x, y = tuple(float(lead) for lead in LEADS), tuple(each.mean for each in found)
        lines.append(Line(policy, "simulated", x, y))
    return Panel(
        "frontier-leads", "all scenes, C = 2, with a memory", "lead, slots",
        "error with misses, mm", tuple(lines),
    )  # fmt: skip


ITEM = Item(
    "frontier",
    "Past the paper: frontier, targets, identities",
    "",
    pieces,
    section,
    imports=("motmetrics",),
)
