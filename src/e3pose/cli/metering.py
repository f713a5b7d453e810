"""`e3pose power`: the power draw of this machine."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from e3pose.base.errors import InputError
from e3pose.cli.options import Flag
from e3pose.cli.output import JsonFile, is_stdout, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from e3pose.energy.meters.base import Reading
    from e3pose.energy.meters.battery import Charge

LEAST_S, MOST_S = 0.1, 60.0


def power(
    *,
    watch: Flag = False,
    seconds: float = 1.0,
    profile: str = "generic",
    json_file: JsonFile = None,
    root: Annotated[Path, Parameter(show=False)] = Path("/"),
) -> None:
    """Show the power draw of this machine per supply, and whether it is measured or modelled.

    Example: `e3pose power --watch`

    The command reads the first that exists: power sensors of NVIDIA Jetson boards, a battery
    gauge, energy counters of Intel and AMD processors. Without any, it shows the profile.

    Parameters
    ----------
    watch
        Repeat until Ctrl-C.
    seconds
        Measurement time, 0.1 to 60.
    profile
        Power profile to show if nothing can be measured: xavier-nx, tx2, generic, or a TOML file.
    json_file
        Write the reading here as JSON; - is standard output. With --watch: - only, one line per
        reading.
    """
    from rich.console import Console
    from rich.live import Live

    from e3pose.energy.meters.base import MeterError
    from e3pose.energy.meters.battery import read_charge
    from e3pose.energy.meters.choose import choose_meter
    from e3pose.energy.profiles import load_profile

    if not LEAST_S <= seconds <= MOST_S:
        raise InputError(f"--seconds: found {seconds:g}, expected {LEAST_S:g} to {MOST_S:g}")
    if not root.is_dir():
        raise InputError(f"--root: found no folder {root}, expected one")
    meter = choose_meter(load_profile(profile), root)

    def measure() -> tuple[Reading, Charge | None]:
        time.sleep(seconds)
        reading = meter.read("active")
        try:
            return reading, read_charge(root)
        except MeterError:
            return reading, None

    if watch and json_file is not None and not is_stdout(json_file):
        raise InputError(f"--json: found {json_file} with --watch, expected -")
    while watch and is_stdout(json_file):
        _print_json_line(*measure())
    if json_file is not None:
        import msgspec

        reading, charge = measure()
        write_json(json_file, msgspec.to_builtins({"reading": reading, "charge": charge}))
        return
    # A pipe gets whole lines; only a terminal has a width to fold to.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 200)
    if not watch:
        console.print(_table(*measure()))
        return
    with Live(_table(*measure()), console=console, auto_refresh=False) as live:
        while True:
            live.update(_table(*measure()), refresh=True)


def _table(reading: Reading, charge: Charge | None) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False)
    table.add_column("supply")
    table.add_column("W", justify="right")
    table.add_column("")
    for rail in reading.rails:
        table.add_row(
            Text(rail.name), f"{rail.watts:.3f}", "" if rail.counted else "part of another supply"
        )
    style = "green" if reading.measured else "yellow"
    table.add_row("device", f"{reading.watts:.3f}", Text(reading.how, style=style))
    if charge is not None:
        share = "" if charge.share is None else f", {charge.share:.0%}"
        flow = f", {charge.charging_w:.2f} W in" if charge.charging_w else ""
        table.add_row(
            "battery", "", f"{charge.energy_j / 3600:.2f} Wh{share}, {charge.status}{flow}"
        )
    return table


def _print_json_line(reading: Reading, charge: Charge | None) -> None:
    import msgspec

    content: dict[str, Any] = {"reading": reading, "charge": charge}
    print(msgspec.json.encode(content).decode(), flush=True)
