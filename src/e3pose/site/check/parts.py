"""The parts of a site that list their problems before it starts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.base.plugins import is_own, member
from e3pose.base.quantities import plural
from e3pose.detectors import DETECTORS, GROUP
from e3pose.energy.budgets import Budget, Supply, allowance_j, slot_shares
from e3pose.model.camera import Rig
from e3pose.model.skeleton import lacking, serves, some, unused
from e3pose.recording.calibration.world import world_problem
from e3pose.settings.parts import least_watts, row_of, shares
from e3pose.settings.resolved import ResolvedSite, calibrate_advice
from e3pose.settings.sources import is_recorded
from e3pose.site.check.finding import Finding, ok, problem, warning
from e3pose.site.check.link import clock_problems, link_problems
from e3pose.site.check.places import place_problems

JOULES = 3600.0  # a watt-hour
ENOUGH = 1e-6
APART_M = 0.1  # cameras nearer to each other than this see the same


def rig_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield the problems of the cameras' places, and of their common view."""
    rig, file, what = site.rig, site.file.calibration, "calibration"
    if not rig.placed:
        lost = f"no place of {', '.join(rig.unplaced)}" if rig.unplaced else "lenses, but no places"
        found = f"{file} has {lost}" if file.exists() else f"{file} is missing"
        yield problem(what, found, calibrate_advice(site.file))
        return
    if len(rig) < 2:
        yield problem(what, "one camera", "3D needs at least two cameras")
        return
    axes = np.array([camera.T_world_camera[:3, 2] for camera in rig.cameras])
    distance = np.linalg.norm(rig.centers_m[:, None] - rig.centers_m[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    for a, b in np.argwhere(np.triu(distance < APART_M)).tolist():
        found = (
            f"{rig.camera_ids[a]} and {rig.camera_ids[b]} are {distance[a, b] * 100:.0f} cm apart"
        )
        yield warning(what, found, "cameras in one place share one view; check the calibration")
    odd, words = world_problem(rig, file, site.rotations)
    if odd:
        yield (problem if odd == "rig-span" else warning)(what, f"{file}: {words}")
    for camera_id, others in zip(rig.camera_ids, _seen_by(rig, axes).tolist(), strict=True):
        if others == 0:
            found = f"{camera_id} does not overlap with any other camera"
            why = "people seen by one camera only get no 3D pose"
            yield warning(what, found, f"check its extrinsics; {why}")


def _seen_by(rig: Rig, axes: Floats) -> NDArray[np.int64]:
    """Return `(num_cameras,)`: cameras that see a point that this one sees, 2 to 8 m ahead."""
    centres, depth = rig.centers_m, np.linspace(2.0, 8.0, 13)[:, None, None]
    points = centres + depth * axes  # (num_depths, num_cameras, 3)
    counts = np.zeros(len(rig), dtype=np.int64)
    for index, camera in enumerate(rig.cameras):
        pixels, ahead = camera.project(points), (points - centres[index]) @ axes[index] > 0.1
        inside = ((pixels >= 0) & (pixels < np.array(camera.image_size))).all(axis=-1) & ahead
        seen = inside.any(axis=0)
        seen[index] = False
        counts += seen
    return counts


def skeleton_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield cameras whose detectors lack joints that the site needs."""
    for name, skeleton in site.skeletons.items():
        if skeleton == site.skeleton:
            continue
        what, missing = f"camera {name}", lacking(skeleton.joints, site.skeleton.joints)
        outputs = f"its detector outputs {skeleton.name}"
        lost = f"without {some(missing)}"
        if not serves(skeleton.joints, site.skeleton.joints):
            fix = f'skeleton = "{skeleton.name}", or another detector'
            yield problem(what, f"{outputs}, {lost}", fix)
        elif missing:
            yield warning(what, f"{outputs}, converted, {lost}")
        if left := unused(skeleton.joints, site.skeleton.joints):
            fix = f'skeleton = "{skeleton.name}" keeps them, where all cameras have them'
            yield warning(what, f"{outputs}, the site uses {site.skeleton.name}: {left}", fix)


def feedback_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield cameras that could not use the feedback that the site sends them."""
    if not site.loop.feedback:
        return
    for name, camera in site.cameras.items():
        if is_recorded(camera.source):
            why = "its source has keypoints, no images"
        elif not _uses_feedback(detector := camera.detector or ""):
            why = f"{detector} has neither detect_part nor detect_in_boxes"
        else:
            continue
        yield warning(f"camera {name}", f"ignores feedback: {why}")


def _uses_feedback(detector: str) -> bool:
    """Return whether a detector uses feedback; one's own may not, and True if it is unknown."""
    if not is_own(detector):
        return True
    try:
        found = member(GROUP, "detector", detector, DETECTORS)
    except InputError:
        return True  # another check tells of it
    if isinstance(found, type) or not callable(found):
        return hasattr(found, "detect_part") or hasattr(found, "detect_in_boxes")
    return True


def event_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield whether nobody keeps the events of people that the site asks for."""
    if site.file.events is not None and site.file.store is None:
        found = (
            "streams and the page tell them; without a store none is kept, and none brings a look"
        )
        yield warning("events", found, '[store] path = "poses.db"')


def watt_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield whether the cameras together cannot draw as little as the site asks for."""
    least_w = least_watts(site, site.loop) if site.rig.placed else None
    if least_w is not None:
        draw = f"the cameras draw {least_w:.3g} W when all of them are {site.loop.rest}"
        advice = "more watts in [loop], or profiles that rest for less"
        yield problem("watts", f"{site.loop.watts:g} W, but {draw}", advice)


def budget_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield whether budgets do not pay for what cameras draw, by their power profiles."""
    if not (site.rig.placed and any(site.stated)):
        return
    share = shares(site.loop, row_of(site.loop), len(site.rig)).tolist()
    each = zip(site.budgets(), share, strict=True)
    budgets = [own or Budget("duty", share) for own, share in each]
    modes = [camera.idle_mode for camera in site.cameras.values()]
    active_w = [profile.watts("active") for profile in site.plan.profiles]
    idle_w = [p.watts(mode) for p, mode in zip(site.plan.profiles, modes, strict=True)]
    supplies = [
        Supply() if camera.battery_wh is None else Supply(camera.battery_wh * JOULES)
        for camera in site.cameras.values()
    ]
    slot_s = site.interval_s
    active_j, idle_j = [w * slot_s for w in active_w], [w * slot_s for w in idle_w]
    selected = site.loop.num_selected or 1.0
    allowed_j = allowance_j(budgets, supplies, active_j, idle_j, slot_s, time.time(), selected)
    starved = [
        index
        for index, budget in enumerate(budgets)
        if budget.kind != "duty" and allowed_j[index] <= idle_j[index] * (1 + ENOUGH)
    ]
    paid = float(slot_shares(allowed_j, active_j, idle_j).sum())
    for index in starved:
        yield _starved(site, index, budgets[index], active_w[index], idle_w[index])
    if not starved and paid < selected - ENOUGH and site.loop.target_error_m is None:
        found = f"pays for {plural(round(paid, 2), 'camera')} per slot"
        advice = f"cameras = {paid:.2g} in [loop], or a larger budget"
        yield warning("budget", f"{found}, the site asks for {selected:g}", advice)
    elif not starved:
        yield ok("budget", f"pays for {paid:.2g} cameras per slot")


def _starved(
    site: ResolvedSite, index: int, budget: Budget, active_w: float, idle_w: float
) -> Finding:
    """Return the problem of a camera whose budget pays for no detection."""
    name, camera = list(site.cameras.items())[index]
    profile = site.plan.profiles[index]
    wanted_w = budget.value / (site.interval_s if budget.kind == "joules" else 1.0)
    sleeps = budget.kind != "until" and profile.watts("aggressive-power-saving") < wanted_w
    return problem(
        f"camera {name}",
        f"budget {camera.budget or site.file.budget!r} does not even pay for idling: it draws "
        f"{idle_w:.2g} W idle and {active_w:.2g} W active (profile {profile.name}), so it would "
        "never be selected",
        f"a budget above {idle_w:.2g} W"
        + (', or idle_mode = "aggressive-power-saving"' if sleeps else ""),
    )


Problems = Callable[[ResolvedSite], Iterable[Finding]]

# In the order in which a site is set up.
PARTS: Mapping[str, Problems] = {
    "calibration": rig_problems,
    "skeleton": skeleton_problems,
    "feedback": feedback_problems,
    "events": event_problems,
    "watts": watt_problems,
    "budget": budget_problems,
    "link": link_problems,
    "disks": lambda site: place_problems(site.file),
    "clock": lambda site: clock_problems(site.file.link.endpoint),
}


def start_problems(site: ResolvedSite) -> Iterator[Finding]:
    """Yield what all parts of a site find before it starts."""
    for problems in PARTS.values():
        yield from problems(site)
