"""Situations of joints: what a detector's lasting errors depend on, and the fields over them.

A detector errs the same way for as long as it sees the same thing. What it sees of a joint is
described by a vector, the situation: the direction of view relative to the torso, the posture
around the joint, whose joint it is, and where whoever hides it stands. An error is a smooth random
function of it: it stays while nothing changes, changes as the view or the posture changes, comes
back when they come back, and is nearly the same in two cameras beside each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from e3pose.base.arrays import Floats

# By joint of COCO-17: the other joint whose place tells most of how it looks.
NEXT = np.array([3, 3, 4, 4, 3, 7, 8, 9, 10, 7, 8, 13, 14, 15, 16, 13, 14])
MARKS = 2  # numbers by which people differ
SIZE = 3 + 3 + 3 + MARKS + 2  # direction of view, joint, next joint, person, whoever hides it
WAVES = 48  # cosines of a field
# People differ by so much, in units of a situation: half of a field is common to all.
PERSON_SPREAD = 0.7
HIDER_M = 0.25  # an error is another one when whoever hides the joint has moved so far


@dataclass(frozen=True, slots=True, eq=False)
class Fields:
    """Smooth random functions of a situation, the same ones for all cameras.

    f(x) = sqrt(2 / WAVES) sum_k a_k cos(w_k . x + p_k) with w_k and a_k standard normal and p_k
    uniform: nearly a Gaussian process whose correlation at a distance d is exp(-d^2 / 2).

    Attributes:
        waves: `(17, SIZE, WAVES)` w.
        phases: `(17, WAVES)` p.
        amplitudes: `(17, WAVES, num_outputs)` a, with the factor.
        marks: `(num_persons, MARKS)` by which people differ.
    """

    waves: Floats
    phases: Floats
    amplitudes: Floats
    marks: Floats

    def at(self, situations: Floats) -> Floats:
        """Return `(num, 17, num_outputs)`, standard normal, of situations `(num, 17, SIZE)`."""
        out = np.empty((*situations.shape[:2], self.amplitudes.shape[2]))
        for joint in range(17):
            angles = situations[:, joint] @ self.waves[joint] + self.phases[joint]
            out[:, joint] = np.cos(angles) @ self.amplitudes[joint]
        return out


def draw_fields(rng: np.random.Generator, num_persons: int, num_outputs: int) -> Fields:
    """Draw the errors of a detector, and the peculiarities of each person before it."""
    waves = rng.standard_normal((17, SIZE, WAVES))
    phases = rng.uniform(0, 2 * np.pi, (17, WAVES))
    amplitudes = rng.standard_normal((17, WAVES, num_outputs)) * np.sqrt(2 / WAVES)
    marks = PERSON_SPREAD * rng.standard_normal((num_persons, MARKS))
    return Fields(waves, phases, amplitudes, marks)


def situations(
    centre_m: Floats, joints_m: Floats, marks: Floats, hiders_m: Floats, view: float, posture: float
) -> Floats:
    """Return the situations `(num, 17, SIZE)` of people in one view.

    Args:
        centre_m: `(3,)` the camera.
        joints_m: `(num, 17, 3)` metres.
        marks: `(num, MARKS)` whose joints they are.
        hiders_m: `(num, 17, 3)` the hips of whoever hides each joint, NaN for nobody.
        view: radians of direction by which an error becomes another one.
        posture: metres by which a joint moves, relative to the torso, for the same.
    """
    hips, shoulders = joints_m[:, 11:13].mean(axis=1), joints_m[:, 5:7].mean(axis=1)
    frame = _frames(joints_m, hips, shoulders)  # (num, 3, 3) rows: ahead, left, up
    towards = centre_m - 0.5 * (hips + shoulders)
    towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    direction = np.einsum("nij,nj->ni", frame, towards) / view
    local = np.einsum("nij,nkj->nki", frame, joints_m - hips[:, None]) / posture
    hider = np.einsum("nij,nkj->nki", frame, hiders_m - hips[:, None])[..., :2] / HIDER_M
    parts = [
        np.broadcast_to(direction[:, None], local.shape),
        local,
        local[:, NEXT],
        np.broadcast_to(marks[:, None], (*local.shape[:2], MARKS)),
        np.nan_to_num(hider),
    ]
    return np.concatenate(parts, axis=-1)


def _frames(joints_m: Floats, hips_m: Floats, shoulders_m: Floats) -> Floats:
    """Return `(num, 3, 3)`: ahead, left and up of torsos."""
    up = shoulders_m - hips_m
    up = up / np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-9)
    left = joints_m[:, 5] - joints_m[:, 6] + joints_m[:, 11] - joints_m[:, 12]
    left = left - up * (left * up).sum(axis=-1, keepdims=True)
    left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
    return np.stack([np.cross(left, up), left, up], axis=1)
