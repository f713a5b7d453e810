"""Track management: tracks are confirmed, coasted and ended by the views that should show them."""

from __future__ import annotations

import math

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.kernel import kernel
from e3pose.estimate.filter.blindness import FASTEST_S, PROOF_S, proof
from e3pose.estimate.filter.projected import USED_SCORE
from e3pose.estimate.filter.scratch import Matches, Tracks, Views

# tuned: per view | simulated: 0.12 and 0.16 have the same error, 0.16 fewer ghosts; 0.2 loses
#   people at 10 slots per second | half and twice
LEARN_RATE = 0.16  # of the share of views that show a person: a memory of six views
# tuned: share | simulated | half and twice
END_EXISTENCE = 0.3
# tuned: cameras, detections | first guess | confirmation by hits
CONFIRM_CAMERAS, CONFIRM_HITS = 3, 10
# tuned: joints | not recorded | half and twice
INSIDE_JOINTS = 6  # joints inside an image for which it should show the person
# tuned: share | not recorded | delivered
DELIVERED_PRIOR = 0.5  # assumed value of a camera before its first view
# tuned: per view | not recorded | delivered
DELIVERED_RATE = 0.3  # of a view: people move behind each other within a second
# tuned: s | not recorded | delivered forgotten
DELIVERED_LASTS_S = 3.0  # how long the value of an idle camera is kept
# tuned: m | not recorded | half and twice
SAME_M = 0.15  # median distance of joints at which two tracks are one person
# Detectors that take a front for a back make a mirrored body in the same place, cameras that do not
# agree one beside it. Middles of two people are farther apart, a chest is as deep as this; of two
# so near, a view shows both three times in ten or more often: 15 looks in a row that show one of
# them have odds of 0.7^15, half a percent.
# tuned: m | not recorded | two in a chest
CHEST_M = 0.25
# tuned: looks | not recorded | half and twice
MOST_ALONE = 15.0
# Views of which one takes a front for a back meet in a body of twice the width. Shoulders and hips
# of people are 0.4 to 0.75 m wide together.
# tuned: m | not fitted: between people, 0.4 to 0.75 m, and bodies of which one view takes a front
#   for a back, above 1.1 m | wide bodies
MOST_WIDE_M = 0.9


@kernel
def count_views(
    num_tracks: int,
    dt: float,
    scales: Floats,
    noise_px: Floats,
    views: Views,
    matches: Matches,
    detection_map: Floats,
    corner_m: Floats,
    core: Integers,
    size: float,
    tracks: Tracks,
) -> None:
    """Count for each track the views that showed it and the views that should have."""
    num_cameras = len(views.counts)
    rate = LEARN_RATE * (dt / FASTEST_S if dt < FASTEST_S else 1.0)
    forgotten = 1.0 - math.exp(-dt / DELIVERED_LASTS_S)
    finest = np.inf
    for knot in range(len(noise_px)):
        if noise_px[knot] < finest:
            finest = noise_px[knot]
    for track in range(num_tracks):
        num_seen_by = 0
        for camera in range(num_cameras):
            tracks.last_seen_s[track, camera] += dt
            before = tracks.delivered[track, camera]
            before += forgotten * (DELIVERED_PRIOR - before)
            tracks.delivered[track, camera] = before
            if views.arrived[camera]:
                person = matches.assigned[camera, track]
                information = 0.0
                if person >= 0:
                    row = views.starts[camera] + person
                    best = (finest * scales[camera]) ** 2
                    for joint in core:
                        if views.weights[row, joint] > USED_SCORE:
                            information += best / views.variances[row, joint]
                    information /= len(core)
                    tracks.hits[track] += 1
                    tracks.seen_by[track, camera] = True
                    tracks.last_seen_s[track, camera] = 0.0
                if person >= 0 or matches.inside[camera, track]:
                    fit, share = matches.fits[camera, track], 1.0
                    if person < 0:
                        share = proof(detection_map[camera], matches.places_m[track], corner_m)
                    tracks.existence[track] += rate * share * (fit - tracks.existence[track])
                    tracks.delivered[track, camera] += DELIVERED_RATE * (information - before)
            num_seen_by += tracks.seen_by[track, camera]
        if num_seen_by >= CONFIRM_CAMERAS or tracks.hits[track] >= CONFIRM_HITS:
            tracks.confirmed[track] = True
    for track in range(num_tracks):
        tracks.alone[track] = _alone(
            track,
            num_tracks,
            tracks.alone[track],
            rate / LEARN_RATE,
            views,
            matches,
            core,
            CHEST_M * size,
            tracks.state,
        )


@kernel
def _alone(
    track: int,
    num_tracks: int,
    alone: float,
    share: float,
    views: Views,
    matches: Matches,
    core: Integers,
    chest_m: float,
    state: Floats,
) -> float:
    """Return `Belief.alone` of a track after a slot."""
    nearest, least = -1, chest_m
    for other in range(num_tracks):
        if other != track:
            apart_m = _middles_apart_m(core, state[track], state[other])
            if apart_m < least:
                nearest, least = other, apart_m
    if nearest < 0:
        return 0.0
    for camera in range(len(views.counts)):
        if views.arrived[camera]:
            shown = matches.assigned[camera, track] >= 0
            other_shown = matches.assigned[camera, nearest] >= 0
            if shown and other_shown:
                return 0.0
            alone += share * (shown != other_shown)
    return alone


@kernel
def end(
    num_tracks: int, girdles: Integers, core: Integers, size: float, tracks: Tracks, ended: Flags
) -> None:
    """Fill `ended` `(num_tracks,)`: tracks that are no more."""
    for track in range(num_tracks):
        over = _is_over(tracks.existence[track], core, tracks.unmeasured_s[track])
        ended[track] = over or is_wide(tracks.state[track], girdles)
    for track in range(num_tracks):
        for other in range(track):
            younger = track if tracks.hits[track] <= tracks.hits[other] else other
            same = _is_same(core, SAME_M * size, tracks.state[track], tracks.state[other])
            if not same and tracks.alone[younger] > MOST_ALONE:
                apart_m = _middles_apart_m(core, tracks.state[track], tracks.state[other])
                same = apart_m < CHEST_M * size
            if same:
                ended[younger] = True


@kernel
def _is_over(existence: float, core: Integers, unmeasured_s: Floats) -> bool:
    if not existence > END_EXISTENCE:
        return True
    seen = False
    for joint in core:
        seen |= unmeasured_s[joint] <= PROOF_S
    return not seen


@kernel
def is_wide(joints_m: Floats, girdles: Integers) -> bool:
    """Return whether shoulders and hips are wider than plausible; False where one is NaN."""
    total = 0.0
    for girdle in range(len(girdles)):
        squares = 0.0
        for axis in range(3):
            first = joints_m[girdles[girdle, 0], axis]
            squares += (first - joints_m[girdles[girdle, 1], axis]) ** 2
        total += math.sqrt(squares)
    return total > MOST_WIDE_M


@kernel
def _middles_apart_m(core: Integers, first: Floats, second: Floats) -> float:
    """Return the distance of the means of two people's core joints."""
    squares = 0.0
    for axis in range(3):
        total = 0.0
        for joint in core:
            total += first[joint, axis] - second[joint, axis]
        squares += (total / len(core)) ** 2
    return math.sqrt(squares)


@kernel
def _is_same(core: Integers, same_m: float, first: Floats, second: Floats) -> bool:
    """Return whether the median distance of the core joints is below `same_m`."""
    near = 0
    below, above = 0.0, np.inf  # the largest distance that is near, the smallest that is not
    for joint in core:
        squares = 0.0
        for axis in range(3):
            squares += (first[joint, axis] - second[joint, axis]) ** 2
        distance = math.sqrt(squares)
        if distance < same_m:
            near += 1
            below = distance if distance > below else below
        else:
            above = distance if distance < above else above
    if 2 * near == len(core):
        return (below + above) / 2 < same_m
    return 2 * near > len(core)
