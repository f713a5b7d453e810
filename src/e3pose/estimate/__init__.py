"""Estimators: the views of a slot -> the people in it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from e3pose.base.plugins import maker
from e3pose.estimate.base import Estimate as Estimate
from e3pose.estimate.base import Estimator as Estimator
from e3pose.estimate.base import Outlook as Outlook
from e3pose.estimate.filter import Model, Noise, wait_s
from e3pose.estimate.filter.estimator import Filtered
from e3pose.estimate.filter.step import StepKernel
from e3pose.estimate.per_slot.estimator import PerSlot
from e3pose.estimate.per_slot.fuse import Fuser
from e3pose.estimate.per_slot.fusion import FusionSettings
from e3pose.model.camera import Rig
from e3pose.model.skeleton import Skeleton


@dataclass(frozen=True, slots=True, eq=False)
class EstimatorSettings:
    """Rig, skeleton, interval and noise that an estimator is made for.

    Attributes:
        rig: the cameras.
        skeleton: of the detectors.
        interval_s: seconds per slot.
        history_slots: how much of the past the predictor is given.
        fusion: of the estimator without a memory.
        noise: of the detector's keypoints.
        num_selected: cameras per slot, a mean if it is no whole number; how long the estimator
            with a memory waits for a second view of somebody new follows from it.
        fills: whether the estimator without a memory fills joints that a slot lacks.
    """

    rig: Rig
    skeleton: Skeleton
    interval_s: float
    history_slots: int
    fusion: FusionSettings
    noise: Noise
    num_selected: float = 1.0
    fills: bool = True


def _per_slot(settings: EstimatorSettings) -> PerSlot:
    fuser = Fuser(settings.rig, len(settings.skeleton), settings.fusion)
    return PerSlot(
        fuser,
        len(settings.skeleton),
        settings.interval_s,
        settings.noise,
        settings.history_slots,
        settings.fills,
    )


def _filtered(settings: EstimatorSettings) -> Filtered:
    waiting_s = wait_s(settings.interval_s, settings.num_selected)
    model = Model(settings.rig, settings.skeleton, settings.noise, waiting_s)
    return Filtered(model, StepKernel(), settings.history_slots)


GROUP = "e3pose.estimators"  # the entry points of other packages
ESTIMATORS: dict[str, Callable[[EstimatorSettings], Estimator[Any]]] = {
    "paper": _per_slot,
    "memory": _filtered,
}


def estimator_maker(name: str) -> Callable[[EstimatorSettings], Estimator[Any]]:
    """Return the factory of the pipeline `name`'s estimator.

    Raises:
        InputError: listing the known ones.
    """
    return maker(GROUP, "pipeline", name, ESTIMATORS)
