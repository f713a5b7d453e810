"""Tables fit the width of a terminal, whatever it is, and lose no figure."""

from __future__ import annotations

from io import StringIO

from rich.console import Console
from tests.cases import each_case

from e3pose.evaluate.columns import print_tables

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
