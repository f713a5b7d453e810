"""A site with its rig, validated before anything starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from e3pose.energy.budgets import Budget, parse_budget
from e3pose.errors import InputError
from e3pose.geometry.camera import Rig
from e3pose.model.noises import DEFAULT, SHIPPED
from e3pose.model.skeleton import Skeleton
from e3pose.pipeline import Pipeline
from e3pose.recording.calibration import load_rig, load_rotations
from e3pose.recording.calibration.world import assumed_rig, world_problem
from e3pose.settings.energy import EnergyPlan
from e3pose.settings.loop import LoopSettings
from e3pose.settings.parts import make_pipeline
from e3pose.settings.site_file import SITE_FILE, CameraTable, SiteTable
from e3pose.settings.skeletons import camera_detector, camera_skeletons, site_skeleton

ASSUMED_SIZE = (1280, 720)  # of images, until a camera was seen
OF_ENERGY = ("profile", "battery_wh", "lifetime")


@dataclass(frozen=True, slots=True)
class LiveSite:
    """Where a live loop runs, see `settings.parts.Place`, and how.

    Attributes:
        site: its file.
        rig: the cameras.
        cameras: what the file says of each, in the order of the rig.
        skeleton: of the poses.
        interval_s: seconds per slot.
        detector: whose noise serves all cameras.
        plan: what the cameras draw and have.
        loop: how the loop runs, with all that follows from the rig.
        source: nothing, as `detector` says it.
    """

    site: SiteTable
    rig: Rig
    cameras: Mapping[str, CameraTable]
    skeleton: Skeleton
    interval_s: float
    detector: str
    plan: EnergyPlan
    loop: LoopSettings
    source: str = ""

    def pipeline(self) -> Pipeline:
        """Return the parts of its loop.

        Raises:
            InputError: naming the file and the key that asks for what cannot be had.
        """
        try:
            return make_pipeline(self, self.loop)
        except InputError as error:
            raise _in_file(self.site, error) from None

    def world_warning(self) -> str:
        """Return what is odd about the axes or the unit of the cameras; empty if nothing."""
        calibration = self.site.near(self.site.calibration)
        words = world_problem(self.rig, calibration, rotations_of(self.site, self.rig))[1]
        return f"{calibration}: {words}" if words else ""

    def budgets(self, shares: Sequence[float], now: datetime) -> list[Budget]:
        """Return what each camera may spend: its own words, the site's, or its share of the slots.

        Args:
            shares: `(num_cameras,)` of the slots.
            now: the present, with its time zone.
        """
        found = []
        for (name, camera), share in zip(self.cameras.items(), shares, strict=True):
            words = camera.budget or self.site.budget
            try:
                found.append(Budget("duty", share) if words is None else parse_budget(words, now))
            except InputError as error:
                raise error.at(self.site.path, f"camera {name}: budget") from None
        return found


def site_rig(site: SiteTable) -> Rig:
    """Return the cameras of a site; raise `InputError` naming the key where there are none."""
    calibration = site.near(site.calibration)
    rig = load_rig(calibration) if calibration.exists() else None
    if rig is None or not rig.placed:
        found = f"no {calibration}" if rig is None else f"lenses without places in {calibration}"
        raise InputError("calibration", found, f"one: {calibrate_advice(site)}", str(site.path))
    return rig


def calibrate_advice(site: SiteTable) -> str:
    """Return the commands that make the calibration of a site."""
    folder = site.path.parent if site.path.name == SITE_FILE else site.path
    return (
        f"let people walk through the room, `e3pose record {folder} walk --for 60`, then "
        f"`e3pose calibrate extrinsics walk {site.near(site.calibration)} --update`"
    )


def known_rig(site: SiteTable) -> Rig:
    """Return the cameras of a site as far as they are known: placed, or lenses, or names alone.

    Raises:
        InputError: for a file that is no calibration.
    """
    calibration = site.near(site.calibration)
    if calibration.exists():
        return load_rig(calibration)
    if len(site.camera) == 0:
        error = InputError("calibration", f"no {calibration}", "the file of a rig")
        raise error.at(site.path)
    return assumed_rig({camera.id: ASSUMED_SIZE for camera in site.camera})


def rotations_of(site: SiteTable, rig: Rig) -> dict[str, int]:
    """Return by how many degrees clockwise images of turned cameras are turned for the detector.

    The site file takes precedence over the calibration.
    """
    calibration = site.near(site.calibration)
    known = load_rotations(calibration) if calibration.exists() else {}
    found = {
        name: known.get(name, 0) if camera.rotation is None else camera.rotation
        for name, camera in site.cameras_of(rig).items()
    }
    return {name: degrees for name, degrees in found.items() if degrees}


def live_site(
    site: SiteTable, change: Callable[[LoopSettings], LoopSettings] = lambda loop: loop
) -> LiveSite:
    """Return a site with its rig.

    Args:
        site: its file.
        change: of the settings of its loop, before those that follow from the rig are filled in.

    Raises:
        InputError: for a rig that is not there, and settings that it cannot have.
    """
    rig = site_rig(site)
    cameras = site.cameras_of(rig)
    known_wh = {name: c.battery_wh for name, c in cameras.items() if c.battery_wh}
    try:
        plan = site.energy.plan(rig.camera_ids, 1 / site.fps, known_wh)
        loop = change(site.loop).for_rig(len(rig), plan)
        found = camera_skeletons(site, cameras)
        skeleton = site_skeleton(site.skeleton, found.values())
    except InputError as error:
        raise _in_file(site, error) from None
    detector = noise_of(site, cameras) or DEFAULT
    return LiveSite(site, rig, cameras, skeleton, 1 / site.fps, detector, plan, loop)


def noise_of(site: SiteTable, cameras: Mapping[str, CameraTable]) -> str:
    """Return the detector whose noise serves all cameras; empty if none is known.

    Args:
        site: its file.
        cameras: of the site.
    """
    detectors = {camera_detector(site, camera) for camera in cameras.values()}
    return next((name for name in SHIPPED if name in detectors), "")


def _in_file(site: SiteTable, error: InputError) -> InputError:
    """Return an error of the settings with the key that they have in the site file."""
    if not error.thing or error.place:
        return error.at(site.path)
    if error.thing == "lead":
        return error.at(site.path)
    return error.under("energy" if error.thing in OF_ENERGY else "loop").at(site.path)
