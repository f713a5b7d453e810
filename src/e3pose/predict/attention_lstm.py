"""The paper's attention-LSTM predictor (section 3.2.1), run by ONNX Runtime on one thread."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.errors import InputError
from e3pose.files.bounded import read_bytes
from e3pose.model.skeleton import Skeleton
from e3pose.predict.base import Prediction
from e3pose.predict.calibration import Calibration
from e3pose.predict.normalise import (
    COMMON_JOINTS,
    NUM_COMMON,
    Normalised,
    common_columns,
    fill_gaps,
    normalise,
    to_common,
    to_world,
)

Floats = NDArray[np.float64]

SHIPPED = Path(__file__).parent / "weights" / "attention-lstm.onnx"
FORMAT = "e3pose attention-lstm"
FORMAT_VERSION = "2"
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
        self.session, properties = _load(weights)
        self.history_slots = int(properties["history_slots"])
        self.calibration = Calibration(properties)
        self.num_joints = len(skeleton)
        self.columns = common_columns(skeleton)
        if not any(self.columns):
            raise InputError(
                f"{weights}: skeleton: found {skeleton.name}, "
                f"expected one with any of {', '.join(COMMON_JOINTS)}"
            )
        direct = [(i, chosen[0]) for i, chosen in enumerate(self.columns) if len(chosen) == 1]
        self.from_common = [common for common, _ in direct]
        self.to_joints = [joint for _, joint in direct]
        self.carried = [j for j in range(self.num_joints) if j not in set(self.to_joints)]

    def predict(self, history_m: Floats, interval_s: float, lead_slots: int) -> Prediction:
        """See `Predictor.predict`."""
        num_tracks = history_m.shape[1]
        joints = np.empty((lead_slots, num_tracks, self.num_joints, 3))
        error = np.empty((lead_slots, num_tracks, self.num_joints))
        for start in range(0, num_tracks, BATCH_TRACKS):
            some = slice(start, start + BATCH_TRACKS)
            self._predict(history_m[:, some], interval_s, joints[:, some], error[:, some])
        return Prediction(joints, error)

    def _predict(
        self, history_m: Floats, interval_s: float, joints_m: Floats, error_m: Floats
    ) -> None:
        """Fill `joints_m` and `error_m` with the prediction of some tracks."""
        history_m = history_m[-self.history_slots :]
        common = to_common(history_m, self.columns)
        normal = normalise(common, interval_s, self.history_slots)
        leads = min(len(joints_m), MAX_LEADS)
        places, log_error = _run(self.session, normal, leads)
        axes_last = places.reshape(leads, -1, 3, NUM_COMMON).swapaxes(-1, -2)
        world = to_world(normal, axes_last.astype(np.float64))
        expected = self.calibration(log_error)
        unseen = ~normal.seen
        world[:, unseen], expected[:, unseen] = np.nan, np.nan
        joints_m[:leads, :, self.to_joints] = world[:, :, self.from_common]
        error_m[:leads, :, self.to_joints] = expected[:, :, self.from_common]
        if self.carried:
            self._carry(normal, history_m[:, :, self.carried], world, expected, joints_m, error_m)
        joints_m[leads:], error_m[leads:] = joints_m[leads - 1], error_m[leads - 1]

    def _carry(
        self,
        normal: Normalised,
        others_m: Floats,
        world_m: Floats,
        expected_m: Floats,
        joints_m: Floats,
        error_m: Floats,
    ) -> None:
        """Move every other joint as the common joint moves that is nearest to it now."""
        filled, measured = fill_gaps(others_m)
        newest = filled[-1]
        apart = np.square(newest[:, :, None] - normal.newest_m[:, None]).sum(axis=-1)
        apart[~np.broadcast_to(normal.seen[:, None], apart.shape)] = np.inf
        nearest = apart.argmin(axis=-1)
        row = np.arange(len(nearest))[:, None]
        leads = len(world_m)
        moved = world_m[:, row, nearest] + (newest - normal.newest_m[row, nearest])
        known = normal.seen.any(axis=1)
        moved[:, ~known] = newest[~known]
        never = ~measured.any(axis=0)
        moved[:, never] = np.nan
        error = expected_m[:, row, nearest]
        error[:, never] = np.nan
        joints_m[:leads, :, self.carried] = moved
        error_m[:leads, :, self.carried] = error


def _load(weights: Path) -> tuple[Any, dict[str, str]]:
    """Return a session of the network in `weights` and its properties, or raise `InputError`."""
    import onnxruntime as ort

    content = read_bytes(weights, MAX_WEIGHTS_BYTES)
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        properties = dict(session.get_modelmeta().custom_metadata_map)
    except Exception as error:  # ONNX Runtime raises its own kinds, none of them public
        raise InputError(f"{weights}: found no readable network, expected ONNX") from error
    _check(weights, session, properties)
    return session, properties


def _check(weights: Path, session: Any, properties: dict[str, str]) -> None:
    for key, wanted in (
        ("format", FORMAT),
        ("version", FORMAT_VERSION),
        ("joints", " ".join(COMMON_JOINTS)),
    ):
        if properties.get(key) != wanted:
            found = properties.get(key, "nothing")[:200]
            raise InputError(f"{weights}: {key}: found {found}, expected {wanted}")
    slots = properties.get("history_slots", "nothing")
    shape = {item.name: item.shape for item in session.get_inputs()}.get("features", [None])
    if not (slots.isdecimal() and 3 <= int(slots) <= MAX_HISTORY_SLOTS and shape[0] == int(slots)):
        raise InputError(
            f"{weights}: history_slots: found {slots[:20]}, expected the {shape[0]} of the network"
        )
    for key in ("error_factor", "error_curve"):
        try:
            Calibration({"error_factor": "[1.0]", key: properties.get(key, "null")})
        except (ValueError, TypeError) as error:
            raise InputError(f"{weights}: {key}: {error}") from error
    nobody_moves = normalise(np.zeros((int(slots), 1, NUM_COMMON, 3)), 1.0, int(slots))
    try:
        outputs = _run(session, nobody_moves, 2)
    except Exception as error:
        raise InputError(f"{weights}: network: does not run, expected one of e3pose") from error
    shapes = [output.shape for output in outputs]
    if shapes != [(2, 1, 3 * NUM_COMMON), (2, 1, NUM_COMMON)]:
        raise InputError(f"{weights}: network: found outputs of shapes {shapes}")


def _run(session: Any, normal: Normalised, leads: int) -> list[NDArray[np.float32]]:
    """Return places and logarithms of expected errors, shaped as `learn.train.export` says."""
    inputs = {
        "features": normal.features,
        "context": normal.context,
        "num_leads": np.array([leads]),
    }
    outputs: list[NDArray[np.float32]] = session.run(["places", "log_error"], inputs)
    return outputs
