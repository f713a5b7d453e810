"""Keypoints of a detector that guesses hidden joints: scores, misses and errors.

Errors depend on the situation (`situations.py`) and not on the score alone: a hidden or cut joint
is guessed, leans to the person in front, keeps a middling score, and stays where it was guessed for
as long as the situation lasts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats
from e3pose.model.camera import Camera
from e3pose.simulate.hidden_joints import covered_by_self, covered_by_whom
from e3pose.simulate.noise import correlated, normal_cdf
from e3pose.simulate.settings import Guessing
from e3pose.simulate.situations import NEXT, Fields, situations

DECLARED = "openpose"  # whose noise these errors have, and whose noise file a replay takes
OUTPUTS = 7  # of the fields: error right and down, score, miss, what is guessed, sides, person
RIGHT, DOWN, SCORE, MISS, CHOICE, SIDES, WHOLE = range(OUTPUTS)
CLEAR = 1.75  # log-odds of the score of a joint in plain sight
SPREAD = 0.9  # of these log-odds
BEST_SCORE = 0.98
SCORE_LASTING = 0.6  # share of their variance that the situation decides
SCORE_MEMORY = ((0.5, 0.0), (0.5, 0.25))  # of the rest: share, seconds
SIGMA_BY_ODDS = 0.22  # the error falls by so much, as a logarithm, as the log-odds rise by one
QUICK_MEMORY = ((0.15, 0.0), (0.85, 0.15))  # of errors that do not last: share, seconds
MISS_LASTING = 0.7
MISS_MEMORY = ((0.3, 0.0), (0.7, 0.3))
# What a joint scores more or less than the others, and its errors by those of a shoulder: hips and
# legs have no mark of their own under clothes.
JOINT_ODDS = np.array(
    [0.2, 0.3, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.1, -0.1, -0.5, -0.5, -0.2, -0.2, -0.3, -0.3]
)
JOINT_SIGMA = np.array(
    [0.7, 0.7, 0.7, 0.8, 0.8, 1.0, 1.0, 0.9, 0.9, 1.0, 1.0, 1.1, 1.1, 1.15, 1.15, 1.2, 1.2]
)
FACE, ARMS = slice(0, 5), slice(7, 11)
MIRROR = np.array([0, 2, 1, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13, 16, 15])
ARM_ROWS, LEG_ROWS = slice(5, 11), slice(11, 17)
OWN_SWAPS = np.r_[7:11, 13:17]  # joints that are guessed at the other side's
CUT_M = 0.1  # joints so far outside the image are still guessed, at its edge
HALF = 0.5  # of a cover, from which on a joint is hidden


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The detections of everybody by one camera.

    Attributes:
        keypoints_px: `(num_slots, num_persons, 17, 2)`.
        scores: `(num_slots, num_persons, 17)` in [0, 1].
        seen: `(num_slots, num_persons, 17)` whether it reports the joint.
    """

    keypoints_px: Floats
    scores: Floats
    seen: Flags


@dataclass(frozen=True, slots=True, eq=False)
class Hidden:
    """How far each joint is hidden, and by whom.

    Attributes:
        own: `(num_slots, num_persons, 17)` how squarely the own body hides it, 0 to 1.
        other: the same shape: another body, a thing, or the edge of the image.
        whom: the same shape: the person who hides it, -1 for nobody.
        inside: the same shape: in the image, or as good as.
    """

    own: Floats
    other: Floats
    whom: NDArray[np.int64]
    inside: Flags


def hidden(
    camera: Camera, joints_m: Floats, pixels: Floats, things: Flags, px_per_m: Floats
) -> Hidden:
    """Return how people are hidden from a camera.

    Args:
        camera: in the frame of the joints.
        joints_m: `(num_slots, num_persons, 17, 3)`.
        pixels: `(num_slots, num_persons, 17, 2)` where they project.
        things: `(num_slots, num_persons, 17)` whether a thing of the scene hides the joint.
        px_per_m: `(num_slots, num_persons)` apparent size.
    """
    others, whom = covered_by_whom(camera.center_m, joints_m)
    size = np.array(camera.image_size)
    with np.errstate(invalid="ignore"):
        outside = np.maximum(np.maximum(-0.5 - pixels, pixels - (size - 0.5)), 0.0).max(axis=-1)
        ahead = np.isfinite(outside)
        inside = ahead & (outside <= CUT_M * px_per_m[..., None])
        cut = inside & ((outside > 0) | ~(outside[:, :, NEXT] <= 0))
    other = np.maximum(others, (things | cut).astype(np.float64))
    return Hidden(covered_by_self(camera.center_m, joints_m), other, whom, inside)


def guess(
    camera: Camera,
    joints_m: Floats,
    pixels: Floats,
    hid: Hidden,
    px_per_m: Floats,
    odds_lost: Floats,
    fps: float,
    fields: Fields,
    settings: Guessing,
    noise: float,
    rng: np.random.Generator,
) -> Seen:
    """Return the keypoints of one camera.

    Args:
        camera: in the frame of the joints.
        joints_m: `(num_slots, num_persons, 17, 3)` metres, NaN for people who are away.
        pixels: `(num_slots, num_persons, 17, 2)` where they project.
        hid: what hides them.
        px_per_m: `(num_slots, num_persons)` apparent size.
        odds_lost: `(num_slots, num_persons)` log-odds that blur and distance take from scores.
        fps: slots per second.
        fields: of the situation.
        settings: how it guesses.
        noise: factor on its errors, but for joints taken for others.
        rng: of what is new in every slot.
    """
    shape, interval_s = hid.own.shape, 1 / fps
    field = _fields(camera, joints_m, hid, fields, settings)
    cover = np.maximum(hid.own, hid.other)
    odds = CLEAR + JOINT_ODDS - settings.hidden_odds * cover - odds_lost[..., None]
    odds += SPREAD * np.sqrt(SCORE_LASTING) * field[..., SCORE]
    odds += SPREAD * np.sqrt(1 - SCORE_LASTING) * correlated(rng, shape, interval_s, SCORE_MEMORY)
    missed = np.sqrt(MISS_LASTING) * field[..., MISS]
    missed += np.sqrt(1 - MISS_LASTING) * correlated(rng, shape, interval_s, MISS_MEMORY)
    own = np.full(17, settings.own_trunk_miss)
    own[FACE], own[ARMS] = settings.own_face_miss, settings.own_arm_miss
    share = settings.joint_miss + (own - settings.joint_miss) * hid.own
    gone = normal_cdf(missed) < share + (settings.other_miss - share) * hid.other
    gone |= (normal_cdf(field[..., 11, WHOLE]) < settings.person_miss)[..., None]
    sigma = settings.sigma_m * JOINT_SIGMA * np.exp(-SIGMA_BY_ODDS * (odds - CLEAR))
    sigma *= noise * settings.guess_factor**cover * px_per_m[..., None]
    lasting, quick = np.sqrt(settings.lasting), np.sqrt(1 - settings.lasting)
    error = lasting * field[..., : DOWN + 1]
    error += quick * correlated(rng, (*shape, 2), interval_s, QUICK_MEMORY)
    places = _leaning(pixels, hid, normal_cdf(field[..., CHOICE]), settings)
    # Left and right arms or legs are exchanged where the situation makes the detector do it.
    places, chance = places.copy(), normal_cdf(field[..., SIDES])
    for rows, joint in ((ARM_ROWS, 5), (LEG_ROWS, 11)):
        swapped = chance[:, :, joint] < settings.swap
        places[swapped, rows] = places[:, :, MIRROR][swapped, rows]
    size = np.array(camera.image_size)
    keypoints = np.clip(places + sigma[..., None] * error, -0.49, size - 0.51)
    scores = BEST_SCORE / (1 + np.exp(-(odds + settings.overconfidence)))
    return Seen(keypoints, scores, hid.inside & ~gone & np.isfinite(keypoints).all(axis=-1))


def _fields(
    camera: Camera, joints_m: Floats, hid: Hidden, fields: Fields, settings: Guessing
) -> Floats:
    """Return the fields `(num_slots, num_persons, 17, OUTPUTS)`; 0 for people who are away."""
    out = np.zeros((*hid.own.shape, OUTPUTS))
    slots, people = np.nonzero(np.isfinite(joints_m[..., 0, 0]))
    hips = joints_m[:, :, 11:13].mean(axis=2)
    whom = hid.whom[slots, people]
    hiders = np.where(whom[..., None] >= 0, hips[slots[:, None], whom], np.nan)
    found = situations(
        camera.center_m, joints_m[slots, people], fields.marks[people], hiders,
        settings.view_rad, settings.posture_m,
    )  # fmt: skip
    out[slots, people] = fields.at(found)
    return out


def _leaning(pixels: Floats, hid: Hidden, choice: Floats, settings: Guessing) -> Floats:
    """Return where the detector takes each joint to be, before its noise.

    Some of those behind another person are taken to be that person's, some of those behind the own
    body the other side's.
    """
    places = pixels.copy()
    taken = (hid.whom >= 0) & (hid.other > HALF) & (choice < settings.taken)
    slots, people, joints = np.nonzero(taken)
    places[slots, people, joints] = pixels[slots, hid.whom[slots, people, joints], joints]
    mirrored = (hid.own > HALF) & ~taken & (choice < settings.mirrored)
    mirrored &= np.isin(np.arange(17), OWN_SWAPS)
    slots, people, joints = np.nonzero(mirrored)
    places[slots, people, joints] = pixels[slots, people, MIRROR[joints]]
    return np.asarray(places)
