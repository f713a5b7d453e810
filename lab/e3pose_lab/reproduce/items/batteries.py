"""Batteries over hours and days: how long a site stays complete with which budgets."""

from __future__ import annotations

from collections.abc import Sequence

from e3pose_lab.reproduce.battery_sites import (
    ALL_SITES,
    SITES,
    SiteAsked,
    SiteFigures,
    site_figures,
)
from e3pose_lab.reproduce.depletion import BudgetKind
from e3pose_lab.reproduce.items.base import Item, Scale
from e3pose_lab.reproduce.records import Cell, Headline, Line, Panel, Section, Table
from e3pose_lab.reproduce.work import AnyPiece, Made, Piece

BUDGETS: dict[BudgetKind, str] = {
    "equal": "E3Pose, E = C/N for all",
    "each": "E3Pose, E by battery",
    "together": "ours: last equally long",
}
SHOWN = "days, 400 to 800 Wh"
UNEQUAL = "36 to 60 Wh"


def _piece(site: str, budget: BudgetKind) -> Piece[SiteAsked, SiteFigures]:
    return Piece(site_figures, SiteAsked(site, budget))


def _sites(scale: Scale) -> list[str]:
    return [*SITES, SHOWN] if scale.quick else list(ALL_SITES)


def pieces(scale: Scale) -> Sequence[AnyPiece]:
    """Return every site with every budget."""
    return [_piece(site, budget) for site in _sites(scale) for budget in BUDGETS]


def section(scale: Scale, made: Made) -> Section:
    """Return how long each site stays complete."""
    found = {(s, b): made(_piece(s, b)) for s in _sites(scale) for b in BUDGETS}
    equal, each, ours = (found[UNEQUAL, budget].complete_h for budget in BUDGETS)
    return Section(
        paper="E_n stands for a camera's normalised battery capacity; lifetimes are not shown.",
        ours=f"With batteries of 36 to 60 Wh all cameras last {equal:.2f} h with equal budgets, "
        f"{each:.2f} h with the paper's E_n by battery ({100 * (each / equal - 1):+.0f} %), and "
        f"{ours:.2f} h with budgets that follow the batteries ({100 * (ours / equal - 1):+.0f} %).",
        why="A budget by capacity counts active slots only. An idle camera draws about half as "
        "much, so that its battery empties too: budgets that count joules of both take more from "
        "the large batteries. With equal batteries, devices and sun the three are the same.",
        how="Modelled: the paper's policy and queues with the shipped power profiles, V = 1, C = 3 "
        "of 5, occlusions that wander at random; a site is complete until its first camera is "
        "empty, at most two weeks. Batteries of tens of Wh last hours, those of hundreds days; "
        "panels have their peak at noon, four hours after the start. E by battery: C times the "
        "camera's share of all capacity, fixed; ours is recomputed every ten minutes.",
        tables=(_table(scale, found),),
        panels=(
            *(_charge(budget, found[SHOWN, budget]) for budget in BUDGETS),
            _bars(scale, found),
        ),
        headlines=(
            Headline("Batteries: hours complete, 36 to 60 Wh, equal", equal, 3.5, 3.7),
            Headline("Batteries: hours complete, 36 to 60 Wh, ours", ours, 4.8, 4.9),
        ),
    )


def _table(scale: Scale, found: dict[tuple[str, BudgetKind], SiteFigures]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for site in _sites(scale):
        for budget, title in BUDGETS.items():
            played = found[site, budget]
            known = [hours for hours in played.empty_h if hours is not None]
            some = f"{min(known):.1f} to {max(known):.1f}" if known else "never"
            duty = f"{min(played.duty):.2f} to {max(played.duty):.2f}"
            rows.append((f"{site}: {title}", played.complete_h, some, duty, "modelled"))
    columns = ("site and budget", "complete for, h", "empty after, h", "share of slots", "basis")
    return Table("batteries", "Sites on batteries", columns, tuple(rows), digits=2)


def _charge(budget: BudgetKind, played: SiteFigures) -> Panel:
    percent = [[100 * share for share in row] for row in played.charge]
    lines = tuple(
        Line(f"camera {camera}", "modelled", played.hours, tuple(row[camera] for row in percent))
        for camera in range(len(played.duty))
    )  # fmt: skip
    title = f"{SHOWN}: {BUDGETS[budget]}"
    return Panel(f"batteries-{budget}", title, "hours", "charge, %", lines)


def _bars(scale: Scale, found: dict[tuple[str, BudgetKind], SiteFigures]) -> Panel:
    names = tuple(site for site in _sites(scale) if site in SITES)
    lines = tuple(
        Line(title, "modelled", names, tuple(found[site, budget].complete_h for site in names))
        for budget, title in BUDGETS.items()
    )
    return Panel("batteries-complete", "Hours complete", "", "hours", lines, kind="bars")


ITEM = Item("batteries", "Batteries", "", pieces, section)
