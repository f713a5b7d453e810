"""A site as its programs are given it: its file with all that it names, read and checked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import cast

from e3pose.base.errors import InputError
from e3pose.base.quantities import shell
from e3pose.detectors import AUTO, chosen_name, skeleton_of
from e3pose.energy.budgets import Budget, parse_budget
from e3pose.model.camera import Rig
from e3pose.model.noises import DEFAULT, SHIPPED
from e3pose.model.skeleton import COCO17, Skeleton, common_skeleton, load_skeleton
from e3pose.model.skeleton import SHIPPED as SHIPPED_SKELETONS
from e3pose.pipeline import Pipeline
from e3pose.recording.calibration import load_calibration
from e3pose.recording.calibration.world import assumed_rig
from e3pose.recording.folder import read_detector, read_skeleton
from e3pose.settings.energy import EnergyPlan
from e3pose.settings.limits import Rotation
from e3pose.settings.loop import LoopSettings
from e3pose.settings.parts import make_pipeline
from e3pose.settings.site_file import (
    SITE_FILE,
    CameraTable,
    SiteTable,
    load_site,
)
from e3pose.settings.sources import RECORDED, detects, is_recorded, scheme_of

ASSUMED_SIZE = (1280, 720)  # of images, until a camera was seen
OF_ENERGY = ("profile", "battery_wh", "lifetime")
NOTHING: tuple[str, Skeleton | None] = ("", None)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResolvedSite:
    """A site file with all that it names; also where its loop runs, see `settings.parts.Place`.

    Attributes:
        file: what a person wrote.
        loop: how the loop runs, with all that follows from the rig and its energy.
        rig: the cameras: with their places, or, of a site that is not calibrated yet, with their
            lenses, or with their names alone.
        cameras: what the file says of each, in the order of the rig: rotations are those of the
            calibration where the file has none, and cameras on this machine have a detector.
        skeletons: what the cameras' detectors output, of those of which it is known.
        skeleton: of the poses.
        detector: whose noise serves all cameras.
        plan: what the cameras draw and have.
        stated: `(num_cameras,)` what the file lets each spend, from now on: None where it does not
            say, and an error in place of what cannot be, for whoever asks; see `budgets`.
    """

    file: SiteTable
    loop: LoopSettings
    rig: Rig
    cameras: Mapping[str, CameraTable]
    skeletons: Mapping[str, Skeleton]
    skeleton: Skeleton
    detector: str
    plan: EnergyPlan
    stated: tuple[Budget | InputError | None, ...]

    @property
    def active_w(self) -> dict[str, float]:
        """By camera, what an active one draws by its profile, watts."""
        watts = (profile.watts("active") for profile in self.plan.profiles)
        return dict(zip(self.rig.camera_ids, watts, strict=True))

    @property
    def interval_s(self) -> float:
        """Seconds per slot."""
        return 1 / self.file.fps

    @property
    def named_detector(self) -> str:
        """The detector whose noise serves all cameras; empty if none is known."""
        return "" if self.detector == DEFAULT else self.detector

    @property
    def known_joints(self) -> frozenset[tuple[str, ...]] | None:
        """Joints of detectors that the skeleton was chosen for; None where the file states it."""
        found = frozenset(skeleton.joints for skeleton in self.skeletons.values())
        return None if self.file.skeleton_name else found

    @property
    def rotations(self) -> dict[str, int]:
        """Degrees clockwise by which images of turned cameras are turned for the detector."""
        return {name: each.rotation for name, each in self.cameras.items() if each.rotation}

    def pipeline(self) -> Pipeline:
        """Return the parts of its loop.

        Raises:
            InputError: naming the file and the key that asks for what cannot be had.
        """
        with _in_file(self.file.path):
            return make_pipeline(self, self.loop)

    def budgets(self) -> list[Budget | None]:
        """Return the energy budget of each camera by the file; None where it has none.

        Raises:
            InputError: for a time that has passed, and what is no budget.
        """
        for stated in self.stated:
            if isinstance(stated, InputError):
                raise stated
        return [stated for stated in self.stated if not isinstance(stated, InputError)]


def resolve_site(named: Path, smooth_delay_ms: float | None = None) -> ResolvedSite:
    """Return a calibrated site; see `load_site` and `resolve`.

    Args:
        named: the file, or the folder that has it as `site.toml`.
        smooth_delay_ms: in place of what the file says.
    """
    site = load_site(named)
    if smooth_delay_ms is not None:
        site = replace(site, smooth_delay_ms=smooth_delay_ms)
    return resolve(site)


def resolve(site: SiteTable, placed: bool = True) -> ResolvedSite:
    """Return a site with all that its file names.

    Args:
        site: what its file says.
        placed: whether its cameras must have places.

    Raises:
        InputError: for a rig that is not there, and settings that it cannot have.
    """
    in_file = _in_file(site.path)
    named = {camera.id: _with_detector(camera) for camera in site.camera}
    outputs = {camera_id: _output(camera) for camera_id, camera in named.items()}
    known = load_calibration(site.calibration) if site.calibration.exists() else None
    rig, turned = (None, {}) if known is None else (known.rig, known.rotations)
    if placed and (rig is None or not rig.placed):
        found = "no " if rig is None else "lenses without places in "
        if rig is not None and rig.unplaced:
            found = f"no place of {', '.join(rig.unplaced)[:300]} in "
        wanted = f"one: {calibrate_advice(site)}"
        raise InputError("calibration", f"{found}{site.calibration}", wanted, str(site.path))
    if rig is None and not named:
        found = f"no {site.calibration}"
        raise InputError("calibration", found, "the file of a rig", str(site.path))
    rig = rig or assumed_rig(dict.fromkeys(named, ASSUMED_SIZE))
    for camera_id in named:
        if camera_id not in rig.camera_ids:
            listed = f"one of {', '.join(rig.camera_ids)[:300]}"
            found = "no such camera in the calibration"
            raise InputError(f"camera {camera_id}", found, listed, str(site.path))
    cameras = {name: named.get(name) or CameraTable(name) for name in rig.camera_ids}
    for name, camera in cameras.items():
        if camera.rotation is None:
            rotation = cast("Rotation", turned.get(name, 0))
            cameras[name] = replace(camera, rotation=rotation)
    skeletons = {name: made for name in cameras if (made := outputs.get(name, NOTHING)[1])}
    detectors = {detector for detector, _ in outputs.values()}
    known_wh = {name: each.battery_wh for name, each in cameras.items() if each.battery_wh}
    with in_file:
        asked = site.skeleton_name
        own = asked if asked in SHIPPED_SKELETONS else site.folder / (asked or "")
        skeleton = load_skeleton(own) if asked else common_skeleton(skeletons.values())
        plan = site.energy.plan(rig.camera_ids, 1 / site.fps, known_wh)
        loop = site.loop.for_rig(len(rig), plan) if rig.placed else site.loop
    now, stated = datetime.now().astimezone(), list[Budget | InputError | None]()
    for name, camera in cameras.items():
        words = camera.budget or site.budget
        try:
            stated.append(None if words is None else parse_budget(words, now))
        except InputError as error:
            stated.append(error.at(site.path, f"camera {name}: budget"))
    return ResolvedSite(
        file=site,
        loop=loop,
        rig=rig,
        cameras=cameras,
        skeletons=skeletons,
        skeleton=skeleton,
        detector=next((name for name in SHIPPED if name in detectors), DEFAULT),
        plan=plan,
        stated=tuple(stated),
    )


def calibrate_advice(site: SiteTable) -> str:
    """Return the commands that make the calibration of a site."""
    folder = site.folder if site.path.name == SITE_FILE else site.path
    return (
        f"let somebody walk through the room, `e3pose record {shell(folder)} walk --for 60`, then, "
        "with the height of that person, "
        f"`e3pose calibrate extrinsics walk {shell(site.calibration)} --height 171cm --update`"
    )


def _with_detector(camera: CameraTable) -> CameraTable:
    """Return a camera with the detector that runs on this machine."""
    here = camera.source is not None and not detects(camera.source)
    if not here or (camera.detector or AUTO) != AUTO:
        return camera
    with suppress(InputError):  # an error of the camera, which opens the file
        return replace(camera, detector=chosen_name(AUTO, camera.model))
    return replace(camera, detector=AUTO)


def _output(camera: CameraTable) -> tuple[str, Skeleton | None]:
    """Return a camera's detector and its output; empty and None where only its run tells."""
    if is_recorded(camera.source):
        folder = Path((camera.source or "").removeprefix(RECORDED))
        with suppress(InputError):  # an error when the camera starts
            return camera.detector or read_detector(folder), read_skeleton(folder)
    elif camera.source and detects(camera.source):
        return camera.detector or scheme_of(camera.source), COCO17
    elif camera.detector is not None:
        with suppress(Exception):  # an error of the camera, which runs it
            return camera.detector, skeleton_of(camera.detector, camera.model)
    return camera.detector or "", None


@contextmanager
def _in_file(path: Path) -> Iterator[None]:
    """Let errors of the settings name a site file and the key that they have in it."""
    try:
        yield
    except InputError as error:
        if error.thing and not error.place and error.thing != "lead":
            error = error.under("energy" if error.thing in OF_ENERGY else "loop")
        raise error.at(path) from None
