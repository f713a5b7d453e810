"""The timeline figure: frame rate against network and server delay, for the paper's designs."""

from __future__ import annotations

from collections.abc import Sequence

from e3pose.reproduce.items.base import Item, Scale
from e3pose.reproduce.records import Cell, Line, Panel, Section, Table
from e3pose.reproduce.timeline import FPS, Rates, RatesAsked, rates
from e3pose.reproduce.work import AnyPiece, Made, Piece

SERVERS_MS = (0.0, 30.0)
NAMES = ("E3Pose", "central control (emulated)", "distributed (emulated)")


def _pieces(scale: Scale) -> dict[tuple[float, float], Piece[RatesAsked, Rates]]:
    trips = (0.0, 100.0) if scale.quick else (0.0, 20.0, 50.0, 100.0, 200.0)
    seconds = float(scale.of(4, 1))
    servers = SERVERS_MS[: scale.of(2, 1)]
    return {
        (trip, server): Piece(rates, RatesAsked(trip, server, seconds), times=True)
        for server in servers
        for trip in trips
    }


def pieces(scale: Scale) -> Sequence[AnyPiece]:
    """Return a measurement per delay."""
    return list(_pieces(scale).values())


def section(scale: Scale, made: Made) -> Section:
    """Return frame rates by delay."""
    found = {key: made(piece) for key, piece in _pieces(scale).items()}
    longest = max(trip for trip, _ in found)
    far = found[longest, 0.0]
    return Section(
        paper="By prediction E3Pose needs no round trip before a frame, and so achieves a higher "
        "frame rate than central control with 2D boxes; a diagram without numbers.",
        ours=f"At a round trip of {longest:.0f} ms E3Pose runs at {far.ours:.1f} of {FPS:g} frames "
        f"per second, central control at {far.central:.1f}, distributed control at "
        f"{far.distributed:.1f}.",
        why="The paper's argument holds: orders that go out ahead of time hide any delay that the "
        "lead covers. Distributed control is as fast, but loses accuracy (Table 1, ID).",
        how="Measured on this machine: a real edge (policy e3pose, attention-LSTM, C = 2 of 3) and "
        "real cameras in threads of one process; their messages are delayed by half a round trip. "
        "Emulated: detection takes 20 ms, and the other two designs are loops that wait as those "
        "designs must, 2 ms for motion vectors, a round trip and the server.",
        tables=(_table(found),),
        panels=(_panel(found),),
    )


def _table(found: dict[tuple[float, float], Rates]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (f"{trip:.0f} ms", f"{server:.0f} ms", each.ours, each.central, each.distributed)
        for (trip, server), each in found.items()
    ]
    columns = ("round trip", "server beside prediction", *NAMES)
    return Table("frame-rate", f"Frames per second, of {FPS:g}", columns, tuple(rows))


def _panel(found: dict[tuple[float, float], Rates]) -> Panel:
    each = {trip: rate for (trip, server), rate in found.items() if server == 0.0}
    lines = tuple(
        Line(name, "measured", tuple(each), values)
        for name, values in (
            (NAMES[0], tuple(rate.ours for rate in each.values())),
            (NAMES[1], tuple(rate.central for rate in each.values())),
            (NAMES[2], tuple(rate.distributed for rate in each.values())),
        )
    )
    return Panel("frame-rate", "Frame rate", "round trip, ms", "frames per second", lines)


ITEM = Item("frame-rate", "Frame rate", "fig:timelineComparison", pieces, section)
