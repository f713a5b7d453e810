"""What a site file asks of the loop, of energy and of the store: all told before anything opens."""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from e3pose.errors import InputError

if TYPE_CHECKING:
    from e3pose.cli.options import EnergyOptions
    from e3pose.edge.energy_ledger import EnergyLedger
    from e3pose.edge.server import EdgeServer
    from e3pose.energy.budgets import Budget
    from e3pose.geometry.camera import Rig
    from e3pose.settings.loop import ReplaySettings
    from e3pose.settings.site_file import SiteTable


def site_rig(path: Path, site: SiteTable) -> Rig:
    """Return the cameras of a site; raise `InputError` naming the key where there are none."""
    from e3pose.calibration import load_rig
    from e3pose.cli.placed import check_world
    from e3pose.settings.site_file import beside

    calibration = beside(path, site.calibration)
    if not calibration.exists():
        raise InputError(f"{path}: calibration: found no {calibration}, expected the file of a rig")
    rig = load_rig(calibration)
    check_world(rig, calibration, calibration)
    return rig


def check_settings(path: Path, site: SiteTable, rig: Rig) -> ReplaySettings:
    """Return the settings of the loop after a look at all else that a site file says.

    Raises:
        InputError: for whatever would keep the edge from starting, in the file or in its places.
    """
    from e3pose.settings.loop import make_pipeline
    from e3pose.site.edge_program import place_of
    from e3pose.store import parse_age, parse_size

    settings = loop_settings(path, site, rig)
    try:
        make_pipeline(place_of(path, site, rig), settings)
        if site.store is not None:
            _ = None if site.store.keep is None else parse_age(site.store.keep)
            _ = None if site.store.max_size is None else parse_size(site.store.max_size)
    except InputError as error:
        raise _in_file(path, error) from None
    _budgets(path, site, rig, [1.0] * len(rig))
    _check_places(path, site)
    return settings


def loop_settings(path: Path, site: SiteTable, rig: Rig) -> ReplaySettings:
    """Return the settings of the loop that a site file asks for; its keys are those of replay."""
    from e3pose.cli.options import LoopOptions, choice
    from e3pose.settings.loop import ReplaySettings
    from e3pose.settings.site_file import cameras_of, options_from

    table = dict(site.loop)
    cameras = table.pop("cameras", None)
    if "lead" in table:
        raise InputError(f"{path}: loop: lead: expected it at the top, a number or adaptive")
    number = isinstance(cameras, (int, float)) and not isinstance(cameras, bool)
    if not (cameras is None or (number and cameras > 0)):
        raise InputError(f"{path}: loop: cameras: found {cameras!r}, expected a number above 0")
    policy = table.pop("policy", None)
    if not (policy is None or isinstance(policy, str)):
        raise InputError(f"{path}: loop: policy: found {policy!r}, expected a name")
    known = {i: c.battery_wh for i, c in cameras_of(path, site, rig).items() if c.battery_wh}
    loop_options = options_from(path, "loop", table, LoopOptions)
    energy = _energy(path, site)
    try:
        loop = loop_options.settings()
        loop |= {key: _near(path, loop[key]) for key in ("noise", "predictor") if loop[key]}
        loop["lead_slots"] = site.lead if isinstance(site.lead, int) else 1
        plan = energy.plan(rig.camera_ids, 1 / site.fps, known)
        chosen = choice(cameras, loop, plan, len(rig))
    except InputError as error:
        raise _in_file(path, error) from None
    return ReplaySettings(policy=policy, **{**loop, **chosen})


def open_ledger(
    path: Path, site: SiteTable, rig: Rig, settings: ReplaySettings, server: EdgeServer
) -> EnergyLedger:
    """Return the ledger of a site's energy, with the budgets that its file asks for."""
    from e3pose.edge.energy_ledger import EnergyLedger

    energy = _energy(path, site)
    return EnergyLedger(
        rig.camera_ids,
        energy.plan(rig.camera_ids, 1 / site.fps).profiles,
        server.settings.idle_modes,
        _budgets(path, site, rig, server.pipeline.budget.tolist()),
        1 / site.fps,
        settings.num_selected,
        server.clock.now_ns,
        getattr(server.sink, "energy", None),
    )


def _energy(path: Path, site: SiteTable) -> EnergyOptions:
    from dataclasses import replace

    from e3pose.cli.options import EnergyOptions
    from e3pose.settings.site_file import options_from

    found: EnergyOptions = options_from(path, "energy", site.energy, EnergyOptions)
    parts = [part.rpartition("=") for part in found.profile.split(",")]
    return replace(found, profile=",".join(a + b + _near(path, c) for a, b, c in parts))


def _near(path: Path, name: str) -> str:
    """Return a name, or the file beside the site file that it means."""
    from e3pose.settings.site_file import beside

    file = beside(path, name)
    return str(file) if file.is_file() else name


def _budgets(path: Path, site: SiteTable, rig: Rig, shares: list[float]) -> list[Budget]:
    """Return what each camera may spend: its own words, the site's, or its share of the slots."""
    from e3pose.energy.budgets import Budget, parse_budget
    from e3pose.settings.site_file import cameras_of

    now, budgets = datetime.now().astimezone(), []
    for camera, share in zip(cameras_of(path, site, rig).values(), shares, strict=True):
        words = camera.budget or site.budget
        try:
            budgets.append(Budget("duty", share) if words is None else parse_budget(words, now))
        except InputError as error:
            raise InputError(f"{path}: camera {camera.id}: {error}") from None
    return budgets


def _check_places(path: Path, site: SiteTable) -> None:
    """What the edge writes must not be where something else stands."""
    from e3pose.files.atomic import check_file_free
    from e3pose.learn.online.versions import check_learning_folder
    from e3pose.settings.site_file import beside, store_place
    from e3pose.store.database import check_place, database_url

    try:
        if site.state:
            check_file_free(beside(path, site.state))
        if site.store is not None:
            check_place(database_url(store_place(path, site.store)))
        if site.learn is not None:
            check_learning_folder(beside(path, site.learn))
    except InputError as error:
        raise _in_file(path, error) from None


def _in_file(path: Path, error: InputError) -> InputError:
    if str(error).startswith(f"{path}:"):
        return error
    # What is an option of replay is a key here.
    text = re.sub(r"--([a-z]+(?:-[a-z]+)*)", lambda o: o[1].replace("-", "_"), str(error))
    return InputError(f"{path}: {text}")
