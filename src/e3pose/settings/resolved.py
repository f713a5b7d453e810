"""A site as its programs are given it: its file with all that it names, read and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime
from pathlib import Path
from typing import TypeVar, cast

from e3pose.base.errors import InputError
from e3pose.detectors import skeleton_of
from e3pose.energy.budgets import Budget, parse_budget
from e3pose.model.camera import Rig
from e3pose.model.noises import DEFAULT, SHIPPED
from e3pose.model.skeleton import Skeleton, common_skeleton, skeleton_by_name
from e3pose.pipeline import Pipeline
from e3pose.recording.calibration import Calibration, load_calibration
from e3pose.recording.calibration.world import assumed_rig, world_problem
from e3pose.recording.folder import read_detector, read_skeleton
from e3pose.settings.energy import EnergyPlan
from e3pose.settings.limits import Rotation
from e3pose.settings.parts import make_pipeline
from e3pose.settings.site_file import (
    DEFAULT_DETECTOR,
    SITE_FILE,
    CameraTable,
    SiteTable,
    load_site,
)
from e3pose.settings.sources import RECORDED, is_recorded

ASSUMED_SIZE = (1280, 720)  # of images, until a camera was seen
OF_ENERGY = ("profile", "battery_wh", "lifetime")
Found = TypeVar("Found")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ResolvedSite(SiteTable):
    """A site file with all that it names; also where its loop runs, see `settings.parts.Place`.

    Attributes:
        rig: the cameras: with their places, or, of a site that is not calibrated yet, with their
            lenses, or with their names alone.
        cameras: what the file says of each, in the order of the rig: rotations are those of the
            calibration where the file has none, and cameras on this machine have a detector.
        skeletons: what the cameras' detectors output, of those of which it is known.
        skeleton: of the poses.
        detector: whose noise serves all cameras.
        plan: what the cameras draw and have.
        source: nothing, as `detector` says it.
    """

    rig: Rig
    cameras: Mapping[str, CameraTable]
    skeletons: Mapping[str, Skeleton]
    skeleton: Skeleton
    detector: str
    plan: EnergyPlan
    source: str = ""

    @property
    def interval_s(self) -> float:
        """Seconds per slot."""
        return 1 / self.fps

    @property
    def named_detector(self) -> str:
        """The detector whose noise serves all cameras; empty if none is known."""
        return "" if self.detector == DEFAULT else self.detector

    @property
    def rotations(self) -> dict[str, int]:
        """Degrees clockwise by which images of turned cameras are turned for the detector."""
        return {name: each.rotation for name, each in self.cameras.items() if each.rotation}

    def pipeline(self) -> Pipeline:
        """Return the parts of its loop.

        Raises:
            InputError: naming the file and the key that asks for what cannot be had.
        """
        try:
            return make_pipeline(self, self.loop)
        except InputError as error:
            raise _in_file(self, error) from None

    def world_warning(self) -> str:
        """Return what is odd about the axes or the unit of the cameras; empty if nothing."""
        words = world_problem(self.rig, self.calibration, self.rotations)[1]
        return f"{self.calibration}: {words}" if words else ""

    def budgets(self, shares: Sequence[float], now: datetime) -> list[Budget]:
        """Return what each camera may spend: its own words, the site's, or its share of the slots.

        Args:
            shares: `(num_cameras,)` of the slots.
            now: the present, with its time zone.
        """
        found = []
        for (name, camera), share in zip(self.cameras.items(), shares, strict=True):
            words = camera.budget or self.budget
            try:
                found.append(Budget("duty", share) if words is None else parse_budget(words, now))
            except InputError as error:
                raise error.at(self.path, f"camera {name}: budget") from None
        return found


def resolve_site(named: Path) -> ResolvedSite:
    """Return a calibrated site; see `load_site` and `resolve`."""
    return resolve(load_site(named))


def resolve(site: SiteTable, placed: bool = True) -> ResolvedSite:
    """Return a site with all that its file names.

    Args:
        site: what its file says.
        placed: whether its cameras must have places.

    Raises:
        InputError: for a rig that is not there, and settings that it cannot have.
    """
    known = load_calibration(site.calibration) if site.calibration.exists() else None
    rig = _rig(site, known, placed)
    cameras = _cameras(site, rig, {} if known is None else known.rotations)
    known_wh = {name: each.battery_wh for name, each in cameras.items() if each.battery_wh}
    skeletons = {name: made for name, each in cameras.items() if (made := _skeleton(each))}
    try:
        plan = site.energy.plan(rig.camera_ids, 1 / site.fps, known_wh)
        loop = site.loop.for_rig(len(rig), plan) if rig.placed else site.loop
        asked = site.skeleton_name
        skeleton = skeleton_by_name(asked) if asked else common_skeleton(skeletons.values())
    except InputError as error:
        raise _in_file(site, error) from None
    detectors = {_detector(each) for each in cameras.values()}
    return ResolvedSite(
        **{item.name: getattr(replace(site, loop=loop), item.name) for item in fields(SiteTable)},
        rig=rig,
        cameras=cameras,
        skeletons=skeletons,
        skeleton=skeleton,
        detector=next((name for name in SHIPPED if name in detectors), DEFAULT),
        plan=plan,
    )


def calibrate_advice(site: SiteTable) -> str:
    """Return the commands that make the calibration of a site."""
    folder = site.folder if site.path.name == SITE_FILE else site.path
    return (
        f"let people walk through the room, `e3pose record {folder} walk --for 60`, then "
        f"`e3pose calibrate extrinsics walk {site.calibration} --update`"
    )


def _rig(site: SiteTable, known: Calibration | None, placed: bool) -> Rig:
    """Return the cameras as far as they are known: placed, or lenses, or names alone."""
    rig, found = None if known is None else known.rig, f"no {site.calibration}"
    if placed and (rig is None or not rig.placed):
        found = found if rig is None else f"lenses without places in {site.calibration}"
        wanted = f"one: {calibrate_advice(site)}"
        raise InputError("calibration", found, wanted, str(site.path))
    if rig is None and not site.camera:
        raise InputError("calibration", found, "the file of a rig", str(site.path))
    return rig or assumed_rig({camera.id: ASSUMED_SIZE for camera in site.camera})


def _cameras(site: SiteTable, rig: Rig, turned: Mapping[str, int]) -> dict[str, CameraTable]:
    """Return what is known of every camera of the rig, in its order."""
    named = {camera.id: camera for camera in site.camera}
    for camera_id in named:
        if camera_id not in rig.camera_ids:
            known = f"one of {', '.join(rig.camera_ids)[:300]}"
            found = "no such camera in the calibration"
            raise InputError(f"camera {camera_id}", found, known, str(site.path))
    return {i: _filled(named.get(i) or CameraTable(i), turned.get(i, 0)) for i in rig.camera_ids}


def _filled(camera: CameraTable, turned: int) -> CameraTable:
    """Return a camera with its rotation, and with the detector that runs on this machine."""
    here = camera.source is not None and not is_recorded(camera.source)
    rotation = cast("Rotation", turned) if camera.rotation is None else camera.rotation
    detector = camera.detector or (DEFAULT_DETECTOR if here else None)
    return replace(camera, rotation=rotation, detector=detector)


def _detector(camera: CameraTable) -> str:
    """Return the detector of a camera, of a recorded one that of its recording."""
    if camera.detector is None and is_recorded(camera.source):
        return _of_recording(camera, read_detector) or ""
    return camera.detector or ""


def _skeleton(camera: CameraTable) -> Skeleton | None:
    """Return what a camera's detector outputs; None where that shows only when it runs."""
    if is_recorded(camera.source):
        return _of_recording(camera, read_skeleton)
    if camera.detector is None:
        return None
    try:
        return skeleton_of(camera.detector, camera.model)
    except (InputError, ImportError):  # an error of the camera, which runs it
        return None


def _of_recording(camera: CameraTable, read: Callable[[Path], Found]) -> Found | None:
    """Return what is read of the recording that a camera plays; None where that fails."""
    try:
        return read(Path((camera.source or "").removeprefix(RECORDED)))
    except InputError:
        return None  # an error when the camera starts


def _in_file(site: SiteTable, error: InputError) -> InputError:
    """Return an error of the settings with the key that they have in the site file."""
    if error.thing and not error.place and error.thing != "lead":
        error = error.under("energy" if error.thing in OF_ENERGY else "loop")
    return error.at(site.path)
