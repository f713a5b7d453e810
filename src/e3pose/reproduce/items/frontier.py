"""Past the paper: error against cameras on, for every policy, estimator and lead; identities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from e3pose.energy.profiles import load_profile
from e3pose.reproduce.identity_scores import IdentitiesAsked, IdentityFigures, identity_figures
from e3pose.reproduce.items.base import Item, Scale
from e3pose.reproduce.power import TX2, XAVIER, saving_percent
from e3pose.reproduce.records import Cell, Headline, Line, Panel, Section, Spread, Table
from e3pose.reproduce.replays import Asked, Run, over_seeds
from e3pose.reproduce.work import AnyPiece, Made, Piece

IdentityPiece = Piece[IdentitiesAsked, IdentityFigures]

SECONDS, FPS = 16.0, 12.5
COUNTS = (1.0, 1.5, 2.0, 3.0)
TARGETS_MM = (30.0, 40.0, 60.0)
POLICIES = (
    ("paper", "random"), ("paper", "e3pose"), ("memory", "random"), ("memory", "round-robin"),
    ("memory", "e3pose"), ("memory", "information"),
)  # fmt: skip
SHOWN_LEAD = 4


def _scenes(scale: Scale) -> tuple[str, ...]:
    return ("ring",) if scale.quick else ("ring", "crossing", "one-sided", "two-rooms", "pillar")


def _leads(scale: Scale) -> tuple[int, ...]:
    return (SHOWN_LEAD,) if scale.quick else (1, 2, 4, 6)


def _counts(scale: Scale) -> tuple[float, ...]:
    return (1.0, 2.0) if scale.quick else COUNTS


def _seeds(scale: Scale) -> int:
    return scale.seeds(5, 1)


def _asked(scale: Scale) -> list[Asked]:
    return [
        Asked(scene, policy, pipeline, count, lead=lead, seconds=_seconds(scale), fps=FPS)
        for scene in _scenes(scale)
        for lead in _leads(scale)
        for pipeline, policy in POLICIES
        for count in _counts(scale)
        if pipeline == "memory" or count >= 2
    ]


def _targets(scale: Scale) -> list[Asked]:
    return [
        Asked(scene, "information", "memory", None, lead=lead, target_mm=target,
              seconds=_seconds(scale), fps=FPS)
        for scene in _scenes(scale)
        for lead in _leads(scale)
        for target in TARGETS_MM[: scale.of(3, 1)]
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
    scenes = {key: [made(piece) for piece in some] for key, some in _identities(scale).items()}
    at = replace(_asked(scale)[0], pipeline="memory", cameras=2.0, lead=SHOWN_LEAD)
    turn = _error(runs[replace(at, policy="round-robin")])
    best = _error(runs[replace(at, policy="information")])
    slots = _error(runs[replace(at, policy="e3pose", pipeline="paper")])
    return Section(
        paper="Not in the paper.",
        ours=f"In the scene {at.recording} at lead {SHOWN_LEAD} with two cameras, misses counted "
        f"as 500 mm: {slots.mean:.0f} mm with the paper's pipeline and policy, {turn.mean:.0f} mm "
        f"with a memory and round robin, {best.mean:.0f} mm with a memory and information.",
        why="A memory carries people over slots in which fewer than two cameras see them; the "
        "policy matters most where cameras do not all see everybody.",
        how=f"Simulated scenes (people, cameras, detections), seeds 1000 to {999 + _seeds(scale)}, "
        f"on which nothing was chosen, {_seconds(scale):.0f} s at {FPS:g} slots per second; every "
        "table states its lead. Energy is modelled from the shares of slots. IDF1 and HOTA with "
        "matches up to 0.5 m of mean joint distance; HOTA is the mean over similarities of 0.05 "
        "to 0.95.",
        tables=(_frontier(scale, runs), _target_table(scale, runs), _identity_table(scenes)),
        panels=tuple(_panel(scale, runs, scene) for scene in _scenes(scale)),
        headlines=(
            Headline(
                "Frontier: error of information, ring, 2 cameras, lead 4, mm", best.mean, 15.0, 90.0
            ),
        ),
    )  # fmt: skip


def _error(runs: list[Run]) -> Spread:
    return Spread.of([run.error_with_misses_mm for run in runs])


def _frontier(scale: Scale, runs: dict[Asked, list[Run]]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (
            f"{asked.recording}: {asked.policy}, {asked.pipeline}", f"{asked.lead}",
            f"{sum(run.cameras for run in runs[asked]) / len(runs[asked]):.2f}",
            Spread.of([run.error_mm for run in runs[asked]]),
            Spread.of([100 * (run.recall or 0.0) for run in runs[asked]]),
            _error(runs[asked]),
        )
        for asked in _asked(scale)
    ]  # fmt: skip
    columns = (
        "scene, policy, pipeline", "lead", "cameras on", "MPJPE, mm", "recall, %",
        "error with misses, mm",
    )  # fmt: skip
    return Table("frontier", "Error against cameras on (simulated)", columns, tuple(rows))


def _target_table(scale: Scale, runs: dict[Asked, list[Run]]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for asked in _targets(scale):
        duty = sum(sum(run.duty) / len(run.duty) for run in runs[asked]) / len(runs[asked])
        rows.append(
            (
                f"{asked.recording}: target {asked.target_mm:g} mm", f"{asked.lead}",
                f"{sum(run.cameras for run in runs[asked]) / len(runs[asked]):.2f}",
                Spread.of([run.error_mm for run in runs[asked]]),
                saving_percent(load_profile(XAVIER), duty), saving_percent(load_profile(TX2), duty),
            )
        )  # fmt: skip
    columns = (
        "scene and target", "lead", "cameras on", "MPJPE, mm", "saved, Xavier NX, % (modelled)",
        "saved, TX2, % (modelled)",
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
    return Table("identities", "Identities, memory, two cameras (simulated)", columns, tuple(rows))


def _panel(scale: Scale, runs: dict[Asked, list[Run]], scene: str) -> Panel:
    lines = []
    for pipeline, policy in POLICIES:
        chosen = [
            asked
            for asked in _asked(scale)
            if (asked.recording, asked.pipeline, asked.policy) == (scene, pipeline, policy)
            and asked.lead == SHOWN_LEAD
        ]
        x = tuple(sum(run.cameras for run in runs[a]) / len(runs[a]) for a in chosen)
        errors = [_error(runs[asked]) for asked in chosen]
        lines.append(
            Line(f"{policy}, {pipeline}", "simulated", x, tuple(e.mean for e in errors),
                 tuple(e.mean - e.sd for e in errors), tuple(e.mean + e.sd for e in errors))
        )  # fmt: skip
    return Panel(
        f"frontier-{scene}", f"{scene}, lead {SHOWN_LEAD}", "cameras on", "error with misses, mm",
        tuple(lines),
    )  # fmt: skip


ITEM = Item("frontier", "Past the paper: frontier, targets, identities", "", pieces, section)
