"""The paper's attention-LSTM predictor (section 3.2.1), run by own kernels on one thread."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError
from e3pose.base.kernel_arguments import Held
from e3pose.model.skeleton import Skeleton
from e3pose.predict.base import Prediction
from e3pose.predict.kernels.tracks import Curves, Joints
from e3pose.predict.normalise import COMMON_JOINTS, LEFT_RIGHT, common_columns

if TYPE_CHECKING:
    from e3pose.predict.kernels.network import Weights
    from e3pose.predict.kernels.prediction import Parts
    from e3pose.predict.weights_file import WeightsFile


MAX_LENGTH = 10_000  # characters of a property: tens of leads, ten points each
MAX_LOG = 20.0


def read_curves(properties: Mapping[str, str]) -> Curves:
    """Return rising curves per lead, and factors per lead, that expected errors are bent by.

    Between the points of a curve, logarithms are linear; beyond them the nearest point's ratio
    holds. The last lead's curve and factor serve all later leads.

    Args:
        properties: `error_factor` and, optionally, `error_curve`, both JSON.

    Raises:
        ValueError: when one is not what `e3pose_lab.train.export` writes.
    """
    factor = _numbers(properties["error_factor"])
    if factor.ndim != 1 or not len(factor) or not (factor > 0).all():
        raise ValueError("expected a list of positive numbers")
    curve = _numbers(properties.get("error_curve", "null"), [[[0.0, 1.0]], [[0.0, 1.0]]])
    if curve.ndim != 3 or len(curve) != 2 or not curve.shape[1] or curve.shape[2] < 2:
        raise ValueError("expected two lists of points per lead")
    rises = np.diff(curve, axis=-1)
    if not (rises[0] > 0).all() or not (rises[1] >= 0).all() or np.abs(curve).max() > MAX_LOG:
        raise ValueError("expected rising points")
    return Curves(curve[0], curve[1], rises[1] / rises[0], np.log(factor))


def _numbers(text: str, default: object = None) -> Floats:
    """Return finite numbers in JSON as an array, `default` for null."""
    if len(text) > MAX_LENGTH:
        raise ValueError("expected fewer numbers")
    content = json.loads(text)
    try:
        numbers = np.array(default if content is None else content, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError("expected numbers") from error
    if not np.isfinite(numbers).all():
        raise ValueError("expected finite numbers")
    return numbers


SHIPPED = Path(__file__).parent / "weights" / "attention-lstm.onnx"
PUBLISHED = SHIPPED.with_name("attention-lstm-paper.onnx")  # the paper's own network
FORMAT = "e3pose attention-lstm"
FORMAT_VERSION = "2"
INPUTS, OUTPUTS = ("features", "context", "num_leads"), ("places", "log_error")
MAX_WEIGHTS_BYTES = 64 * 2**20
MAX_HISTORY_SLOTS = 1000
MAX_LEADS = 60  # later slots repeat the last of these: nothing is known of them any more
BATCH_TRACKS = 512  # more people than this are predicted in turns, in bounded memory


class AttentionLstm:
    """Predict common joints with the network; carry all others rigidly with the nearest of them.

    People with no common joint in their history stay where they are. A joint that the history
    never shows is NaN, as is its error.
    """

    def __init__(self, skeleton: Skeleton, weights: Path = SHIPPED) -> None:
        from e3pose.predict.kernels.prediction import Parts, predict_tracks

        self.weights, self.curves, self.history_slots, self.states_error = _load(weights)
        self.num_joints = len(skeleton)
        columns = common_columns(skeleton)
        if not (columns >= 0).any():
            raise InputError(
                f"{weights}: skeleton: found {skeleton.name}, "
                f"expected one with any of {', '.join(COMMON_JOINTS)}"
            )
        direct = np.where((columns >= 0).sum(axis=1) == 1, columns[:, 0], -1)
        carried = np.setdiff1d(np.arange(self.num_joints), direct)
        self.columns = columns
        self.joints = Joints(
            self.columns,
            direct,
            carried,
            np.array(LEFT_RIGHT, dtype=np.int64),
        )
        self._parts = Parts(self.weights, self.joints, self.curves)
        self._held: Held[Parts] | None = None  # made with the first prediction: it loads kernels
        self._run = predict_tracks

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        history_m = history_m[-self.history_slots :]
        num_tracks = history_m.shape[1]
        if num_tracks <= BATCH_TRACKS:
            return self._predict(history_m, interval_s, lead_slots)
        parts = [
            self._predict(history_m[:, start : start + BATCH_TRACKS], interval_s, lead_slots)
            for start in range(0, num_tracks, BATCH_TRACKS)
        ]
        return Prediction(
            np.concatenate([part.joints_m for part in parts], axis=1),
            np.concatenate([part.error_m for part in parts], axis=1),
        )

    def _predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """Return the prediction of some tracks."""
        if self._held is None:
            self._held = Held(self._parts)
        shape = lead_slots, history_m.shape[1], self.num_joints
        joints_m, error_m = np.empty((*shape, 3)), np.empty(shape)
        self._run(
            self._held,
            self.history_slots,
            float(interval_s),
            MAX_LEADS,
            np.ascontiguousarray(history_m, dtype=np.float64),
            joints_m,
            error_m,
        )
        if not self.states_error:
            error_m[:] = np.nan
        return Prediction(joints_m, error_m)


def _load(path: Path) -> tuple[Weights, Curves, int, bool]:
    """Return weights, calibration and slots of history of a network, and if it states errors.

    Raises:
        InputError: for a file that is missing, damaged, or of another kind.
    """
    from e3pose.predict.weights_file import (
        history_slots,
        is_published,
        network_weights,
        read_file,
    )

    content = read_bytes(path, MAX_WEIGHTS_BYTES)
    try:
        file = read_file(content)
    except InputError as error:
        raise error.at(path) from None
    except (ValueError, KeyError) as error:
        raise InputError(f"{path}: found no readable network, expected ONNX") from error
    _check(path, file)
    curves = _curves(path, file.properties)
    try:
        weights = network_weights(file)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: network: expected one of e3pose, found {error}") from error
    return weights, curves, history_slots(file), not is_published(file)


def _check(path: Path, file: WeightsFile) -> None:
    """Raise `InputError` for a network of another kind."""
    from e3pose.predict.weights_file import history_slots

    properties = file.properties
    for key, wanted in (
        ("format", FORMAT),
        ("version", FORMAT_VERSION),
        ("joints", " ".join(COMMON_JOINTS)),
    ):
        if properties.get(key) != wanted:
            found = properties.get(key, "nothing")[:200]
            raise InputError(f"{path}: {key}: found {found}, expected {wanted}")
    slots, own = properties.get("history_slots", "nothing"), history_slots(file)
    if slots != str(own) or not 3 <= own <= MAX_HISTORY_SLOTS:
        raise InputError(
            f"{path}: history_slots: found {slots[:20]}, expected the {own} of the network"
        )
    if (file.inputs, file.outputs) != (INPUTS, OUTPUTS):
        found = ", ".join((*file.inputs, *file.outputs))[:200]
        wanted_names = ", ".join((*INPUTS, *OUTPUTS))
        raise InputError(f"{path}: network: found {found}, expected {wanted_names}")


def _curves(path: Path, properties: dict[str, str]) -> Curves:
    for key in ("error_factor", "error_curve"):
        try:
            read_curves({"error_factor": "[1.0]", key: properties.get(key, "null")})
        except (ValueError, TypeError) as error:
            raise InputError(f"{path}: {key}: {error}") from error
    return read_curves(properties)
