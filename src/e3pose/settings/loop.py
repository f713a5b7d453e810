"""What to run on a recording, and the parts that it takes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from e3pose.energy.queues import check_budget
from e3pose.errors import InputError
from e3pose.estimate import EstimatorSettings, make_estimator
from e3pose.estimate.per_slot.fuse import FusionSettings
from e3pose.evaluate.bad_days import NO_BAD_DAY, BadDay
from e3pose.geometry.camera import Rig
from e3pose.model.noises import DEFAULT, detector_of, load_noise
from e3pose.model.skeleton import Skeleton
from e3pose.pipeline import Pipeline
from e3pose.predict import Predictor, make_predictor, make_predictor_or_fallback
from e3pose.select.camera_order import spread_order
from e3pose.select.policies import POLICIES, PolicyRow, PolicySettings, policy_row

PAPER_REFINE_STEPS = 0  # the paper places joints by its weighted DLT, eq. (1)-(3), and no more
BUDGET_MARGIN = 0.2  # of the default budget above C/N: the paper's 0.8 for 3 of 5 cameras
# The names that users give: what estimates, and who decides unless they say otherwise.
PIPELINES = {
    "default": ("memory", "information"),
    "memory": ("memory", "information"),
    "paper": ("paper", "e3pose"),
}
STEERING = "attention-lstm"  # steers the estimator with a memory unless told otherwise
STEERING_SLOTS = 10  # of history, which the network of `STEERING` looks back on
MAX_LEAD = 1000
MAX_TARGET_M = 1.0
MAX_SEED = 2**31 - 1


@dataclass(frozen=True, slots=True)
class ReplaySettings:
    """How to run a recording.

    Attributes:
        pipeline: a name of `PIPELINES`: `paper` has no memory, `memory` a filter per person, and
            `default` is `memory`.
        policy: a name of `POLICIES`; the pipeline's own by default.
        num_selected: the paper's C; a mean if it is no whole number.
        target_error_m: wake the fewest cameras whose expected error meets this instead.
        budget: the paper's E_n, the share of slots a camera may be active, one for all or one for
            each; C/N + 0.2 by default, and without a limit with a target.
        quality_weight: the paper's V; the policy's own by default.
        lead_slots: the paper's tau.
        warmup_slots: the paper's M, in which all cameras detect.
        predictor: a name of `PREDICTORS`, which foresees the people for the policy and, where it
            states its errors, steers the estimator with a memory. By default the policy's own does
            the one and `STEERING` the other.
        match_distance_m: mean distance of rays up to which two views show one person, for the
            pipeline `paper` alone; that of `FusionSettings` by default.
        reject_outliers: drop views that disagree with the others.
        seed: of random choices.
        phase: offset of turns and ties.
        occlusion_limit: threshold of `independent`.
        round_trip_s: network and server delay that `central-2d` waits for.
        foresees: work out what each camera is expected to tell even if the policy does not ask.
        cost_j: energy of an active slot beyond that of an idle one, of each camera; all alike by
            default, and only the proportions matter.
        bad_day: cameras that die and views that are lost.
        noise: of the detector's keypoints, a name or file for `load_noise`; by default that of the
            detector which the recording names.
    """

    pipeline: str = "default"
    policy: str | None = None
    num_selected: float = 3
    target_error_m: float | None = None
    budget: float | tuple[float, ...] | None = None
    quality_weight: float | None = None
    lead_slots: int = 1
    warmup_slots: int = 10
    predictor: str | None = None
    match_distance_m: float | None = None
    reject_outliers: bool = False
    seed: int = 0
    phase: int = 0
    occlusion_limit: float = 0.1
    round_trip_s: float = 0.05
    foresees: bool = False
    cost_j: tuple[float, ...] | None = None
    bad_day: BadDay = NO_BAD_DAY
    noise: str | None = None

    @property
    def policy_name(self) -> str:
        """The policy that decides."""
        return pipeline_row(self.pipeline)[1] if self.policy is None else self.policy


def pipeline_row(name: str) -> tuple[str, str]:
    """Return the estimator and the policy of a pipeline; raise `InputError` listing the known."""
    if name not in PIPELINES:
        raise InputError(
            f"pipeline {name[:40]!r} is unknown, expected one of {', '.join(PIPELINES)}"
        )
    return PIPELINES[name]


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
        """Seconds a slot."""
        ...

    @property
    def detector(self) -> str:
        """What finds the keypoints; empty where nobody said."""
        ...

    @property
    def source(self) -> str:
        """Where the keypoints come from, in words."""
        ...


def make_pipeline(
    place: Place,
    settings: ReplaySettings,
    clock: Callable[[], float] = time.perf_counter,
) -> Pipeline:
    """Build the parts that `settings` ask for.

    Raises:
        InputError: naming the option that cannot be had for this place.
    """
    row = policy_row(settings.policy_name)
    _check(settings, row, len(place.rig))
    predictor, steering = _predictors(settings, row, place.skeleton)
    estimator = make_estimator(
        pipeline_row(settings.pipeline)[0],
        EstimatorSettings(
            rig=place.rig,
            skeleton=place.skeleton,
            interval_s=place.interval_s,
            history_slots=max(settings.warmup_slots, STEERING_SLOTS if steering else 0),
            fusion=_fusion(settings),
            noise=load_noise(settings.noise or detector_of(place)),
            num_selected=1.0 if settings.target_error_m is not None else settings.num_selected,
        ),
    )
    policy = row.make(
        PolicySettings(
            num_selected=settings.num_selected,
            quality_weight=settings.quality_weight,
            seed=settings.seed,
            phase=settings.phase,
            occlusion_limit=settings.occlusion_limit,
            round_trip_s=settings.round_trip_s,
            target_error_m=settings.target_error_m,
            order=spread_order(place.rig),
        )
    )
    return Pipeline(
        rig=place.rig,
        num_joints=len(place.skeleton),
        interval_s=place.interval_s,
        estimator=estimator,
        predictor=predictor,
        policy=policy,
        budget=_budget(settings, len(place.rig), row.counts),
        cost_j=None if settings.cost_j is None else np.array(settings.cost_j),
        clock=clock,
        lead_slots=settings.lead_slots,
        warmup_slots=settings.warmup_slots,
        holds=row.holds,
        foresees=row.foresees or settings.foresees,
        own_boxes=row.own_boxes,
        steering=steering,
    )


def _predictors(
    settings: ReplaySettings, row: PolicyRow, skeleton: Skeleton
) -> tuple[Predictor, Predictor | None]:
    """Return who foresees the people for the policy and who steers the estimator.

    A predictor that was asked for must be had; one by default has a stand-in, which steers nobody.
    The policies of a pipeline share one estimator, whichever predictor is their own.
    """
    remembers = pipeline_row(settings.pipeline)[0] == "memory"
    if settings.predictor is not None:
        asked = make_predictor(settings.predictor, skeleton)
        return asked, asked if remembers else None
    own = make_predictor_or_fallback(row.predictor, skeleton)
    if not remembers:
        return own, None
    same = row.predictor == STEERING
    return own, own if same else make_predictor_or_fallback(STEERING, skeleton)


def _fusion(settings: ReplaySettings) -> FusionSettings:
    """Return how the pipeline `paper` matches and places; raise `InputError` for another's."""
    usual = FusionSettings(
        refine_steps=PAPER_REFINE_STEPS, reject_outliers=settings.reject_outliers
    )
    distance_m = settings.match_distance_m
    if distance_m is None:
        return usual
    if pipeline_row(settings.pipeline)[0] != "paper":
        raise InputError(
            f"match distance: the pipeline {settings.pipeline} matches views to the people it "
            "follows, expected paper"
        )
    if not 0 < distance_m < usual.cap_m:  # from the cap on, everybody is the same person
        raise InputError(
            f"match distance: {1000 * distance_m:g} mm, expected more than 0 and less than "
            f"{1000 * usual.cap_m:g} mm"
        )
    return replace(usual, max_distance_m=distance_m)


def noise_warning(place: Place, settings: ReplaySettings) -> str:
    """Return what to say where the detector is not stated, or not known; empty if it is."""
    if settings.noise or pipeline_row(settings.pipeline)[0] == "paper":
        return ""
    name = detector_of(place)
    if name != DEFAULT and place.detector:
        return ""
    if name != DEFAULT:
        return (
            f"the recording names its detector in words only: {name} is assumed; write "
            f'version = 3 and detector = "{name}" into its recording.toml, or use --noise'
        )
    return (
        "no noise file is known for this detector: OpenPose's, half as large again, is assumed "
        "at first, and what each camera's keypoints are like is learned; --noise names a file"
    )


def _check(settings: ReplaySettings, row: PolicyRow, num_cameras: int) -> None:
    if not 0 < settings.num_selected <= num_cameras:
        raise InputError(
            f"cameras: asked for {settings.num_selected:g} a slot, "
            f"expected more than 0 and at most the rig's {num_cameras}"
        )
    if not 1 <= settings.lead_slots <= MAX_LEAD:
        raise InputError(f"lead: {settings.lead_slots} slots, expected 1 to {MAX_LEAD}")
    if not 0 <= settings.warmup_slots <= MAX_LEAD:
        raise InputError(f"warmup: {settings.warmup_slots} slots, expected 0 to {MAX_LEAD}")
    for name, value in (
        ("quality weight", settings.quality_weight),
        ("occlusion limit", settings.occlusion_limit),
        ("round trip", settings.round_trip_s),
    ):
        if value is not None and not (np.isfinite(value) and value >= 0):
            raise InputError(f"{name}: {value}, expected a number of at least 0")
    for name, value in (("seed", settings.seed), ("phase", settings.phase)):
        if not 0 <= value <= MAX_SEED:
            raise InputError(f"{name}: {value}, expected 0 to {MAX_SEED}")
    target_m = settings.target_error_m
    if target_m is not None and not row.aims:
        aiming = ", ".join(name for name, each in POLICIES.items() if each.aims)
        raise InputError(
            f"target error: the policy {settings.policy_name} wakes a given number of cameras, "
            f"expected {aiming}"
        )
    if target_m is not None and not 0 < target_m <= MAX_TARGET_M:
        raise InputError(f"target error: {1000 * target_m:g} mm, expected 1 mm to 1 m")
    costs = settings.cost_j
    if costs is not None and not (len(costs) == num_cameras and all(0 < c < 1e9 for c in costs)):
        raise InputError(f"cost: found {costs}, expected one above 0 a camera")


def default_budget(num_selected: float, num_cameras: int) -> float:
    """Return the paper's E_n for those who name none: a margin above C/N, at most every slot."""
    return min(1.0, num_selected / num_cameras + BUDGET_MARGIN)


def _budget(settings: ReplaySettings, num_cameras: int, counts: bool) -> NDArray[np.float64]:
    """Return `(num_cameras,)` the share of slots that each camera may be active."""
    if settings.budget is None:
        if settings.target_error_m is not None:
            return np.ones(num_cameras)
        return np.full(num_cameras, default_budget(settings.num_selected, num_cameras))
    budget = np.atleast_1d(np.asarray(settings.budget, dtype=np.float64))
    for share in budget:
        if not 0 < share <= 1:
            raise InputError(f"budget: {share:g}, expected a share of the slots in (0, 1]")
    if len(budget) == 1:
        budget = np.full(num_cameras, budget[0])
    if len(budget) != num_cameras:
        raise InputError(
            f"budget: found {len(budget)} shares, expected {num_cameras}, one a camera"
        )
    if counts and settings.target_error_m is None:
        if isinstance(settings.budget, float | int):
            check_budget(budget, settings.num_selected)
        elif budget.sum() < settings.num_selected - 1e-9:
            raise InputError(
                f"budget: found {budget.sum():.3g} cameras a slot in all, expected at least "
                f"{settings.num_selected:g}, as many as are to be selected"
            )
    return budget
