"""Left or right? Detectors exchange the sides of arms, of legs or of whole people.

What a detection shows of a pair of joints, as the vector from one side to the other, is compared
with what the track predicts: with m the one and M the other, and V the variance of either
coordinate of m - M, the log-odds that sides are as given against exchanged are

    (|m + M|^2 - |m - M|^2) / 2V = 2 m . M / V

whatever the detection as a whole is off. One pair says `PAIR_ODDS` at most, so that a wild joint
proves nothing. A joint whose opposite is missing is compared with both places.

A track whose sides are wrong finds its detections exchanged. Detectors are right more often than
not, so a track that several looks in a row contradict is turned round instead of them.
"""

from __future__ import annotations

from e3pose.base.arrays import Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.existence import LEARN_RATE
from e3pose.estimate.filter.projected import IN_FRONT, SPREAD, USED_SCORE, U, V
from e3pose.estimate.filter.scratch import Constants, Matches, Tracks, Views

ARMS, LEGS = 1, 2  # layout: bits of `Constants.limbs`; of limbs that are exchanged
GIVEN = 4  # layout: times these: of limbs that are clearly as given
# Log-odds against an exchange, before comparing. Legs are mistaken for each other by a track that
# is half a step behind a walker, too.
# tuned: odds, odds | simulated, with 0, 1 and 5 % swapped, seeds 701 and 702: 6, or 5 for legs,
#   mirrors the legs of walking people, lab/experiments/2026-11-22-left-and-right.md | sides
ARMS_ODDS, LEGS_ODDS = 5.0, 7.0
# tuned: odds | simulated, as the odds of limbs: 2 finds too few,
#   lab/experiments/2026-11-22-left-and-right.md | sides
PAIR_ODDS = 3.0
BOTH_ODDS = ARMS_ODDS + LEGS_ODDS - PAIR_ODDS  # definition
# tuned: px | simulated, as the odds of limbs, lab/experiments/2026-11-22-left-and-right.md | 20:
#   within 1 % by the truth
SIDE_PX = 10.0  # of one joint, on top of its noise
# tuned: s | first guess | half and twice
APART_S = 0.3  # looks of one camera at a track's sides count in full so far apart


@kernel
def exchanged_limbs(
    row: int,
    pixels: Floats,
    weights: Floats,
    variances: Floats,
    bias: float,
    projected: Floats,
    core: Integers,
    opposites: Integers,
    limbs: Integers,
) -> int:
    """Return the bits of limbs with exchanged sides, and of limbs with the given sides.

    Args:
        row: of the detection.
        pixels: `(num_rows, num_joints, 2)` undistorted.
        weights: `(num_rows, num_joints)` scores.
        variances: `(num_rows, num_joints)` px^2.
        bias: `SIDE_PX` in this view, squared.
        projected: `(4, num_joints)` the track in the view.
        core: `(num_core,)` as in `Constants`.
        opposites: `(num_joints,)` likewise.
        limbs: `(num_joints,)` as in `Constants`.
    """
    arms = legs = 0.0  # log-odds of being as given
    for joint in core:
        other = opposites[joint]
        if other == joint or not weights[row, joint] > USED_SCORE:
            continue
        if not (projected[IN_FRONT, joint] > 0 and projected[IN_FRONT, other] > 0):
            continue
        across_u = projected[U, joint] - projected[U, other]
        across_v = projected[V, joint] - projected[V, other]
        spread = projected[SPREAD, joint] + projected[SPREAD, other]
        variance = variances[row, joint] + bias
        if weights[row, other] > USED_SCORE:
            if other < joint:
                continue
            du = pixels[row, joint, 0] - pixels[row, other, 0]
            dv = pixels[row, joint, 1] - pixels[row, other, 1]
            variance += variances[row, other] + bias + spread
            odds = 2.0 * (du * across_u + dv * across_v) / variance
        else:
            du = pixels[row, joint, 0] - (projected[U, joint] + projected[U, other]) / 2
            dv = pixels[row, joint, 1] - (projected[V, joint] + projected[V, other]) / 2
            odds = (du * across_u + dv * across_v) / (variance + spread / 2)
        odds = -PAIR_ODDS if odds < -PAIR_ODDS else PAIR_ODDS if odds > PAIR_ODDS else odds
        if limbs[joint] == ARMS:
            arms += odds
        else:
            legs += odds
    most, found = 0.0, 0
    for choice, odds in (
        (ARMS, -arms - ARMS_ODDS),
        (LEGS, -legs - LEGS_ODDS),
        (ARMS + LEGS, -arms - legs - BOTH_ODDS),
    ):
        if odds > most:
            most, found = odds, choice
    if arms > ARMS_ODDS and not found & ARMS:
        found += GIVEN * ARMS
    if legs > ARMS_ODDS and not found & LEGS:
        found += GIVEN * LEGS
    return found


@kernel
def exchange(row: int, exchanged: int, opposites: Integers, limbs: Integers, views: Views) -> None:
    """Exchange the sides of limbs of the detection in `row`, in place."""
    for joint in range(len(opposites)):
        other = opposites[joint]
        if other > joint and exchanged & limbs[joint]:
            for axis in range(2):
                value = views.pixels[row, joint, axis]
                views.pixels[row, joint, axis] = views.pixels[row, other, axis]
                views.pixels[row, other, axis] = value
            value = views.weights[row, joint]
            views.weights[row, joint] = views.weights[row, other]
            views.weights[row, other] = value
            value = views.variances[row, joint]
            views.variances[row, joint] = views.variances[row, other]
            views.variances[row, other] = value


@kernel
def turn_round(
    num_tracks: int, dt: float, constants: Constants, views: Views, matches: Matches, tracks: Tracks
) -> None:
    """Exchange the sides of tracks that their detections contradict, and of these back again."""
    for track in range(num_tracks):
        for row, limb in ((0, ARMS), (1, LEGS)):
            share = tracks.mirrored[track, row]
            for camera in range(len(views.counts)):
                if not (views.arrived[camera] and matches.assigned[camera, track] >= 0):
                    continue
                exchanged = matches.exchanged[camera, track]
                if exchanged & (limb + GIVEN * limb):
                    since = (tracks.last_seen_s[track, camera] + dt) / APART_S
                    rate = LEARN_RATE * (since if since < 1.0 else 1.0)
                    share += rate * ((1.0 if exchanged & limb else 0.0) - share)
            if share > 0.5:
                share = 1.0 - share
                _mirror(track, limb, constants.opposites, constants.limbs, tracks)
                for camera in range(len(views.counts)):
                    person = matches.assigned[camera, track]
                    exchanged = matches.exchanged[camera, track] & (limb + GIVEN * limb)
                    if views.arrived[camera] and person >= 0 and exchanged:
                        first = views.starts[camera]
                        exchange(first + person, limb, constants.opposites, constants.limbs, views)
            tracks.mirrored[track, row] = share


@kernel
def _mirror(track: int, limb: int, opposites: Integers, limbs: Integers, tracks: Tracks) -> None:
    """Exchange the positions of the sides of a limb; covariances are alike and stay."""
    for joint in range(len(opposites)):
        other = opposites[joint]
        if limbs[joint] != limb:
            continue
        for camera in range(tracks.bias_px.shape[1]):
            tracks.bias_px[track, camera, joint, 0] = 0.0
            tracks.bias_px[track, camera, joint, 1] = 0.0
        if other > joint:
            for axis in range(6):
                value = tracks.state[track, joint, axis]
                tracks.state[track, joint, axis] = tracks.state[track, other, axis]
                tracks.state[track, other, axis] = value
