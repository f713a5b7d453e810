"""`e3pose power`: the power draw of this machine."""

from __future__ import annotations

import datetime
import math
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
from cyclopts import App, Parameter
from rich.live import Live
from rich.table import Table
from rich.text import Text

from e3pose.base.atomic import check_output, write_file
from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within, length_m, number, plural, quantity
from e3pose.camera.live_source import make_source
from e3pose.cli.network import ready_network
from e3pose.cli.options import Flag, Whole, ask
from e3pose.cli.output import JsonFile, is_stdout, write_json
from e3pose.detectors import AUTO, make_detector
from e3pose.energy.meters.base import MAX_WATTS, Meter, MeterError, Reading
from e3pose.energy.meters.battery import Charge, read_charge
from e3pose.energy.meters.choose import choose_meter
from e3pose.energy.meters.plug import open_plug
from e3pose.energy.plan import draw, hours_text, load_boards, plan, profile_board
from e3pose.energy.profiles import Activity, Mode, load_profile, modes_of, profile_text
from e3pose.evaluate.columns import print_tables, table_console
from e3pose.settings.sources import detects
from e3pose.site.bench import Watts, mean_watts
from e3pose.site.measure_modes import STEPS, Sample, measure_modes, measured_profile

USUAL_S = 10.0
LED_S = 40.0  # four steps and their waits are three minutes
SETTLE_S = 2.0  # until a meter outside shows what a step draws
DISPLAY = "display"
ENDED = InputError("power measure", "the input ended", "an answer, or --yes")
TO_DO = (  # in each of `STEPS`
    "The camera films, no network runs. Leave the computer alone.",
    "The network runs all the time. Walk about in front of the camera.",
    "The network rests. Leave the computer alone.",
    "The camera is closed, the program waits. Leave the computer alone.",
)

if TYPE_CHECKING:
    from e3pose.energy.modes import CameraModes

LEAST_S, MOST_S = 0.1, 60.0


power_app = App(
    name="power", help="Show what this machine draws, and measure how its camera looks and rests."
)


@power_app.default
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
    check_within("--seconds", seconds, LEAST_S, MOST_S)
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
        reading, charge = measure()
        line = msgspec.json.encode({"reading": reading, "charge": charge}).decode()
        print(line, flush=True)
    if json_file is not None:
        reading, charge = measure()
        write_json(json_file, msgspec.to_builtins({"reading": reading, "charge": charge}))
        return
    # A pipe gets whole lines; only a terminal has a width to fold to.
    console = table_console(200)
    if not watch:
        console.print(_table(*measure()))
        return
    with Live(_table(*measure()), console=console, auto_refresh=False) as live:
        while True:
            live.update(_table(*measure()), refresh=True)


def _table(reading: Reading, charge: Charge | None) -> Table:
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


@power_app.command
def measure(
    source: str,
    out: Path,
    /,
    *,
    detector: str = AUTO,
    profile: str = "generic",
    seconds: float | None = None,
    wakes: Whole = 5,
    pace: float = 1.0,
    provider: str = "auto",
    threads: Whole | None = None,
    meter: str | None = None,
    yes: Flag = False,
    root: Annotated[Path, Parameter(show=False)] = Path("/"),
) -> None:
    """Measure how the camera of this machine looks and rests; write its power profile.

    Example: `e3pose power measure usb:0 my-board.toml --meter shelly:192.168.1.20`

    Run it on the camera's own computer, with nothing else at work. Times and processor time are
    measured everywhere, watts where there is a sensor, or by a meter that the computer draws from:
    with `--meter`, on a terminal, it leads you through three minutes. Rows that cannot be measured
    keep what the profile states; a suspended machine has to be stated in the file.

    Parameters
    ----------
    source
        What the camera sees: usb:0, rtsp://..., a video, a folder of images.
    out
        Profile to write, a TOML file.
    detector
        2D pose network; auto takes the best one for live cameras.
    profile
        Power profile to start from: xavier-nx, tx2, generic, or a TOML file.
    seconds
        Seconds for each of looking, looking through the gate, capturing and resting, 1 to 600.
        Default: 10; 40 where you are led through the steps.
    wakes
        How often the source is opened, 1 to 100.
    pace
        Playback speed of a video or folder, 0.001 to 1, on a machine that is too slow for it.
    provider
        Execution provider.
    threads
        CPU threads of the network. Default: all cores.
    meter
        Smart plug with a meter, by HTTP: shelly:HOST or tasmota:HOST. display: a USB meter or a
        plug that you read yourself. Default: the sensors here.
    yes
        Begin at once, without the steps on the screen.
    """
    guided = meter is not None and not yes and sys.stdin.isatty() and sys.stdout.isatty()
    if meter == DISPLAY and not guided:
        raise InputError("--meter", DISPLAY, "a terminal, without --yes: you type what it shows")
    if seconds is None:
        seconds = LED_S if guided else USUAL_S
    check_within("--seconds", seconds, 1, 600)
    check_output(out)
    check_within("--wakes", wakes, 1, 100)
    if detects(source):
        raise InputError("source", "one that brings poses", "a camera or a video")
    base = load_profile(profile)
    check_within("--pace", pace, 1e-3, 1)
    frames = make_source(source, "camera", WallClock(), None, pace)
    detector = ready_network(detector, live=True)
    network = make_detector(detector, None, provider, threads)
    draws: Meter = choose_meter(base, root)
    if meter is not None:
        draws = Display() if meter == DISPLAY else open_plug(meter)
        print(f"waking, idle, looking, the gate, resting: about {4 * seconds + wakes:.0f} s")
    if guided:
        _begin(draws, wakes)
    settle_s = 0.0 if meter is None else min(SETTLE_S, seconds / 2)
    sample = _sample(draws, seconds, settle_s, guided)
    found = measure_modes(frames, network, sample, seconds, wakes)
    made = measured_profile(base, found, f"on {datetime.date.today()} with {detector}")
    write_file(out, profile_text(made))
    _print_modes(modes_of(made))
    print(
        f"processor time, measured: {1e3 * found.look_cpu_s:.1f} ms a look, "
        f"{1e3 * found.gate_cpu_s:.1f} ms unchanged, {1e3 * found.frame_cpu_s:.1f} ms a frame"
    )
    print(f"watts: {found.how}")
    for step, watts in found.watts.items():
        print(f"  {step:16} {watts.mean:7.2f} +- {watts.spread:.2f}")
    print(f"wrote {out}")


class Display:
    """A meter that somebody reads."""

    def read(self, mode: Activity) -> Reading:
        """See `Meter.read`; the watts are not known here."""
        return Reading(math.nan, None, True, "measured: read from a display")


def _begin(meter: Meter, wakes: int) -> None:
    """Tell what happens, and wait until somebody wants it."""
    now_w = meter.read("power-saving").watts
    shown = "you type what it shows" if math.isnan(now_w) else f"{now_w:.2f} W now"
    print(f"Meter between this computer and its supply: {shown}.")
    print("Close other programs, unplug what the camera does not need, then plug nothing in")
    print(f"or out. The camera is opened ({plural(wakes, 'time')}), then {len(STEPS)} steps begin.")
    ask("Press Enter to begin, Ctrl-C to stop: ", ENDED)


def _sample(meter: Meter, seconds: float, settle_s: float, guided: bool) -> Sample:
    """Return a function that measures the power of a step, on the screen if somebody is guided."""

    def sample(step: str, mode: Mode, work: Callable[[], None]) -> Watts:
        if not guided:
            return mean_watts(meter, mode, work, settle_s)
        end_s = time.monotonic() + seconds
        number = STEPS.index(step)
        print(f"{number + 1}/{len(STEPS)} {step}: {TO_DO[number]}")

        def show(watts: float) -> None:
            left = f"{max(end_s - time.monotonic(), 0.0):4.0f} s left"
            live = "  note what the display shows" if math.isnan(watts) else f"{watts:9.2f} W"
            print(f"\r\033[K{left}{live}", end="", flush=True)

        found = mean_watts(meter, mode, work, settle_s, show)
        print("\r\033[K", end="")
        if math.isnan(found.mean):
            found = _typed(found.last)
        print(f"    {found.mean:.2f} +- {found.spread:.2f} W")
        return found

    return sample


def _typed(reading: Reading) -> Watts:
    """Ask for the watts of a step until they are some."""
    while True:
        typed = ask("Watts in these seconds, one or more such as 4.9 5.1: ", ENDED)
        words = typed.replace(",", ".")
        try:
            watts = [number(word, "watts") for word in words.split()]
        except InputError:
            watts = []
        if watts and max(watts) <= MAX_WATTS:
            return Watts(statistics.fmean(watts), statistics.pstdev(watts), reading)
        print(f"Type numbers above 0, up to {MAX_WATTS:g}.")


@power_app.command
def modes(profile: str = "xavier-nx", /) -> None:
    """Show how a camera of a power profile looks and rests, and where each row is from.

    Example: `e3pose power modes xavier-nx`

    Parameters
    ----------
    profile
        xavier-nx, tx2, generic, or a TOML file such as `e3pose power measure` writes.
    """
    _print_modes(modes_of(load_profile(profile)))


@power_app.command(name="plan")
def plan_site(
    *,
    people: Whole = 1,
    error: str = "40mm",
    battery: str | None = None,
    cameras: Whole | None = None,
    profile: tuple[str, ...] = (),
    picture: Path | None = None,
    json_file: JsonFile = None,
) -> None:
    """Show which boards, how many cameras and how long a battery lasts.

    Example: `e3pose power plan --people 3 --error 40mm --battery 50Wh --picture plan.svg`

    The power of boards is what others published, each with its source; a figure that nobody
    published is unknown. How many cameras have to look is measured in simulated rooms.

    Parameters
    ----------
    people
        People in the room.
    error
        Mean error of joints to reach.
    battery
        Battery of each camera, such as 50Wh.
    cameras
        Cameras of the site: 2, 3, 4 or 6. Default: the fewest that reach the error.
    profile
        Power profiles of your own boards, TOML files; repeat the option for several.
    picture
        Draw how long batteries last, as a PNG, SVG or PDF file.
    json_file
        Write the plan here as JSON; - is standard output.
    """
    error_mm = 1e3 * length_m(error)
    battery_wh = None if battery is None else quantity(battery, {"Wh": 1, "kWh": 1e3}, "50Wh")
    boards = (*(profile_board(each) for each in profile), *load_boards())
    rows = plan(boards, people, error_mm, battery_wh, cameras)
    if json_file is not None:
        write_json(json_file, msgspec.to_builtins(rows))
    if picture is not None:
        if battery_wh is None:
            raise InputError("--battery", "none", "a battery, whose time is drawn")
        draw(rows, f"{plural(people, 'person', 'people')}, {error}, {battery} each", picture)
    if not is_stdout(json_file):
        columns: dict[str, list[str]] = {
            "cameras": [f"{r.reach.cameras}" if r.reach else "-" for r in rows],
            "active": [f"{r.reach.active:.2f}" if r.reach else "-" for r in rows],
            "W each": [_range(*r.watts) for r in rows],
            "battery": [hours_text(r) for r in rows],
        }
        for name in ("idle", "busy", "sleep", "wake"):
            figures = [getattr(row.board, name) for row in rows]
            columns[name] = ["unknown" if f is None else f"{f.value:g}" for f in figures]
        keys = {"board": [row.board.name for row in rows]}
        print_tables(table_console(), keys, columns, left=["board"])
        print("idle, busy, sleep: watts; wake: seconds. Sources:")
        for row in rows:
            for name in ("idle", "busy", "sleep", "wake"):
                if (figure := getattr(row.board, name)) is not None:
                    when = f" ({figure.date})" if figure.date else ""
                    print(f"  {row.board.name}, {name}: {figure.source}{when}")


def _range(low: float | None, high: float | None) -> str:
    if low is None or high is None:
        known = low if high is None else high
        return "unknown" if known is None else f"{'from' if high is None else 'up to'} {known:.3g}"
    return f"{low:.3g}"


def _print_modes(table: CameraModes) -> None:
    """Print the table of a camera, a row for each mode that it has."""
    looks = [(look.name, f"{look.joules:.3g} J", look.latency_s, None) for look in table.looks]
    rests = [(rest.name, f"{rest.watts:.3g} W", rest.wake_s, rest) for rest in table.rests]
    rows = [*looks, *rests]
    sources = [look.source for look in table.looks] + [rest.source for rest in table.rests]
    columns = {
        "costs": [cost for _, cost, _, _ in rows],
        "ms to view or to wake": [f"{1e3 * s:.0f}" if s or rest else "-" for _, _, s, rest in rows],
        "sd": ["" if rest is None else f"{1e3 * rest.wake_sd_s:.0f}" for *_, rest in rows],
        "from": sources,
    }
    print(f"{table.table}:")
    names = {"mode": [name for name, *_ in rows]}
    print_tables(table_console(200), names, columns, left=("mode", "from"))
