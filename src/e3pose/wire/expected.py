"""Semantic feedback as fields of an order."""

from __future__ import annotations

import numpy as np

from e3pose.model.expected import ExpectedView
from e3pose.wire.arrays import pack, unpack
from e3pose.wire.messages import Array, Order
from e3pose.wire.validation import MAX_EXPECTED, MAX_PIXEL


def packed_expected(view: ExpectedView | None) -> tuple[Array | None, Array | None]:
    """Return an expected view as fields of an order; None of each for no people or a crowd."""
    if view is None or not 0 < len(view) <= MAX_EXPECTED:
        return None, None
    with np.errstate(invalid="ignore"):
        near = (np.abs(view.keypoints_px) <= MAX_PIXEL).all(axis=-1, keepdims=True)
    keypoints_px = np.where(near, view.keypoints_px, np.nan).astype(np.float32)
    reach_px = np.minimum(view.reach_px, MAX_PIXEL).astype(np.float32)
    return pack(keypoints_px), pack(reach_px)


def expected_view(order: Order) -> ExpectedView | None:
    """Return the expected view of an order; None for full-frame detection."""
    if order.expected_px is None or order.reach_px is None:
        return None
    keypoints_px, reach_px = unpack(order.expected_px), unpack(order.reach_px)
    return ExpectedView(keypoints_px.astype(np.float64), reach_px.astype(np.float64))
