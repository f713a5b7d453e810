"""The timeline figure: frame rate against network and server delay, for the paper's designs."""

from __future__ import annotations

from collections.abc import Sequence

from e3pose_lab.reproduce.emulated import SERVER_S
from e3pose_lab.reproduce.items.base import Item, Scale
from e3pose_lab.reproduce.records import Cell, Headline, Line, Panel, Section, Table
from e3pose_lab.reproduce.timeline import CAMERAS, FPS, SELECTED, Rates, RatesAsked, rates
from e3pose_lab.reproduce.work import AnyPiece, Made, Piece

# E3Pose over central control by round trip, in ms: three standard deviations of the rows in
# docs/research/live.md about what the waits alone give, more in the single second of a quick run.
MARGINS = {100.0: (2.4, 4.1), 200.0: (4.6, 6.6)}
NAMES = ("E3Pose", "central control (emulated)", "distributed (emulated)")


def _pieces(scale: Scale) -> dict[tuple[float, bool], Piece[RatesAsked, Rates]]:
    trips = (0.0, 100.0) if scale.quick else (0.0, 20.0, 50.0, 100.0, 200.0)
    seconds = float(scale.of(5, 1))
    return {
        (trip, slow): Piece(rates, RatesAsked(trip, slow, seconds), times=True)
        for slow in (False, True)[: scale.of(2, 1)]
        for trip in trips
    }


def pieces(scale: Scale) -> Sequence[AnyPiece]:
    """Return a measurement per delay."""
    return list(_pieces(scale).values())


def section(scale: Scale, made: Made) -> Section:
    """Return frame rates by delay."""
    found = {key: made(piece) for key, piece in _pieces(scale).items()}
    longest = max(trip for trip, _ in found)
    far = found[longest, False]
    return Section(
        paper="By prediction E3Pose needs no round trip before a frame, and so achieves a higher "
        "frame rate than central control with 2D boxes; a diagram without numbers.",
        ours=f"At a round trip of {longest:.0f} ms E3Pose runs at {far.ours:.1f} of {FPS:g} frames "
        f"per second, central control at {far.central:.1f}, distributed control at "
        f"{far.distributed:.1f}.",
        why="The paper's argument holds: orders that go out ahead of time hide any delay that the "
        "lead covers. Distributed control is as fast, but loses accuracy (Table 1, ID). The paper "
        "selects in a second thread; here one thread fuses and selects: that takes it half a "
        "millisecond of a slot of 40, and poses go out before it selects "
        "(lab/experiments/2026-11-22-selection-thread.md).",
        how="Measured on this machine: a real edge (policy e3pose, the published network as "
        f"predictor, C = {SELECTED} of {CAMERAS}) and real cameras that detect in films, each a "
        "process of its own; their messages pass through a relay that delays each by half a round "
        "trip. A slot counts when the views of all selected cameras are in its poses. Emulated: a "
        "look takes 20 ms (it finds drawn people, and waits for the rest), a slow server waits "
        f"{1e3 * SERVER_S:.0f} ms for each prediction, and the other two designs are loops that "
        "wait as those designs must, 2 ms for motion vectors, a round trip and the server.",
        tables=(_table(found),),
        panels=(_panel(found),),
        headlines=(
            Headline(
                f"Frame rate: E3Pose over central control, round trip {longest:.0f} ms",
                far.ours / far.central, *MARGINS[longest],
            ),
        ),
    )  # fmt: skip


def _table(found: dict[tuple[float, bool], Rates]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (
            f"{trip:.0f} ms", f"{1e3 * SERVER_S * slow:.0f} ms", each.ours, each.central,
            each.distributed, f"{each.lead}",
        )
        for (trip, slow), each in found.items()
    ]  # fmt: skip
    columns = ("round trip", "server slower by", *NAMES, "E3Pose: lead, slots")
    return Table("frame-rate", f"Frames per second, of {FPS:g}", columns, tuple(rows))


def _panel(found: dict[tuple[float, bool], Rates]) -> Panel:
    each = {trip: rate for (trip, slow), rate in found.items() if not slow}
    lines = tuple(
        Line(name, "measured", tuple(each), values)
        for name, values in (
            (NAMES[0], tuple(rate.ours for rate in each.values())),
            (NAMES[1], tuple(rate.central for rate in each.values())),
            (NAMES[2], tuple(rate.distributed for rate in each.values())),
        )
    )
    return Panel(
        "frame-rate", "Frame rate", "round trip, ms", "frames per second", lines, from_zero=True
    )


ITEM = Item("frame-rate", "Frame rate", "fig:timelineComparison", pieces, section)
