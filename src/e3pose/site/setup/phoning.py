"""The step of cameras: a phone becomes one, and is shown the code that it scans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from e3pose.base.errors import InputError
from e3pose.model.camera_fields import check_camera_id
from e3pose.settings.sources import PHONE, place_of
from e3pose.site.phones import show_phone
from e3pose.site.setup.plan import ChosenCamera
from e3pose.site.setup.session import SetupSession

FOLDER = "phones"  # after the site's name: of its phones' files


def add_phone(setup: SetupSession, name: str) -> dict[str, Any]:
    """Add a phone to the plan, and return the code and address to show.

    Raises:
        InputError: for a name that is none or taken, or while other work has the cameras.
    """
    setup.tasks.check_free()
    setup.chosen_plan()
    name = check_camera_id(name.strip())
    path = setup.root / f"{setup.name}-{FOLDER}" / f"{name}.toml"
    if any(camera.id == name for camera in setup.plan().cameras):
        raise InputError(f"camera {name}", "it already", "another name")
    shown = _shown(setup, path)
    camera = ChosenCamera(name, f"{PHONE}{path}")
    setup.change(lambda plan: replace(plan, cameras=(*plan.cameras, camera)))
    return shown


def show_code(setup: SetupSession, camera_id: str) -> dict[str, Any]:
    """Return a new code for a phone that is a camera already; the phone before it is forgotten.

    Raises:
        InputError: for a camera that is no phone.
    """
    source = setup.plan().camera(camera_id).source
    if not source.startswith(PHONE):
        raise InputError("camera", repr(camera_id), "one that is a phone")
    return _shown(setup, Path(place_of(source) or ""))


def _shown(setup: SetupSession, path: Path) -> dict[str, Any]:
    keys = setup.site().link.keys if setup.has_site else None
    shown = show_phone(path, keys)
    return {
        "name": path.stem, "url": shown.url, "picture": shown.picture(), "port": shown.port,
        "fingerprint": shown.fingerprint, "minutes": shown.minutes,
        "command": f"e3pose phone {setup.shown(path)}",
    }  # fmt: skip
