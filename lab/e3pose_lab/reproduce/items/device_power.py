"""Figure of the devices' power: each component in the modes of a camera, from the profiles."""

from __future__ import annotations

from collections.abc import Sequence

from e3pose.energy.profiles import MODES, DeviceProfile, load_profile
from e3pose_lab.reproduce.items.base import Item, Scale
from e3pose_lab.reproduce.power import DEVICES
from e3pose_lab.reproduce.records import Cell, Line, Panel, Section, Table
from e3pose_lab.reproduce.work import AnyPiece, Made

SHOWN = {"active": "intensive", "power-saving": "saving", "aggressive-power-saving": "aggressive"}


def pieces(scale: Scale) -> Sequence[AnyPiece]:
    """Return nothing: profiles are read, not computed."""
    return []


def section(scale: Scale, made: Made) -> Section:
    """Return the profiles' figures."""
    devices = {title: load_profile(name) for name, title in DEVICES.items()}
    halves = {
        title: device.watts("power-saving") / device.watts("active")
        for title, device in devices.items()
    }
    said = " and ".join(f"{100 * share:.0f} % ({title})" for title, share in halves.items())
    return Section(
        paper="In power-saving mode both devices draw roughly half of what they draw in "
        "power-intensive mode; processors and WiFi save most. The paper shows bars without "
        "numbers.",
        ours=f"Modelled: in power-saving mode the profiles draw {said} of intensive mode.",
        why="There is no independent evidence here: the profiles were fitted to agree with the "
        "paper's text (half the power, savings of 20.66 to 31.21 % and 17.72 to 28.67 % with 3 of "
        "5 cameras, 17.64 % of CPU power more without capture, all as means of the five). "
        "Nobody measured a board; `e3pose power` measures yours.",
        how="Modelled: the shipped power profiles xavier-nx and tx2; each figure names its source "
        "in the profile. The board of the TX2 meters CPU and GPU apart, that of the Xavier NX does "
        "not.",
        tables=(_table(devices),),
        panels=tuple(_panel(title, device) for title, device in devices.items()),
    )


def _table(devices: dict[str, DeviceProfile]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for title, device in devices.items():
        for part in device.components:
            rows.append((title, part.name, *(part.watts[mode] for mode in MODES), "modelled"))
        rows.append((title, "all", *(device.watts(mode) for mode in MODES), "modelled"))
    columns = ("device", "component", *(f"{SHOWN[mode]}, W" for mode in MODES), "basis")
    return Table("device-power", "Power by mode", columns, tuple(rows), digits=2)


def _panel(title: str, device: DeviceProfile) -> Panel:
    names = tuple(SHOWN[mode] for mode in MODES)
    lines = tuple(
        Line(part.name, "modelled", names, tuple(part.watts[mode] for mode in MODES))
        for part in device.components
    )
    return Panel(f"device-power-{device.name}", title, "", "power, W", lines, kind="stacked")


ITEM = Item(
    "device-power", "Power of the devices", "fig:PowerConsumptionMotivation", pieces, section
)
