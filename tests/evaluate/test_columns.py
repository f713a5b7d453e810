"""Tables fit the width of a terminal, whatever it is, and lose no figure."""

from __future__ import annotations

from io import StringIO
from typing import Any

import pytest
from rich.console import Console
from tests.cases import each_case

from e3pose.evaluate.columns import print_tables
from e3pose.evaluate.tables import print_comparison

NAMES = [f"figure {n}" for n in range(9)]
POLICIES = ["information", "round-robin"]


def printed(width: int) -> list[str]:
    out = StringIO()
    console = Console(file=out, width=width)
    columns = {name: [f"{name[-1]}1.5 +- 0.4", f"{name[-1]}2.5"] for name in NAMES}
    print_tables(console, {"policy": POLICIES}, columns, "a title")
    return out.getvalue().splitlines()


@each_case("width", [40, 60, 80, 240])
def test_every_figure_is_whole_at_any_width(width: int) -> None:
    lines = printed(width)
    assert all(len(line) <= width for line in lines)
    text = "\n".join(lines)
    for name in NAMES:
        assert name in text and f"{name[-1]}1.5 +- 0.4" in text
    assert text.count("information") == text.count("round-robin") == text.count("policy")


def test_one_table_is_enough_where_it_fits() -> None:
    assert printed(240)[0].strip() == "a title" and len(printed(240)) == 4
    assert len(printed(60)) > 4


@pytest.mark.parametrize("width", [80, 200])
def test_comparison_shows_its_figures_at_80_columns(width: int) -> None:
    spread = {"mean": 96.9, "sd": 0.2}
    devices = {
        key: spread
        for key in (
            "saving_percent",
            "times_paper",
            "aggressive_saving_percent",
            "aggressive_times_paper",
        )
    }
    row: dict[str, Any] = {
        "policy": "information",
        "cameras": 2,
        "lead": 4,
        "seeds": 5,
        "selection": {"mean_cameras": spread},
        "metrics": {"pcp": {"average": spread}, "mpjpe_mm": spread, "recall_500mm": spread},
        "identities": spread,
        "expected": {"error_mm": spread, "coverage_90": spread},
        "savings": {"whole_camera": {"percent": spread}},
        "energy": {"devices": {"xavier-nx": devices, "tx2": devices}},
        "stage_ms": {"slot": {"median": spread}},
    }
    out = StringIO()
    print_comparison([row], Console(file=out, width=width))
    text = out.getvalue()
    assert max(map(len, text.splitlines())) <= width and "\u2026" not in text
    for heading in ("PCP avg %", "MPJPE mm", "expected mm", "ms/slot", "tx2 saved %"):
        assert heading in text
    assert text.count("96.9 +- 0.2") >= 8
    assert "whole camera saved %" in text and "processor time saved: not measured" in text
