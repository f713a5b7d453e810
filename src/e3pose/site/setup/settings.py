"""Settings of a site that exists: goals, zones, batteries, storage.

They are validated and written into the site file. A running edge is asked to take goals, zones,
the usual budget and the bounds of its store at once; batteries wait for a restart, and the page
says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any

import tomlkit
from pydantic import BaseModel, ConfigDict, Field

from e3pose.base.errors import InputError
from e3pose.base.quantities import length_m
from e3pose.settings.resolved import ResolvedSite, resolve
from e3pose.settings.site_file import MAX_CORNERS
from e3pose.site.setup.editing import edit_site, restore_before, set_or_drop
from e3pose.site.setup.going_live import LiveSite, ask_elsewhere, runs_elsewhere
from e3pose.site.setup.session import BEFORE, SetupSession
from e3pose.wire.site_messages import Control

Name = Annotated[str, Field(min_length=1, max_length=64)]
Short = Annotated[str, Field(max_length=60)]
Metres = Annotated[float, Field(ge=-1e4, le=1e4)]
Watthours = Annotated[float, Field(ge=0, le=1e6)]


class Asked(BaseModel):
    """A request of the page; unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Zone(Asked):
    """A zone of the floor; its corners in order around it."""

    name: Name
    corners: Annotated[list[tuple[Metres, Metres]], Field(min_length=3, max_length=MAX_CORNERS)]


class Wanted(Asked):
    """Requested settings; None keeps one, an empty text removes it.

    Attributes:
        cameras: active per slot, as a mean; in place of a target error.
        target_error: such as `40mm`, in place of a number of cameras.
        budget: of each camera, such as `4W`, `60%` or `until 18:00`.
        batteries: watt-hours by camera; 0 for mains.
        keep: the oldest to keep in the store, such as `30d`.
        max_size: the most to keep, such as `20GB`.
        zones: all of them.
    """

    cameras: Annotated[float | None, Field(gt=0, le=1000)] = None
    target_error: Short | None = None
    budget: Short | None = None
    batteries: Annotated[dict[Name, Watthours] | None, Field(max_length=64)] = None
    keep: Short | None = None
    max_size: Short | None = None
    zones: Annotated[list[Zone] | None, Field(max_length=32)] = None


def present(setup: SetupSession) -> dict[str, Any]:
    """Return the settings of a site as the page shows and changes them."""
    document = tomlkit.parse(setup.site_file.read_text(encoding="utf-8")).unwrap()
    site = resolve(setup.site(), placed=False)
    loop, store = document.get("loop", {}), document.get("store", {})
    return {
        "cameras": loop.get("cameras"),
        "most": len(site.cameras),
        "target_error": loop.get("target_error", ""),
        "budget": document.get("budget", ""),
        "batteries": {name: camera.battery_wh or 0 for name, camera in site.cameras.items()},
        "keep": store.get("keep", ""),
        "max_size": store.get("max_size", ""),
        "stored": bool(store),
        "zones": [
            {"name": zone.name, "corners": [list(corner) for corner in zone.corners]}
            for zone in site.file.zone
        ],
        "floor": _floor(site),
        "centers": [
            {"id": camera.camera_id, "x": round(float(camera.center_m[0]), 3),
             "y": round(float(camera.center_m[1]), 3)}
            for camera in site.rig.cameras
        ] if site.rig.placed else [],
        "before": setup.site_file.with_name(setup.site_file.name + BEFORE).exists(),
    }  # fmt: skip


def _floor(site: ResolvedSite) -> list[list[float]]:
    """Return the corners of the floor to draw on: where cameras stand, and a metre around."""
    if not site.rig.placed:
        return [[-3.0, -3.0], [3.0, 3.0]]
    centers = site.rig.centers_m[:, :2]
    low, high = centers.min(axis=0) - 1.0, centers.max(axis=0) + 1.0
    return [low.round(2).tolist(), high.round(2).tolist()]


def change_settings(setup: SetupSession, live: LiveSite, wanted: Wanted) -> dict[str, Any]:
    """Write requested settings into the site file, and apply them to a running edge.

    Returns:
        `said`, in words, and whether a `restart` is needed for the rest.

    Raises:
        InputError: for what is wrong; the file stays as it is then.
    """
    setup.tasks.check_free()
    if wanted.cameras is not None and wanted.target_error:
        raise InputError("cameras, target_error", "both", "one of them")
    setup.site()  # an error where there is none
    before = setup.site_file.read_bytes()
    site = edit_site(setup.folder, lambda document: _edit(document, wanted))
    if setup.site_file.read_bytes() == before:
        return {"said": "Nothing changed.", "restart": False}
    said = [f"Wrote {setup.shown(setup.site_file)}; the file of before is site.toml{BEFORE}."]
    if not (live.on or runs_elsewhere(site)):
        return {"said": " ".join(said), "restart": False}
    ask = live.ask if live.on else partial(ask_elsewhere, site)
    taken, rest = _at_once(ask, wanted)
    said += taken
    if rest:
        where = "" if live.on else ", where you started it"
        said.append(f"The running site takes {rest} at its next start{where}.")
    return {"said": " ".join(said), "restart": bool(rest) and live.on}


def _at_once(ask: Callable[[Control], str], wanted: Wanted) -> tuple[list[str], str]:
    """Apply the settings that a running edge can change; return its answer and the rest.

    Batteries wait: the program of each camera follows the charge of its own.
    """
    waits = [] if wanted.batteries is None else ["batteries"]
    said = []
    if wanted.cameras is not None or wanted.target_error:
        error_mm = None if not wanted.target_error else 1000 * length_m(wanted.target_error)
        try:
            said.append(f"At once: {ask(Control(wanted.cameras, error_mm))}.")
        except InputError as error:
            said.append(str(error))
            waits.insert(0, "the goal")
    file = [
        words
        for words, value in (
            ("zones", wanted.zones), ("budgets", wanted.budget),
            ("storage", wanted.keep if wanted.max_size is None else wanted.max_size),
        )
        if value is not None
    ]  # fmt: skip
    if file:
        try:
            said.append(f"At once: {ask(Control(reread=True))}.")
        except InputError as error:
            said.append(str(error))
            waits += file
    return said, " and ".join(waits)


def _edit(document: Any, wanted: Wanted) -> None:
    if wanted.cameras is not None:
        loop = document.setdefault("loop", tomlkit.table())
        whole = wanted.cameras == int(wanted.cameras)
        loop["cameras"] = int(wanted.cameras) if whole else wanted.cameras
        loop.pop("target_error", None)
    if wanted.target_error:
        loop = document.setdefault("loop", tomlkit.table())
        loop["target_error"] = wanted.target_error
        loop.pop("cameras", None)
    if wanted.budget is not None:
        set_or_drop(document, "budget", wanted.budget)
    for key, value in (("keep", wanted.keep), ("max_size", wanted.max_size)):
        if value is not None:
            if "store" not in document:
                raise InputError("store", "none in the site file", "[store] with its path")
            set_or_drop(document["store"], key, value)
    if wanted.batteries is not None:
        _batteries(document, wanted.batteries)
    if wanted.zones is not None:
        _zones(document, wanted.zones)


def _batteries(document: Any, batteries: Mapping[str, float]) -> None:
    tables = {str(table["id"]): table for table in document.get("camera", [])}
    for name, wh in batteries.items():
        if name not in tables:
            known = ", ".join(tables)
            raise InputError("batteries", f"camera {name[:64]!r}", f"one of {known}")
        set_or_drop(tables[name], "battery_wh", wh)


def _zones(document: Any, zones: Sequence[Zone]) -> None:
    known = {str(table["name"]): table for table in document.get("zone", [])}
    array = tomlkit.aot()
    for zone in zones:
        table = known.get(zone.name) or tomlkit.table()
        table["name"] = zone.name
        table["corners"] = [[round(x, 3), round(y, 3)] for x, y in zone.corners]
        array.append(table)
    set_or_drop(document, "zone", array)


def take_before(setup: SetupSession, live: LiveSite) -> dict[str, Any]:
    """Exchange the site file with the one of before the last change."""
    setup.tasks.check_free()
    restore_before(setup.site_file)
    return {"said": "The site file of before is back.", "restart": live.on}
