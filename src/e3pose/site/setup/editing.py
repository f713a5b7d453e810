"""Change a site file that exists: validated before it is written, the file of before kept.

Comments and all that nobody asked to change stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import tomlkit

from e3pose.base.atomic import write_file
from e3pose.base.bounded import parse_toml, read_bytes
from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.settings.resolved import ResolvedSite, resolve
from e3pose.settings.site_file import MAX_BYTES, SITE_FILE, read_site
from e3pose.site.detector_speed import KEPT, save_times, suggested_deadline_ms, workloads_of
from e3pose.site.new_site import LEAST_DEADLINE_MS, Choice, rates
from e3pose.site.setup.plan import Plan
from e3pose.site.setup.session import BEFORE, SetupSession, keep_before

Change = Callable[[Any], object]  # takes the document of a site file, and changes it


def edit_site(folder: Path, change: Change) -> ResolvedSite:
    """Change the site file of a folder.

    Args:
        folder: of the site.
        change: changes its document, as `tomlkit` has it.

    Returns:
        The site as it is then.

    Raises:
        InputError: for what would be wrong in the file, which stays as it is then.
    """
    path = folder / SITE_FILE
    before = read_bytes(path, MAX_BYTES).decode("utf-8")
    document = tomlkit.parse(before)
    change(document)
    text = tomlkit.dumps(document)
    site = checked(text, path)
    if text != before:
        keep_before(path)
        write_file(path, text, private=True)
    return site


def checked(text: str, path: Path) -> ResolvedSite:
    """Parse a text as a site file; raise `InputError` if it is invalid."""
    from e3pose.site.edge_program import check_edge

    table = parse_toml(text, str(path))
    try:
        site = resolve(read_site(table, path), placed=False)
    except InputError as error:
        raise error.at(path) from None
    if site.rig.placed:
        check_edge(site)
    return site


def apply_cameras(setup: SetupSession, choice: Choice) -> None:
    """Write the cameras, the network and the rates of a choice into a site file that exists.

    A calibration stays where its cameras do: those that were removed leave it, those that were
    renamed keep their place in it. With a new camera it is put aside, and a walk is due.
    """
    plan = setup.plan()
    path, before = setup.calibration, None
    if path.exists():
        before = path.read_bytes()
        rig = load_rig(path)
        keep_before(path)
        if rig.placed and all(c.was in rig.camera_ids for c in plan.cameras):
            of_plan = [(rig.cameras[rig.index(c.was)], c.id) for c in plan.cameras]
            save_rig(Rig(tuple(replace(seen, camera_id=name) for seen, name in of_plan)), path)
        else:  # one was never calibrated
            path.unlink()
    try:
        site = edit_site(setup.folder, lambda document: _cameras(document, plan, choice))
    except InputError:
        if before is not None:
            path.write_bytes(before)
        raise
    if before is not None and not path.exists():
        setup.change(lambda now: replace(now, walk="", second="", picked_origin=False))
        setup.keep_result("solve", None)
        setup.keep_result("check", None)
    if choice.times is not None:
        save_times(setup.folder / KEPT, workloads_of(site), choice.times)


def _cameras(document: Any, plan: Plan, choice: Choice) -> None:
    fps, pace = rates(choice)
    document["fps"] = round(fps, 3)
    if pace != 1 or "pace" in document:
        document["pace"] = pace
    if choice.times is not None:
        document["deadline_ms"] = max(LEAST_DEADLINE_MS, suggested_deadline_ms(choice.times))
    loop = document.get("loop", {})
    if isinstance(loop.get("cameras"), int | float):
        loop["cameras"] = min(loop["cameras"], len(plan.cameras))
    tables = {str(table["id"]): table for table in document.get("camera", [])}
    array = tomlkit.aot()
    for camera in plan.cameras:
        table = tables.get(camera.was) or tomlkit.table()
        table["id"], table["source"] = camera.id, camera.source
        table["detector"], table["threads"] = choice.detector, choice.threads
        set_or_drop(table, "rotation", camera.rotation)
        table.setdefault("provider", choice.provider)
        array.append(table)
    document["camera"] = array


def set_or_drop(table: Any, key: str, value: Any) -> None:
    """Set a key of a document; drop it for an empty value or 0."""
    if value:
        table[key] = value
    else:
        table.pop(key, None)


def restore_before(path: Path) -> None:
    """Exchange a file with the one of before, so that doing it twice changes nothing.

    Raises:
        InputError: where there is none.
    """
    kept = path.with_name(path.name + BEFORE)
    if not kept.exists():
        raise InputError(f"{kept}: file not found, expected the site file of before a change")
    content = kept.read_bytes()
    if path.name == SITE_FILE:
        checked(content.decode("utf-8"), path)
    keep_before(path)
    write_file(path, content, private=True)
