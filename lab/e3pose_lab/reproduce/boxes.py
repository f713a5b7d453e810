"""IoU of predicted boxes of people with boxes detected some slots later."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import linear_sum_assignment

from e3pose.base.arrays import Floats
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.skeleton import COCO17
from e3pose.predict import make_predictor
from e3pose.predict.base import Prediction, Predictor
from e3pose.recording import Recording
from e3pose.select.occlusion import box_iou, person_boxes
from e3pose_lab.reproduce.replays import Asked, recording_of
from e3pose_lab.reproduce.sources import Sources

CALLS = 100  # of a predictor that is timed
INTERVAL_S = 0.04  # as on Shelf


@dataclass(frozen=True, slots=True)
class BoxesAsked:
    """Which predictor, how far ahead.

    Attributes:
        recording: of `replays.Asked`.
        predictor: its name.
        leads: slots ahead.
        seconds: length of what is simulated.
        seed: of what is simulated.
    """

    recording: str
    predictor: str
    leads: tuple[int, ...]
    seconds: float = 0.0
    seed: int = 0


@dataclass(frozen=True, slots=True)
class BoxFigures:
    """By lead.

    Attributes:
        iou: mean over pairs of a predicted and a detected box that overlap.
        paired: share of the detected boxes that have such a partner.
    """

    iou: tuple[float, ...]
    paired: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class TimesAsked:
    """Which predictor to time, how far ahead, and for how many people."""

    predictor: str
    leads: tuple[int, ...]
    people: int = 4


class _Watched:
    """A predictor whose predictions are kept, in the order of the slots."""

    def __init__(self, predictor: Predictor) -> None:
        self.predictor = predictor
        self.made: list[Floats] = []

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        prediction = self.predictor.predict(history_m, interval_s, lead_slots)
        self.made.append(prediction.joints_m)
        return prediction


def box_figures(sources: Sources, asked: BoxesAsked) -> BoxFigures:
    """Predict from the poses of all cameras and compare with what the detectors then find."""
    recording = recording_of(
        sources, Asked(asked.recording, "all", seconds=asked.seconds, seed=asked.seed)
    )
    watched = _Watched(make_predictor(asked.predictor, recording.skeleton))
    settings = ReplaySettings(pipeline="paper", policy="all", lead_slots=max(asked.leads))
    for _ in replay(recording, settings, predictor=watched):
        pass
    found = [_compared(recording, watched.made, lead) for lead in asked.leads]
    return BoxFigures(tuple(iou for iou, _ in found), tuple(share for _, share in found))


def prediction_ms(sources: Sources, asked: TimesAsked) -> list[float]:
    """Return the median milliseconds of a prediction, by lead."""
    predictor = make_predictor(asked.predictor, COCO17)
    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.normal(0, 0.01, (10, asked.people, 1, 3)), axis=0)
    history_m = walk + rng.normal(0, 0.4, (1, asked.people, len(COCO17), 3))
    return [
        _median_ms(partial(predictor.predict, history_m, INTERVAL_S, lead)) for lead in asked.leads
    ]


def _median_ms(call: Callable[[], object]) -> float:
    call()
    taken = []
    for _ in range(CALLS):
        begun = time.perf_counter()
        call()
        taken.append(time.perf_counter() - begun)
    return float(1000 * np.median(taken))


def _compared(recording: Recording, made: list[Floats], lead: int) -> tuple[float, float]:
    """Return the mean IoU of pairs that overlap, and the share of detected boxes in a pair."""
    overlaps: list[float] = []
    boxes = 0
    for slot, prediction in enumerate(made[: recording.num_slots - lead]):
        pixels = recording.rig.project(prediction[lead - 1])
        for index, camera in enumerate(recording.rig.cameras):
            view = recording.view(slot + lead, index)
            if view is None or len(view) == 0:
                continue
            expected = person_boxes(pixels[index], camera.image_size)
            seen = person_boxes(view.keypoints_px, camera.image_size)
            iou = box_iou(expected[:, None], seen[None])
            rows, columns = linear_sum_assignment(iou, maximize=True)
            pairs = iou[rows, columns]
            overlaps += pairs[pairs > 0].tolist()
            boxes += len(seen)
    return float(np.mean(overlaps)) if overlaps else 0.0, len(overlaps) / max(boxes, 1)
