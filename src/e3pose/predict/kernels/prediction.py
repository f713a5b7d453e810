"""A whole prediction: from the history of all people to all joints in the slots to come."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.kernel import kernel
from e3pose.base.kernel_arguments import Held
from e3pose.predict.kernels.history import close_gaps, common_joints, describe
from e3pose.predict.kernels.layers import BLOCK
from e3pose.predict.kernels.network import Weights, run_network
from e3pose.predict.kernels.tracks import Curves, Joints, place_tracks


class Parts(NamedTuple):
    """The constants of a network and a skeleton."""

    weights: Weights
    joints: Joints
    curves: Curves


@kernel
def predict_tracks(
    parts: Held[Parts],
    history_slots: int,
    interval_s: float,
    most_leads: int,
    history_m: Floats,
    joints_m: Floats,
    error_m: Floats,
) -> None:
    """Fill what `AttentionLstm.predict` returns: describe people, run the network, place them.

    Args:
        parts: what is constant.
        history_slots: that the network takes.
        interval_s: seconds per slot.
        most_leads: that the network is run for; later ones repeat the last of these.
        history_m: `(num_slots, num_tracks, num_joints, 3)` metres, oldest first, NaN where missing;
            at most `history_slots`, and slots before it count as missing.
        joints_m: `(num_leads, num_tracks, num_joints, 3)` metres, filled.
        error_m: `(num_leads, num_tracks, num_joints)` metres, filled.
    """
    weights, joints, curves = parts.values.weights, parts.values.joints, parts.values.curves
    num_common, num_leads, num_tracks = len(joints.columns), len(joints_m), joints_m.shape[1]
    common_m = np.full((history_slots, num_tracks, num_common, 3), np.nan)
    before = history_slots - len(history_m)
    for slot in range(len(history_m)):
        common_joints(history_m[slot], joints.columns, common_m[before + slot])
    filled_m, measured = np.empty_like(common_m), np.empty(common_m.shape[:3], np.bool_)
    close_gaps(common_m, filled_m, measured)
    rows = _whole_blocks(num_tracks)
    features = np.zeros((history_slots, rows, weights.attention.shape[0]), np.float32)
    context = np.zeros((rows, weights.entry_context.shape[0]), np.float32)
    centre_m, heading = np.empty((num_tracks, 3)), np.empty((num_tracks, 2))
    speed_m, seen = np.empty(num_tracks), np.empty((num_tracks, num_common), np.bool_)
    describe(
        filled_m,
        measured,
        np.full(num_tracks, interval_s),
        joints.sides,
        features,
        context,
        centre_m,
        heading,
        speed_m,
        seen,
    )
    used_leads = min(num_leads, most_leads)
    places = np.empty((used_leads, rows, 3 * num_common), np.float32)
    log_error = np.empty((used_leads, rows, num_common), np.float32)
    run_network(weights, features, context, places, log_error)
    place_tracks(
        places,
        log_error,
        centre_m,
        heading,
        seen,
        filled_m[-1],
        history_m,
        joints,
        curves,
        joints_m,
        error_m,
    )


@kernel
def _whole_blocks(num_tracks: int) -> int:
    """Return for how many people to run the network: for nobody too, where that is quicker.

    A block of four takes as long as two by themselves (`layers.add_product`).
    """
    alone = num_tracks % BLOCK
    return num_tracks + BLOCK - alone if alone > 1 else num_tracks
