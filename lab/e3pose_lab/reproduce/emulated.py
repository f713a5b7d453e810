"""Emulated parts of a site with given latencies, for measuring its frame rate."""

from __future__ import annotations

import time
from dataclasses import dataclass

from e3pose.base.arrays import Floats
from e3pose.detectors.base import Image
from e3pose.detectors.drawn import Drawn
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton
from e3pose.predict.attention_lstm import PUBLISHED, AttentionLstm
from e3pose.predict.base import Prediction, Predictor

DETECT_S = 0.020
SERVER_S = 0.030


class SlowDetector(Drawn):
    """Finds drawn people, and takes `DETECT_S` in all."""

    def detect(self, image: Image) -> Poses2D:
        """See `Detector.detect`."""
        end_s = time.monotonic() + DETECT_S
        found = super().detect(image)
        time.sleep(max(0.0, end_s - time.monotonic()))
        return found


@dataclass(frozen=True, slots=True)
class SlowPredictor:
    """Stands for a server that takes `SERVER_S` longer."""

    predictor: Predictor

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        time.sleep(SERVER_S)
        return self.predictor.predict(history_m, interval_s, lead_slots)


def slow_published(skeleton: Skeleton) -> Predictor:
    """Return the paper's predictor on a server that takes `SERVER_S` longer."""
    return SlowPredictor(AttentionLstm(skeleton, PUBLISHED))
