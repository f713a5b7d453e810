"""Rows of a comparison as tables for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from e3pose.energy.saving import whole
from e3pose.evaluate.columns import print_tables, table_console
from e3pose.evaluate.figures import PAPER_SAVINGS
from e3pose.evaluate.tables import COLUMNS, FIGURE_NAMES, SAVED, find

if TYPE_CHECKING:
    from rich.console import Console

ENERGY_TITLE = (
    "The paper's figure: energy of CPU, GPU, WiFi and memory alone, modelled for xavier-nx and "
    "tx2. x paper: relative to 3 of 5 cameras on the same profile; in power-saving this is "
    "(1 - duty) / 0.4 by construction. aggr.: idle cameras do not capture"
)
OF_ONE_REPLAY = {"p95 mm", "jitter m/s2"}  # a comparison has little room
PREDICT = ("predict ms", ("stage_ms", "predict", "median"), 3)  # beside leads, which it grows with


def print_comparison(rows: Sequence[Mapping[str, Any]], console: Console | None = None) -> None:
    """Print the rows of a comparison: means, with the spread over seeds where there are several."""
    console = table_console() if console is None else console
    keys = {
        "policy": [str(row["policy"]) for row in rows],
        "C": [_asked(row) for row in rows],
    }
    for heading, name in (("V", "quality_weight"), ("E", "budget")):
        if len({row.get(name) for row in rows}) > 1:
            keys[heading] = ["-" if row.get(name) is None else f"{row[name]:g}" for row in rows]
    leads = len({row["lead"] for row in rows}) > 1
    if leads:
        keys["lead"] = [str(row["lead"]) for row in rows]
    known = (*COLUMNS, PREDICT) if leads else COLUMNS
    columns = {
        heading: [_cell(find(row, path), digits) for row in rows]
        for heading, path, digits in known
        if heading not in OF_ONE_REPLAY and any(find(row, path) for row in rows)
    }
    seeds = "/".join(sorted({str(row["seeds"]) for row in rows}))
    title = "one seed" if seeds == "1" else f"mean +- standard deviation over {seeds} seeds"
    print_tables(console, keys, columns, title, apart=True)
    meanings = [f"{name}: {FIGURE_NAMES[name]}" for name in columns if name in FIGURE_NAMES]
    console.print(f"{'; '.join(meanings)}\n", style="dim", highlight=False)
    for heading, *_ in SAVED:
        if heading not in columns:
            console.print(f"{heading.removesuffix(' %')}: not measured", highlight=False)
    console.print(f"{ENERGY_TITLE}:", style="italic", highlight=False)
    print_tables(console, keys, _devices(rows), apart=True)


def _devices(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Return the savings of every row on the paper's devices, and against the paper's 3 of 5."""
    return {
        f"{name} {heading}": [_cell(find(row, ("energy", "devices", name, key)), d) for row in rows]
        for name in PAPER_SAVINGS
        for heading, key, d in (
            ("saved %", "saving_percent", 1),
            ("x paper", "times_paper", 2),
            ("aggr. %", "aggressive_saving_percent", 1),
            ("aggr. x paper", "aggressive_times_paper", 2),
        )
    }


def _asked(row: Mapping[str, Any]) -> str:
    """Return the goal in words: cameras per slot, or at most so many millimetres."""
    target_mm = row.get("target_mm")
    if target_mm is not None:
        return f"{target_mm:g} mm"
    return "-" if row["cameras"] is None else f"{row['cameras']:.3g}"


def _cell(spread: Mapping[str, float] | None, digits: int) -> str:
    if spread is None:
        return "-"
    mean = f"{spread['mean']:.{digits}f}" if digits else str(whole(spread["mean"]))
    deviation = f"{spread['sd']:.{digits}f}"
    return f"{mean} +- {deviation}" if float(deviation) > 0 else mean
