"""Make the parts of a loop from its settings and its rig."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.energy.queues import Queue
from e3pose.energy.rest_costs import RestCosts
from e3pose.estimate import Estimator, EstimatorSettings, estimator_maker
from e3pose.estimate.per_slot.fusion import (
    EPIPOLAR_PX,
    MATCHERS,
    MAX_EPIPOLAR_PX,
    FusionSettings,
)
from e3pose.model.camera import Rig
from e3pose.model.noises import DEFAULT, detector_of, load_noise
from e3pose.model.skeleton import Skeleton
from e3pose.pipeline import Pipeline
from e3pose.predict import (
    Predictor,
    make_predictor,
    make_predictor_or_fallback,
    make_predictors,
)
from e3pose.select.awake import RestPlanner
from e3pose.select.camera_order import spread_order
from e3pose.select.feedback import Feedback
from e3pose.select.policies import (
    COUNT,
    POLICIES,
    TARGET,
    Need,
    Policy,
    PolicyRow,
    PolicySettings,
    Promise,
    policy_row,
)
from e3pose.select.policies.base import check_policy
from e3pose.select.rest_plan import RestGoal
from e3pose.settings.energy import AWAKE, EnergySettings
from e3pose.settings.loop import LoopSettings, pipeline_row

STEERING = "attention-lstm"  # steers the filter by default
STEERING_SLOTS = 10  # of history, which the network of `STEERING` looks back on
PAPER_PREDICTOR = "attention-lstm-paper"  # in place of `STEERING`, which has more parts
# The paper places joints by its weighted DLT, eq. (1)-(3), and no more.
PAPER_FUSION = FusionSettings(refine_steps=0, matcher="epipolar")


class Place(Protocol):
    """Where the loop runs: a recording is one, and so is a live site."""

    @property
    def rig(self) -> Rig:
        """The cameras."""
        ...

    @property
    def skeleton(self) -> Skeleton:
        """Of the detectors."""
        ...

    @property
    def interval_s(self) -> float:
        """Seconds per slot."""
        ...

    @property
    def detector(self) -> str:
        """The detector of the keypoints; empty where nobody named one."""
        ...


def make_pipeline(
    place: Place,
    settings: LoopSettings,
    clock: Callable[[], float] = time.perf_counter,
) -> Pipeline:
    """Build the parts that `settings` ask for: what each is asked for first, then the parts.

    Raises:
        InputError: naming the setting that cannot be had for this place.
    """
    row = row_of(settings)
    settings = settings.for_rig(len(place.rig))
    _check(settings, row, len(place.rig))
    queue = Queue(
        budget=shares(settings, row, len(place.rig)),
        cost_j=None if settings.cost_j is None else np.array(settings.cost_j),
        as_published=_is_paper(settings),
    )
    rests = _rests(place, settings)
    policy, waking = _policy(settings, row, place.rig)
    parts = _paper_parts if _is_paper(settings) and settings.estimator is None else _product_parts
    estimator, predictor, steering = parts(place, settings, row)
    return Pipeline(
        rig=place.rig,
        num_joints=len(place.skeleton),
        interval_s=place.interval_s,
        estimator=estimator,
        predictor=predictor,
        policy=policy,
        queue=queue,
        clock=clock,
        lead_slots=settings.lead_slots,
        warmup_slots=settings.warmup_slots,
        needs=row.needs | {Need.FORESIGHT} if settings.foresees else row.needs,
        steering=steering,
        feedback=Feedback(settings.whole_every) if settings.feedback else None,
        waking=waking,
        rests=rests,
    )


def _rests(place: Place, settings: LoopSettings) -> RestPlanner | None:
    """Return the planner of rests, if any camera may sleep."""
    costs = _rest_costs(place, settings)
    if costs is None:
        return None
    goal = RestGoal(
        watts=settings.watts,
        target_m=settings.target_error_m,
        find_within_s=settings.find_within_s,
        num_selected=float(settings.num_selected or 0),
    )
    return RestPlanner(place.rig, costs, goal)


def _rest_costs(place: Place, settings: LoopSettings) -> RestCosts | None:
    if settings.rest_costs is not None:
        return settings.rest_costs
    usual = EnergySettings().plan(place.rig.camera_ids, place.interval_s)
    return usual.rest_costs(settings.rest)


def least_watts(place: Place, settings: LoopSettings) -> float | None:
    """Return the power of all cameras at rest where `watts` is no more; None where it is."""
    costs = None if settings.watts is None else _rest_costs(place, settings)
    if settings.watts is None or costs is None or settings.watts > costs.rest_w.sum():
        return None
    return float(costs.rest_w.sum())


def watts_warning(place: Place, settings: LoopSettings) -> str:
    """Return a warning where cameras draw `watts` or more even asleep; else empty."""
    least_w = least_watts(place, settings)
    if least_w is None:
        return ""
    cameras = plural(len(place.rig), "camera")
    return (
        f"watts: {settings.watts:g} W is less than the {least_w:.3g} W that {cameras} draw when "
        f"all are {settings.rest}; use more, or a power profile that rests for less"
    )


def warnings_of(place: Place, settings: LoopSettings) -> list[str]:
    """Return the oddities of settings that work."""
    return [
        words for words in (noise_warning(place, settings), watts_warning(place, settings)) if words
    ]


def make_policy(
    place: Place, settings: LoopSettings
) -> tuple[Policy, Callable[[float], Policy] | None]:
    """Return the policy, and its factory for another number of cameras, if it has one.

    Raises:
        InputError: naming the setting that cannot be had.
    """
    row = row_of(settings)
    _check(settings, row, len(place.rig))
    return _policy(settings, row, place.rig)


def row_of(settings: LoopSettings) -> PolicyRow:
    """Look up the row of a policy: factory, needs, promises; an object is used as it is."""
    policy = settings.policy
    if policy is not None and not isinstance(policy, str):
        return PolicyRow.of(policy)
    return policy_row(settings.policy_name, settings.independent_queue)


def _policy(
    settings: LoopSettings, row: PolicyRow, rig: Rig
) -> tuple[Policy, Callable[[float], Policy] | None]:
    asked = PolicySettings(
        num_selected=float(settings.num_selected or 0),
        quality_weight=settings.quality_weight,
        seed=settings.seed,
        phase=settings.phase,
        occlusion_limit=settings.occlusion_limit,
        independent_queue=settings.independent_queue,
        raw_weight=settings.raw_weight,
        round_trip_s=settings.round_trip_s,
        target_error_m=settings.target_error_m,
        order=spread_order(rig),
    )

    def waking(count: float) -> Policy:
        return row.make(replace(asked, num_selected=count))

    policy = row.make(asked)
    check_policy(policy)
    return policy, waking if COUNT in row.uses else None


Parts = tuple[Estimator[Any], Predictor, Predictor | None]


def _product_parts(place: Place, settings: LoopSettings, row: PolicyRow) -> Parts:
    """Return an estimator with a memory, the policy's predictor, and what steers the estimator."""
    for thing, value in _only_paper(settings).items():
        if value is not None and not _is_paper(settings):
            raise InputError(
                thing,
                f"with the pipeline {settings.pipeline}, which matches views to people it follows",
                "the pipeline paper",
            )
    asked = _asked(place, settings, max(settings.warmup_slots, STEERING_SLOTS))
    estimator = settings.estimator
    if estimator is None:
        estimator = estimator_maker(pipeline_row(settings.pipeline)[0])(asked)
    wanted = settings.predictor
    if wanted is None:  # one by default has a stand-in
        return estimator, *make_predictors(row.predictor, STEERING, place.skeleton)
    predictor = make_predictor(wanted, place.skeleton) if isinstance(wanted, str) else wanted
    return estimator, predictor, predictor


def _paper_parts(place: Place, settings: LoopSettings, row: PolicyRow) -> Parts:
    """Return the estimator and the predictor of the published system; nothing is steered."""
    estimator = estimator_maker("paper")(_asked(place, settings, settings.warmup_slots))
    # The policies share one estimator, whichever predictor is their own.
    usual = PAPER_PREDICTOR if row.predictor == STEERING else row.predictor
    wanted = settings.predictor
    if wanted is None:
        return estimator, make_predictor_or_fallback(usual, place.skeleton), None
    predictor = make_predictor(wanted, place.skeleton) if isinstance(wanted, str) else wanted
    return estimator, predictor, None


def _asked(place: Place, settings: LoopSettings, history_slots: int) -> EstimatorSettings:
    aims = settings.target_error_m is not None
    return EstimatorSettings(
        rig=place.rig,
        skeleton=place.skeleton,
        interval_s=place.interval_s,
        history_slots=history_slots,
        fusion=_fusion(settings),
        noise=load_noise(settings.noise or detector_of(place)),
        num_selected=1.0 if aims else float(settings.num_selected or 0),
        fills=settings.fill is not False,
    )


def _is_paper(settings: LoopSettings) -> bool:
    return pipeline_row(settings.pipeline)[0] == "paper"


def _only_paper(settings: LoopSettings) -> dict[str, object]:
    """Return by its key what only the pipeline `paper` can be asked for; None where it is not."""
    return {
        "matcher": settings.matcher,
        "match_distance": settings.match_distance_m,
        "epipolar_px": settings.epipolar_px,
        "fill": settings.fill,
    }


def _fusion(settings: LoopSettings) -> FusionSettings:
    """Return how the pipeline `paper` matches and places; raise `InputError` for what cannot be."""
    matcher = settings.matcher or PAPER_FUSION.matcher
    if matcher not in MATCHERS:
        raise InputError("matcher", repr(matcher)[:60], " or ".join(MATCHERS))
    asked = _only_paper(settings)
    for thing, wanted in (("match_distance", ("rays",)), ("epipolar_px", tuple(EPIPOLAR_PX))):
        if asked[thing] is not None and matcher not in wanted:
            found = f"with the matcher {matcher}"
            raise InputError(thing, found, f"the matcher {' or '.join(wanted)}")
    usual = replace(PAPER_FUSION, reject_outliers=settings.reject_outliers, matcher=matcher)
    if settings.epipolar_px is not None:
        if not 0 < settings.epipolar_px <= MAX_EPIPOLAR_PX:
            found = f"{settings.epipolar_px:g} px"
            raise InputError("epipolar_px", found, f"more than 0 and at most {MAX_EPIPOLAR_PX:g}")
        return replace(usual, max_epipolar_px=settings.epipolar_px)
    distance_m = settings.match_distance_m
    if distance_m is None:
        return usual
    if not 0 < distance_m < usual.cap_m:  # from the cap on, everybody is the same person
        raise InputError(
            "match_distance",
            f"{1000 * distance_m:g} mm",
            f"more than 0 and less than {1000 * usual.cap_m:g} mm",
        )
    return replace(usual, max_distance_m=distance_m)


def noise_warning(place: Place, settings: LoopSettings) -> str:
    """Return a warning where the detector is not stated, or not known; empty if it is."""
    if settings.noise or _is_paper(settings) or detector_of(place) != DEFAULT:
        return ""
    return (
        "no noise model for this detector: starts with OpenPose's, 1.5 times as large, and learns "
        "the noise of each camera; measure one with e3pose calibrate noise RECORDING "
        "--out noise.toml, then use --noise noise.toml, or noise in [loop] of a site"
    )


def _check(settings: LoopSettings, row: PolicyRow, num_cameras: int) -> None:
    if settings.target_error_m is not None and TARGET not in row.uses:
        aiming = ", ".join(name for name, each in POLICIES.items() if TARGET in each.uses)
        found = f"with the policy {settings.policy_name}, which wakes a given number of cameras"
        raise InputError("target_error", found, aiming)
    if settings.rest != AWAKE and not {Need.FORESIGHT} <= row.needs:
        found = f"{settings.rest} with the policy {settings.policy_name}"
        raise InputError("rest", found, "the policy information, which knows who is needed")
    costs = settings.cost_j
    if costs is not None and not (len(costs) == num_cameras and all(0 < c < 1e9 for c in costs)):
        raise InputError("cost", costs, "one above 0 a camera")


def shares(settings: LoopSettings, row: PolicyRow, num_cameras: int) -> NDArray[np.float64]:
    """Return `(num_cameras,)` the share of slots that each camera may be active.

    Args:
        settings: of the loop.
        row: of the policy that decides.
        num_cameras: of the rig.

    Raises:
        InputError: for budgets that do not pay for the cameras that are to be selected.
    """
    counts = Promise.COUNT in row.promises
    share = settings.share(num_cameras)
    budget = np.atleast_1d(np.asarray(1.0 if share is None else share, dtype=np.float64))
    if len(budget) == 1:
        budget = np.full(num_cameras, budget[0])
    if len(budget) != num_cameras:
        raise InputError("budget", f"{len(budget)} shares", f"{num_cameras}, one a camera")
    num_selected = settings.num_selected or 0.0
    asked = settings.budget is not None and counts and settings.target_error_m is None
    if asked and budget.sum() < num_selected - 1e-9:
        found = f"{budget.sum():.3g} cameras per slot in all"
        wanted = f"at least {num_selected:g}, as many as are to be selected"
        if not isinstance(settings.budget, tuple):
            found = f"{budget[0]:g}"
            each = f"{num_selected / num_cameras:g}"
            wanted = f"at least {each} for {num_selected:g} of {num_cameras} cameras per slot"
        raise InputError("budget", found, wanted)
    return budget
