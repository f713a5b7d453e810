"""Choices made so far for a site, kept beside its site file."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from msgspec import Meta

from e3pose.base.atomic import write_file
from e3pose.base.errors import InputError
from e3pose.base.table import check_bounds, read_file
from e3pose.camera.probe import Probe
from e3pose.model.camera_fields import check_camera_id
from e3pose.settings.limits import Rotation
from e3pose.settings.site_file import SITE_FILE, SiteTable, load_site

PLAN_FILE = "setup.toml"
MAX_BYTES = 2**18
MAX_CAMERAS = 64


@dataclass(frozen=True, slots=True)
class ChosenCamera:
    """A chosen camera, and the properties of its source.

    Attributes:
        id: its name.
        source: what it sees; empty for one that runs on its own machine.
        rotation: degrees clockwise that make people in its images upright.
        width: of its images, pixels; 0 while unknown.
        height: likewise.
        fps: frames per second; 0 while unknown.
        announced: the rate that its source announces; 0 if it is `fps`.
        was: its name in the site file; empty for one that is new there.
    """

    id: str
    source: str = ""
    rotation: Rotation = 0
    width: Annotated[int, Meta(ge=0, le=100_000)] = 0
    height: Annotated[int, Meta(ge=0, le=100_000)] = 0
    fps: Annotated[float, Meta(ge=0, le=10_000)] = 0.0
    announced: Annotated[float, Meta(ge=0, le=10_000)] = 0.0
    was: str = ""

    def __post_init__(self) -> None:
        check_camera_id(self.id)
        check_bounds(self)

    @property
    def probe(self) -> Probe:
        """The properties of its source, as `new_site.Choice` takes them."""
        return Probe(
            self.source, (self.width, self.height), self.fps, False, self.announced or None
        )


@dataclass(frozen=True, slots=True)
class Plan:
    """The choices for a site.

    Attributes:
        format: `e3pose-setup`.
        version: 1.
        cameras: in their order.
        detector: of all cameras; empty while none was chosen.
        height_cm: of the person who walks; 0 while unknown.
        walk: folder of the newest walk to calibrate from, in the site's; empty before it.
        second: likewise of the one to check with.
        picked_origin: whether somebody chose the origin.
    """

    format: Literal["e3pose-setup"] = "e3pose-setup"
    version: Literal[1] = 1
    cameras: tuple[ChosenCamera, ...] = ()
    detector: str = ""
    height_cm: Annotated[float, Meta(ge=0, le=250)] = 0.0
    walk: str = ""
    second: str = ""
    picked_origin: bool = False

    def __post_init__(self) -> None:
        ids = [camera.id for camera in self.cameras]
        for camera_id in ids:
            if ids.count(camera_id) > 1:
                raise InputError(f"camera {camera_id}", "twice", "another name")
        if len(ids) > MAX_CAMERAS:
            raise InputError("cameras", f"{len(ids)}", f"at most {MAX_CAMERAS}")
        for name in (self.walk, self.second):
            if name:
                check_camera_id(name)  # it becomes a folder
        check_bounds(self)

    def camera(self, camera_id: str) -> ChosenCamera:
        """Return a camera by its name; raise `InputError` for none of the plan."""
        for camera in self.cameras:
            if camera.id == camera_id:
                return camera
        known = ", ".join(camera.id for camera in self.cameras) or "none was added yet"
        raise InputError("camera", repr(camera_id[:64]), f"one of {known}")

    def with_camera(self, camera_id: str, **changes: Any) -> Plan:
        """Return a plan in which one camera is changed; errors as of `camera` and of the fields."""
        changed = replace(self.camera(camera_id), **changes)
        cameras = tuple(changed if camera.id == camera_id else camera for camera in self.cameras)
        return replace(self, cameras=cameras)


def load_plan(folder: Path) -> Plan:
    """Load the choices for a site: from its plan, else from its site file.

    Raises:
        InputError: for a file that cannot be read.
    """
    path = folder / PLAN_FILE
    if path.exists():
        return read_file(Plan, path, MAX_BYTES)
    return of_site(load_site(folder)) if (folder / SITE_FILE).exists() else Plan()


def of_site(site: SiteTable) -> Plan:
    """Return the choices that a site file contains."""
    cameras = tuple(
        ChosenCamera(each.id, each.source or "", each.rotation or 0, was=each.id)
        for each in site.camera
    )
    detectors = {each.detector for each in site.camera if each.detector}
    return Plan(cameras=cameras, detector=detectors.pop() if len(detectors) == 1 else "")


def save_plan(folder: Path, plan: Plan) -> None:
    """Keep a plan in a site's folder, for its owner alone."""
    table = asdict(plan)
    table["cameras"] = [asdict(camera) for camera in plan.cameras]
    write_file(
        folder / PLAN_FILE,
        "# Choices made in `e3pose setup`; without this file it begins with the site file.\n"
        + tomli_w.dumps(table),
        private=True,
    )
