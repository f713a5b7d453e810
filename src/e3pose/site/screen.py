"""The screen of `e3pose top`: status and a table that fits the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

from e3pose.base.quantities import plural
from e3pose.edge.camera_state import SHORT, sleeps_as_told
from e3pose.edge.displacement import moved_words
from e3pose.edge.reports import savings
from e3pose.energy.saving import NO_SAVINGS
from e3pose.model.blind_slot import blind_words
from e3pose.wire.messages import fields
from e3pose.wire.site_messages import CameraStatus, Status

MODES = {
    "active": ("active", "green"),
    "power-saving": ("idle", "cyan"),
    "aggressive-power-saving": ("closed", "blue"),
    "asleep": ("asleep", "blue"),
    "suspended": ("suspended", "blue"),
}
BAR = 10
LOW_BATTERY = 0.2
MISSED = 1.1  # times the target error
BLIND = "dark_orange3"  # of blind slots, as in reports
EVENTS = 8
LONGEST_S = 3.2e9  # a century: what a clock that was set may say is drawn as no more


FIELDS = {field.name: field.uses.column for field in fields(CameraStatus) if field.uses.column}
# Heading, and how early the column gives way where a terminal is narrow (0: never).
COLUMNS = (("camera", 0), ("mode", 0), *FIELDS.values())
GAP = 1  # between two columns


def screen(status: Status | None, stale_s: float, problems: Sequence[str] = ()) -> RenderableType:
    """Return the picture of a site.

    Args:
        status: the newest; None before the first.
        stale_s: seconds since it came.
        problems: of streams, a line each.
    """
    if status is None:
        said = "Waiting for the edge (Ctrl-C quits)."
        return Text(said, style="yellow")
    lines: list[RenderableType] = [_head(status, stale_s), _Cameras(status)]
    lines += [Text(f"stream: {problem}", style="red") for problem in problems]
    for camera in status.cameras:
        if remark := _remark(camera):
            style = "red" if camera.why else "yellow"
            lines.append(Text(f"{camera.title}: {remark}", style=style))
    if status.events:
        lines.append(Text("\n".join(("Recent events:", *status.events[-EVENTS:])), style="dim"))
    return Group(*lines)


def _head(status: Status, stale_s: float) -> Text:
    online = sum(camera.online for camera in status.cameras)
    head = Text()
    head.append(f"{status.site}  ", style="bold")
    if stale_s > 3:
        head.append(f"no update for {stale_s:.0f} s  ", style="bold red")
    there = online + sum(map(sleeps_as_told, status.cameras))
    style = "green" if there == len(status.cameras) else "yellow" if there else "red"
    head.append(f"{online}/{len(status.cameras)} cameras online", style=style)
    if asleep := sum(map(sleeps_as_told, status.cameras)):
        head.append(f", {asleep} asleep", style="blue")
    head.append(f"  {plural(status.people, 'person', 'people')}", style="bold")
    head.append_text(_expected_error(status))
    if status.compiling_s is not None:
        head.append(f"\n{compiling_words(status.compiling_s)}", style="yellow")
    if status.fps == 0:
        head.append(f"\nno slots yet  up {_duration(status.uptime_s)}")
        return head
    head.append(
        f"\nslot {status.slot}  {status.fps:.1f}/s  lead {status.lead}  "
        f"up {_duration(status.uptime_s)}"
        f"\ncomputing {status.step_ms[0]:.1f} ms (99 %: {status.step_ms[1]:.1f})  "
        f"latency {status.latency_ms[0]:.1f} ms (99 %: {status.latency_ms[1]:.1f})"
    )
    if status.slots_lost:
        head.append(f"  {plural(status.slots_lost, 'slot')} lost", style="red")
    head.append_text(_blind(status))
    if status.overload:
        head.append(f"\n{status.overload}", style="red")
    if status.doubt:
        head.append(f"\n{status.doubt}", style="red")
    if status.check:
        head.append(f"\n{status.check}")
    watts = [c.power_w for c in status.cameras if _draws(c) and c.power_w is not None]
    if watts:
        modelled = "" if all(c.measured for c in status.cameras if _draws(c)) else " (modelled)"
        head.append(f"\n{sum(watts):.1f} W, all online cameras{modelled}")
    if (saved := savings(status)) != NO_SAVINGS:
        head.append(f"\n{saved.sentence()}")
    still = [camera.unchanged for camera in status.cameras if camera.unchanged is not None]
    if still:
        mean = _within(sum(still) / len(still), 1.0)
        head.append(
            f"\nimages unchanged in {mean:.0%} of the looks of {plural(len(still), 'camera')}"
        )
    return head


def _draws(camera: CameraStatus) -> bool:
    return camera.online or sleeps_as_told(camera)


def _blind(status: Status) -> Text:
    """Return how many slots were blind and why; empty if none was."""
    blind = sum(status.blind.values())
    if not blind:
        return Text("")
    share = _within(status.blind_share, 1.0)
    return Text(
        f"\n{plural(blind, 'slot')} blind, {share:.0%} of the last minute: "
        f"{blind_words(status.blind)}",
        style=BLIND if share > 0 else "",
    )


def compiling_words(rest_s: float) -> str:
    """Return how long the edge still compiles, or that it does if that is unknown (0)."""
    if rest_s:
        return f"compiling: {rest_s:.0f} s left (first start only); until then few poses a second"
    return "getting ready; a first start compiles for a minute or so, with few poses a second"


def _expected_error(status: Status) -> Text:
    """Return the expected error, and whether it keeps the target if there is one."""
    error_mm, target_mm = status.expected_error_mm, status.target_error_mm
    if error_mm is None:
        return Text("")
    said = Text(f", expected error {error_mm:.0f} mm")
    if target_mm is not None:
        missed = error_mm > MISSED * target_mm
        said.append(f" (target {target_mm:.0f} mm)", style="yellow" if missed else "")
        free = [camera for camera in status.cameras if camera.online and camera.mode != "active"]
        if missed and not free:
            said.append(", no camera left to wake", style="yellow")
    return said


@dataclass(frozen=True, slots=True)
class _Cameras:
    """The table of cameras, with as many columns as the terminal has room for."""

    status: Status

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the table; columns of least weight are dropped until it fits."""
        rows = [_row(camera, bars=True) for camera in self.status.cameras]
        shown = list(range(len(COLUMNS)))
        if _width(rows, shown) > options.max_width:
            rows = [_row(camera, bars=False) for camera in self.status.cameras]
        for index in sorted(shown, key=lambda i: COLUMNS[i][1]):
            if COLUMNS[index][1] and _width(rows, shown) > options.max_width:
                shown.remove(index)
        table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, GAP, 0, 0))
        for index in shown:
            name = COLUMNS[index][0]
            left = name in ("camera", "mode")
            table.add_column(name, justify="left" if left else "right", no_wrap=True)
        for row in rows:
            table.add_row(*(row[index] for index in shown))
        yield table


def _width(rows: list[list[Text]], shown: list[int]) -> int:
    widths = (max(len(COLUMNS[i][0]), *(len(row[i]) for row in rows), 0) for i in shown)
    return sum(widths) + GAP * len(shown)


def _row(camera: CameraStatus, bars: bool) -> list[Text]:
    if sleeps_as_told(camera):
        word, style = MODES["suspended" if camera.mode == "suspended" else "asleep"]
        mode = Text(word, style=style)
    elif camera.online:
        word, style = MODES.get(camera.mode or "", ("?", ""))
        mode = Text(word, style=style)
    else:
        mode = Text("offline", style="red")
    cells = [_cell(camera, name, bars) for name in FIELDS]
    return [Text(camera.title, style="bold"), mode, *cells]


def _cell(camera: CameraStatus, name: str, bars: bool) -> Text:
    """Return a field of a camera; empty where it is unknown."""
    value = getattr(camera, name)
    match name:
        case "last_seen_s":
            return Text("never" if value is None else f"{_within(value, LONGEST_S):.1f} s")
        case "late" | "lost":
            return Text(str(value), style="yellow" if value else "")
        case "clock_offset_ms":
            return Text("" if camera.last_seen_s is None else f"{value:+.1f}")
        case _ if value is None:
            return Text("")
        case "power_w":
            watts = f"{value:.1f}" if camera.measured else f"~{value:.1f}"  # ~ is modelled
            return Text(watts if _draws(camera) else "")
        case "battery":
            return _battery(camera, _within(value, 1.0), bars)
        case "cpu_s":
            return Text(f"{_within(value, LONGEST_S):.0f}")
        case "cpu_saved":
            return Text(f"{value:.0%}")
        case "duty" | "delivered":
            share = _within(value, 1.0)
            short = name == "delivered" and share < SHORT
            return Text(f"{share:.0%}", style="yellow" if short else "")
        case "noise_factor":
            return Text(f"{value:.1f}x")
    return Text(f"{value:.1f}")


def _battery(camera: CameraStatus, charge: float, bars: bool) -> Text:
    full = round(charge * BAR) if bars else 0
    style = "red" if charge < LOW_BATTERY else "green"
    battery = Text("|" * full + "." * (BAR - full) if bars else "", style=style)
    share = f"{charge:.0%}" if camera.gauge else f"~{charge:.0%}"
    return battery.append(f" {share:>5}" if bars else share, style="" if bars else style)


def _remark(camera: CameraStatus) -> str:
    """Return why a camera is excluded or impaired; empty if neither, or asleep by order."""
    if sleeps_as_told(camera):
        return ""
    if camera.turned_deg is not None and not camera.why:
        return moved_words(_within(camera.turned_deg, 180.0), camera.camera_id)
    return camera.why


def _duration(seconds: float) -> str:
    minutes, left = divmod(int(_within(seconds, LONGEST_S)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{left:02}"


def _within(value: float, most: float) -> float:
    """Return a value clipped to 0 to `most`; 0 for NaN."""
    return 0.0 if math.isnan(value) else min(max(value, 0.0), most)
