"""The step of cameras: a phone becomes one, and is shown the code that it scans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from e3pose.base.errors import InputError
from e3pose.model.camera_fields import check_camera_id
from e3pose.settings.sources import PHONE, place_of
from e3pose.site.phones import show_phone
from e3pose.site.setup.desk import Desk
from e3pose.site.setup.plan import ChosenCamera

FOLDER = "phones"  # after the site's name: of its phones' files


def add_phone(desk: Desk, name: str) -> dict[str, Any]:
    """Make a phone a camera of the plan, and return what is shown to its person.

    Raises:
        InputError: for a name that is none or taken, or while other work has the cameras.
    """
    desk.tasks.check_free()
    desk.chosen_plan()
    name = check_camera_id(name.strip())
    path = desk.root / f"{desk.name}-{FOLDER}" / f"{name}.toml"
    if any(camera.id == name for camera in desk.plan().cameras):
        raise InputError(f"camera {name}", "it already", "another name")
    shown = _shown(desk, path)
    camera = ChosenCamera(name, f"{PHONE}{path}")
    desk.change(lambda plan: replace(plan, cameras=(*plan.cameras, camera)))
    return shown


def show_code(desk: Desk, camera_id: str) -> dict[str, Any]:
    """Return a new code for a phone that is a camera already; the phone before it is forgotten.

    Raises:
        InputError: for a camera that is no phone.
    """
    source = desk.plan().camera(camera_id).source
    if not source.startswith(PHONE):
        raise InputError("camera", repr(camera_id), "one that is a phone")
    return _shown(desk, Path(place_of(source) or ""))


def _shown(desk: Desk, path: Path) -> dict[str, Any]:
    keys = desk.site().link.keys if desk.has_site else None
    shown = show_phone(path, keys)
    return {
        "name": path.stem, "url": shown.url, "picture": shown.picture(), "port": shown.port,
        "fingerprint": shown.fingerprint, "minutes": shown.minutes,
        "command": f"e3pose phone {desk.shown(path)}",
    }  # fmt: skip
