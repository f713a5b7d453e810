"""What `e3pose top` shows: a status as a table, in plain colours."""

from __future__ import annotations

import math

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from e3pose.plural import counted
from e3pose.wire.messages import CameraStatus, Status

MODES = {
    "active": ("active", "green"),
    "power-saving": ("saving", "cyan"),
    "aggressive-power-saving": ("asleep", "blue"),
}
TELLING_SHIFT_PX = 3.0
BAR = 10
LOW_BATTERY = 0.2
EVENTS = 8
LONGEST_S = 3.2e9  # a century: what a clock that was set may say is drawn as no more


def screen(status: Status | None, stale_s: float) -> RenderableType:
    """Return the picture of a site.

    Args:
        status: the newest; None before the first.
        stale_s: seconds since it came.
    """
    if status is None:
        said = "waiting for the edge ... its very first start takes a minute or two (Ctrl-C ends)"
        return Text(said, style="yellow")
    lines: list[RenderableType] = [_head(status, stale_s), _cameras(status)]
    if status.events:
        lines.append(Text("\n".join(("newest events:", *status.events[-EVENTS:])), style="dim"))
    return Group(*lines)


def _head(status: Status, stale_s: float) -> Text:
    online = sum(camera.online for camera in status.cameras)
    head = Text()
    head.append(f"{status.site}  ", style="bold")
    if stale_s > 3:
        head.append(f"no news for {stale_s:.0f} s  ", style="bold red")
    style = "green" if online == len(status.cameras) else "yellow" if online else "red"
    head.append(f"{online}/{len(status.cameras)} cameras", style=style)
    head.append(f"  {counted(status.people, 'person', 'people')}", style="bold")
    if status.expected_error_mm is not None:
        head.append(f" within {status.expected_error_mm:.0f} mm")
    if status.fps == 0:
        head.append(f"\nno slots yet  up {_duration(status.uptime_s)}")
        return head
    head.append(
        f"\nslot {status.slot}  {status.fps:.1f} a second  lead {status.lead}  "
        f"up {_duration(status.uptime_s)}"
        f"\nstep {status.step_ms[0]:.1f} ms (99 %: {status.step_ms[1]:.1f})  "
        f"latency {status.latency_ms[0]:.1f} ms (99 %: {status.latency_ms[1]:.1f})"
    )
    if status.slots_lost:
        head.append(f"  {counted(status.slots_lost, 'slot')} lost", style="red")
    watts = [c.power_w for c in status.cameras if c.online and c.power_w is not None]
    if watts:
        head.append(f"\n{sum(watts):.1f} W in all cameras that are there")
    return head


def _cameras(status: Status) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in (
        "camera",
        "mode",
        "duty",
        "W",
        "battery",
        "owes",
        "seen",
        "late",
        "lost",
        "ms off",
        "noise",
    ):
        left = name in ("camera", "mode")
        table.add_column(name, justify="left" if left else "right", no_wrap=True)
    table.add_column("", no_wrap=False)
    for camera in status.cameras:
        table.add_row(*_row(camera))
    return table


def _row(camera: CameraStatus) -> list[Text]:
    if camera.online:
        word, style = MODES.get(camera.mode or "", ("?", ""))
        mode = Text(word, style=style)
    else:
        mode = Text("offline", style="red")
    watts = f"{camera.power_w:.1f}" if camera.online and camera.power_w is not None else ""
    if watts and not camera.measured:
        watts = f"~{watts}"  # a model says so
    battery = Text("")
    if camera.battery is not None:
        charge = _within(camera.battery, 1.0)
        full = round(charge * BAR)
        style = "red" if charge < LOW_BATTERY else "green"
        battery = Text("|" * full + "." * (BAR - full), style=style)
        share = f"{charge:.0%}" if camera.gauge else f"~{charge:.0%}"
        battery.append(f" {share:>5}", style="")
    seen = "never"
    if camera.last_seen_s is not None:
        seen = f"{_within(camera.last_seen_s, LONGEST_S):.1f} s"
    return [
        Text(camera.camera_id, style="bold"),
        mode,
        Text(f"{_within(camera.duty, 1.0):.0%}"),
        Text(watts),
        battery,
        Text(f"{camera.deficit:.1f}"),
        Text(seen),
        Text(str(camera.late), style="yellow" if camera.late else ""),
        Text(str(camera.lost), style="yellow" if camera.lost else ""),
        Text("" if camera.last_seen_s is None else f"{camera.clock_offset_ms:+.1f}"),
        Text("" if camera.noise_factor is None else f"{camera.noise_factor:.1f}x"),
        _remark(camera),
    ]


def _remark(camera: CameraStatus) -> Text:
    shift_px = _within(camera.shift_px or 0.0, 999.0)
    if camera.why or shift_px < TELLING_SHIFT_PX:
        return Text(camera.why, style="red")
    return Text(f"{shift_px:.0f} px off", style="yellow")


def _duration(seconds: float) -> str:
    minutes, left = divmod(int(_within(seconds, LONGEST_S)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{left:02}"


def _within(value: float, most: float) -> float:
    """Return a value from 0 to `most`, 0 for what is no number."""
    return 0.0 if math.isnan(value) else min(max(value, 0.0), most)
