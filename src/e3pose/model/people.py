"""People in the world: the one record of whole people, from estimators to files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.errors import InputError
from e3pose.model.pose import checked_positions
from e3pose.model.uncertainty import axis_sigma_m

_UNKNOWN: Any = np.zeros(0)  # of a field that was not given


@dataclass(frozen=True, slots=True, eq=False)
class People:
    """People in the world: a row per person of one slot, or per person and slot of several.

    Missing is NaN with score 0. Files and messages hold single precision, which is kept.

    Attributes:
        track_ids: `(num_people,)` identities, unique within a run; numbers of rows before identity.
        joints_m: `(num_people, num_joints, 3)` world metres, z up; NaN where missing.
        scores: `(num_people, num_joints)` in [0, 1]; 0 where missing. By default 1 elsewhere.
        measured: `(num_people, num_joints)` whether a view of the slot measured the joint; others
            are predicted from other slots, or missing. By default all that have a score.
        sigma_m: `(num_people, num_joints)` standard deviation along an axis, metres; NaN where
            unknown, which is the default. That of `full_covariance_m2`, where it is given.
        full_covariance_m2: `(num_people, num_joints, 3, 3)` of joints, square metres; NaN where
            unknown; None where no more than `sigma_m` is known.
        dynamics: `(num_people, num_joints, 6)` see `model.dynamics`; None where unknown.

    Raises:
        InputError: on a wrong shape, or a score outside [0, 1].
    """

    track_ids: Integers
    joints_m: NDArray[Any]
    scores: NDArray[Any] = field(default_factory=lambda: _UNKNOWN)
    measured: Flags = field(default_factory=lambda: _UNKNOWN)
    sigma_m: NDArray[Any] = field(default_factory=lambda: _UNKNOWN)
    full_covariance_m2: Floats | None = None
    dynamics: Floats | None = None

    def __post_init__(self) -> None:
        joints_m, scores = np.asarray(self.joints_m), np.asarray(self.scores)
        if self.scores is _UNKNOWN:
            scores = np.isfinite(joints_m).all(axis=-1).astype(joints_m.dtype)
        joints_m, scores = checked_positions("People", joints_m, scores, components=3)
        measured, sigma_m = self.measured, self.sigma_m
        if self.full_covariance_m2 is not None:
            sigma_m = axis_sigma_m(self.full_covariance_m2)
        elif sigma_m is _UNKNOWN:
            sigma_m = np.full(scores.shape, np.nan)
        given: dict[str, Any] = {
            "track_ids": np.asarray(self.track_ids, dtype=np.int64),
            "joints_m": joints_m,
            "scores": scores,
            "measured": np.asarray(scores > 0 if measured is _UNKNOWN else measured, dtype=bool),
            "sigma_m": sigma_m,
            **({} if self.dynamics is None else {"dynamics": self.dynamics}),
        }
        for name, value in given.items():
            object.__setattr__(self, name, value)
            if value.shape[: scores.ndim] != scores.shape[: value.ndim]:
                raise InputError(
                    f"People: {name}", f"shape {value.shape}", f"for joints {joints_m.shape}"
                )

    def __len__(self) -> int:
        return len(self.scores)

    def __getitem__(self, rows: slice | NDArray[Any]) -> People:
        """Return some rows: a slice, their numbers `(num_rows,)`, or flags `(num_people,)`."""
        arrays = {item.name: getattr(self, item.name) for item in fields(self)}
        return replace(
            self, **{name: array[rows] for name, array in arrays.items() if array is not None}
        )

    @property
    def covariance_m2(self) -> Floats:
        """`(num_people, num_joints, 3, 3)` of joints, square metres; NaN where unknown.

        Where only `sigma_m` is known, the same along every axis.
        """
        if self.full_covariance_m2 is not None:
            return self.full_covariance_m2
        return np.asarray(self.sigma_m.astype(np.float64)[..., None, None] ** 2 * np.eye(3))

    @classmethod
    def empty(cls, num_joints: int) -> People:
        """Return nobody."""
        none = np.zeros(0, dtype=np.int64)
        return cls(none, np.zeros((0, num_joints, 3)))

    @classmethod
    def unchecked(cls, joints_m: Floats, scores: Floats, **known: Any) -> People:
        """Return people as a kernel made them: a check would take a fifth of a small slot's time.

        Besides `known` fields they have numbers of rows, are measured where they have a score, and
        nothing else is known of them.
        """
        if "sigma_m" not in known:
            known["sigma_m"] = np.full(scores.shape, np.nan)
        people = object.__new__(cls)
        values = np.arange(len(scores)), joints_m, scores, scores > 0, None, None, None
        for name, value in zip(cls.__slots__, values, strict=True):
            object.__setattr__(people, name, known.get(name, value))
        return people

    @classmethod
    def joined(cls, parts: Sequence[People], num_joints: int) -> People:
        """Return the rows of all, with `sigma_m` in place of full covariances.

        Args:
            parts: any number, in order.
            num_joints: of each.
        """
        known = [part for part in parts if len(part)] or [*parts[:1], cls.empty(num_joints)][:1]
        names = ("track_ids", "joints_m", "scores", "measured", "sigma_m")
        dynamics = [part.dynamics for part in known if part.dynamics is not None]
        return cls(
            **{name: np.concatenate([getattr(part, name) for part in known]) for name in names},
            dynamics=np.concatenate(dynamics) if len(dynamics) == len(known) else None,
        )
