"""A belief as named arrays, and back: what tests compare and keep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.estimate.filter.state import Belief, Leftovers, Model


def belief_to_arrays(belief: Belief) -> dict[str, NDArray[np.generic]]:
    """Return a belief as named arrays, fit for `numpy.savez`; nothing is lost."""
    waiting = belief.leftovers
    return {
        "time_s": np.array(belief.time_s),
        "next_id": np.array(belief.next_id),
        "failed_pairs": belief.failed_pairs,
        "detection_map": belief.detection_map,
        "noise": belief.noise,
        **belief.columns(),
        **{f"leftover_{item.name}": getattr(waiting, item.name) for item in fields(waiting)},
    }


def belief_from_arrays(arrays: Mapping[str, NDArray[np.generic]], model: Model) -> Belief:
    """Return the belief that `belief_to_arrays` took apart.

    Raises:
        InputError: when an array is missing or does not fit the model.
    """
    empty = Belief.empty(model)
    pattern = belief_to_arrays(empty)
    for name, like in pattern.items():
        if name not in arrays:
            raise InputError(f"belief: {name}: not found, expected an array")
        found = np.asarray(arrays[name])
        if found.shape[1:] != like.shape[1:] or found.ndim != like.ndim:
            raise InputError(f"belief: {name}: found shape {found.shape}, expected {like.shape}")
        if found.dtype != like.dtype:
            raise InputError(f"belief: {name}: found {found.dtype}, expected {like.dtype}")
    for names in (list(empty.columns()), [n for n in pattern if n.startswith("leftover_")]):
        lengths = {len(arrays[name]) for name in names}
        if len(lengths) > 1:
            raise InputError(f"belief: {names[0]} ...: found lengths {sorted(lengths)}")
    waiting = [np.array(arrays[f"leftover_{item.name}"]) for item in fields(Leftovers)]
    columns = {name: np.array(arrays[name]) for name in empty.columns()}
    return Belief(
        time_s=float(np.asarray(arrays["time_s"], dtype=np.float64)),
        next_id=int(np.asarray(arrays["next_id"], dtype=np.int64)),
        leftovers=Leftovers(*waiting),
        failed_pairs=np.array(arrays["failed_pairs"]),
        detection_map=np.array(arrays["detection_map"]),
        noise=np.array(arrays["noise"]),
        **columns,
    )
