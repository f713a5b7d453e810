"""Check that settings agree: skeletons with detectors, budgets with power draw."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime

from e3pose.base.errors import InputError
from e3pose.base.plugins import is_own, member
from e3pose.base.quantities import plural
from e3pose.detectors import DETECTORS, GROUP
from e3pose.energy.budgets import Budget, Supply, allowance_j, slot_shares
from e3pose.model.skeleton import lacking, serves
from e3pose.settings.parts import least_watts
from e3pose.settings.resolved import ResolvedSite
from e3pose.settings.sources import is_recorded
from e3pose.site.check.finding import Finding
from e3pose.site.edge_program import EdgeParts

JOULES = 3600.0  # a watt-hour
ENOUGH = 1e-6


def check_skeletons(site: ResolvedSite) -> Iterator[Finding]:
    """Check that the cameras' detectors output the joints that the site needs."""
    own = "" if site.file.skeleton_name else ", that of the detectors"
    yield Finding(
        "ok", "skeleton", f"{site.skeleton.name}{own if site.skeletons else ', the default'}"
    )
    for name, skeleton in site.skeletons.items():
        if skeleton == site.skeleton:
            continue
        what, missing = f"camera {name}", lacking(skeleton.joints, site.skeleton.joints)
        outputs = f"its detector outputs {skeleton.name}"
        lost = f"without {', '.join(missing)}"
        if not serves(skeleton.joints, site.skeleton.joints):
            fix = f'skeleton = "{skeleton.name}", or another detector'
            yield Finding("problem", what, f"{outputs}, {lost}", fix)
        elif missing:
            yield Finding("warning", what, f"{outputs}, converted, {lost}")
        else:
            yield Finding("ok", what, f"{outputs}, converted")


def check_feedback(site: ResolvedSite) -> Iterator[Finding]:
    """Check which cameras could not use the feedback that the site sends them."""
    if not site.loop.feedback:
        return
    for name, camera in site.cameras.items():
        if is_recorded(camera.source):
            why = "its source has keypoints, no images"
        elif not _uses_feedback(detector := camera.detector or ""):
            why = f"{detector} has neither detect_part nor detect_in_boxes"
        else:
            continue
        yield Finding("warning", f"camera {name}", f"ignores feedback: {why}")


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


def check_events(site: ResolvedSite) -> Iterator[Finding]:
    """Check that the events of people reach a store or a stream."""
    if site.file.events is not None and site.file.store is None:
        yield Finding(
            "warning",
            "events",
            "streams and the page tell them; without a store none is kept, and none brings a look",
            '[store] path = "poses.db"',
        )


def check_watts(site: ResolvedSite) -> Iterator[Finding]:
    """Check that the cameras together can draw as little as the site asks for."""
    least_w = least_watts(site, site.loop)
    if least_w is not None:
        yield Finding(
            "problem",
            "watts",
            f"{site.loop.watts:g} W, but the cameras draw {least_w:.3g} W when all of them are "
            f"{site.loop.rest}",
            "more watts in [loop], or profiles that rest for less",
        )


def check_budgets(site: ResolvedSite, parts: EdgeParts, now: datetime) -> Iterator[Finding]:
    """Check that budgets pay for the cameras' power, by their profiles.

    Args:
        site: what its file says.
        parts: what its edge is made of.
        now: the present, with its time zone.
    """
    if not any(parts.budgets):
        return
    each = zip(parts.budgets, parts.pipeline.queue.budget.tolist(), strict=True)
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
    allowed_j = allowance_j(budgets, supplies, active_j, idle_j, slot_s, now.timestamp(), selected)
    starved = [
        index
        for index, budget in enumerate(budgets)
        if budget.kind != "duty" and allowed_j[index] <= idle_j[index] * (1 + ENOUGH)
    ]
    shares = slot_shares(allowed_j, active_j, idle_j)
    for index in starved:
        yield _starved(site, index, budgets[index], active_w[index], idle_w[index])
    if not starved and shares.sum() < selected - ENOUGH and site.loop.target_error_m is None:
        yield Finding(
            "warning",
            "budget",
            f"pays for {plural(round(float(shares.sum()), 2), 'camera')} per slot, the site asks "
            f"for {selected:g}",
            f"cameras = {shares.sum():.2g} in [loop], or a larger budget",
        )
    elif not starved:
        yield Finding("ok", "budget", f"pays for {shares.sum():.2g} cameras per slot")


def _starved(
    site: ResolvedSite, index: int, budget: Budget, active_w: float, idle_w: float
) -> Finding:
    """Return the problem of a camera whose budget allows no detection."""
    name, camera = list(site.cameras.items())[index]
    profile = site.plan.profiles[index]
    wanted_w = budget.value / (site.interval_s if budget.kind == "joules" else 1.0)
    sleeps = budget.kind != "until" and profile.watts("aggressive-power-saving") < wanted_w
    return Finding(
        "problem",
        f"camera {name}",
        f"budget {camera.budget or site.file.budget!r} does not even pay for idling: it draws "
        f"{idle_w:.2g} W idle and {active_w:.2g} W active (profile {profile.name}), so it would "
        "never be selected",
        f"a budget above {idle_w:.2g} W"
        + (', or idle_mode = "aggressive-power-saving"' if sleeps else ""),
    )
