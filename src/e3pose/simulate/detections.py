"""Simulate the output of one camera's detector, including its mistakes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Flags, Floats
from e3pose.model.camera import Camera
from e3pose.model.noise import LEAST_SCORE, ErrorMemory
from e3pose.recording import ViewSeries
from e3pose.simulate.body import Posture, draw_body, joints_of
from e3pose.simulate.gestures import HANGING, SEATED
from e3pose.simulate.guesses import BEST_SCORE, CLEAR, FACE, Seen, guess, hidden
from e3pose.simulate.hidden_joints import behind_things, covered_by_others, covered_by_self
from e3pose.simulate.noise import GROSS_MEMORY, correlated, normal_cdf, residuals
from e3pose.simulate.place import Scene
from e3pose.simulate.settings import DetectorSettings
from e3pose.simulate.situations import Fields

EPISODE_S = 0.15  # memory of swaps, misses and merges
MERGE_IOU = 0.3  # people whose boxes overlap so much may merge
BORROWED = 0.25  # share of the front person's joints that a merged detection takes from behind
GHOST_S = 0.25  # how long a ghost lasts
GHOST_SCORES = (0.1, 0.5)
ARMS = ((5, 6), (7, 8), (9, 10))
LEGS = ((11, 12), (13, 14), (15, 16))


def episodes(
    rng: np.random.Generator,
    shape: tuple[int, ...],
    interval_s: float,
    share: Floats | float,
    episode_s: float = EPISODE_S,
) -> Flags:
    """Return `shape` booleans that are true in episodes along the first axis.

    Args:
        rng: source of chance.
        shape: slots first.
        interval_s: seconds per slot.
        share: of the time in which they are true, [0, 1], for the rest of the axes.
        episode_s: their memory.
    """
    latent = correlated(rng, shape, interval_s, ((1.0, episode_s),))
    return np.asarray(normal_cdf(latent) < share)


def swap_sides(
    keypoints: Floats, scores: Floats, rng: np.random.Generator, interval_s: float, share: float
) -> tuple[Floats, Floats]:
    """Exchange left and right arms, legs or both for a share of the person-views.

    Args:
        keypoints: `(num_slots, num_persons, 17, 2)` pixels.
        scores: `(num_slots, num_persons, 17)`.
        rng: source of randomness.
        interval_s: between slots.
        share: of the person-views that are swapped.
    """
    swapped = episodes(rng, scores.shape[:2], interval_s, share)
    kind = normal_cdf(correlated(rng, scores.shape[:2], interval_s, ((1.0, 1.0),)))
    order = np.broadcast_to(np.arange(17), scores.shape).copy()
    for pairs, chosen in ((ARMS, kind < 2 / 3), (LEGS, kind > 1 / 3)):
        for left, right in pairs:
            rows = swapped & chosen
            order[rows, left], order[rows, right] = right, left
    moved = np.take_along_axis(keypoints, order[..., None], axis=2)
    return moved, np.take_along_axis(scores, order, axis=2)


def merge_people(
    keypoints: Floats,
    scores: Floats,
    distance_m: Floats,
    rng: np.random.Generator,
    interval_s: float,
    share: float,
    episode_s: float = EPISODE_S,
) -> tuple[Floats, Floats]:
    """Make one detection of two people who overlap, for a share of such views.

    The person in front keeps the detection, but it takes some joints, and those it lacks, from the
    one behind, who vanishes.

    Args:
        keypoints: `(num_slots, num_persons, 17, 2)` pixels, NaN where missing.
        scores: `(num_slots, num_persons, 17)`.
        distance_m: `(num_slots, num_persons)` from the camera.
        rng: source of randomness.
        interval_s: between slots.
        share: of the views of overlapping pairs that are merged.
        episode_s: how long a merge lasts.
    """
    keypoints, scores = keypoints.copy(), scores.copy()
    num_slots, num_persons = scores.shape[:2]
    boxes = _boxes(keypoints)
    for first in range(num_persons):
        for second in range(first + 1, num_persons):
            merged = episodes(rng, (num_slots,), interval_s, share, episode_s)
            taste = rng.uniform(size=17)
            merged &= _iou(boxes[:, first], boxes[:, second]) > MERGE_IOU
            for rows, front, back in (
                (merged & (distance_m[:, first] <= distance_m[:, second]), first, second),
                (merged & (distance_m[:, first] > distance_m[:, second]), second, first),
            ):
                # Somebody already merged away has nothing to give or to keep.
                slots = np.flatnonzero(rows & scores[:, front].any(1) & scores[:, back].any(1))
                borrow = (scores[slots, front] == 0) | (taste < BORROWED)
                borrow &= scores[slots, back] > 0
                keypoints[slots, front] = np.where(
                    borrow[..., None], keypoints[slots, back], keypoints[slots, front]
                )
                scores[slots, front] = np.where(borrow, scores[slots, back], scores[slots, front])
                keypoints[slots, back], scores[slots, back] = np.nan, 0.0
    return keypoints, scores


def add_ghosts(
    camera: Camera,
    num_slots: int,
    fps: float,
    area: tuple[Floats, float],
    rng: np.random.Generator,
    expected: float,
    memory: ErrorMemory,
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Invent people who are not there, each for a moment and in this view only.

    Args:
        camera: the view.
        num_slots: length of the recording.
        fps: slots per second.
        area: `(2,)` centre and radius of the floor in use, around which ghosts appear.
        rng: source of randomness.
        expected: mean number of ghosts in a view.
        memory: how long their keypoints stay off their place.

    Returns:
        Their slots `(num_ghosts,)`, keypoints `(num_ghosts, 17, 2)` and scores `(num_ghosts, 17)`,
        one row per ghost and slot.
    """
    lasting = max(1.0, GHOST_S * fps)
    slots: list[NDArray[np.int64]] = []
    keypoints, scores = [np.zeros((0, 17, 2))], [np.zeros((0, 17))]
    width, height = camera.image_size
    for _ in range(int(rng.poisson(expected * (num_slots + lasting - 1) / lasting))):
        length = int(rng.geometric(1 / lasting))
        start = int(rng.integers(1 - int(lasting), num_slots))
        when = np.arange(max(start, 0), min(start + length, num_slots))
        shape = _ghost_shape(camera, area, rng)
        low, high = -shape.min(axis=0), np.array([width - 1, height - 1]) - shape.max(axis=0)
        place = low + rng.uniform(size=2) * (high - low)  # all of it inside, if it fits
        kept = rng.permutation(17) < rng.integers(6, 16)
        jitter = 0.03 * height * 0.25 * correlated(rng, (length, 17, 2), 1 / fps, memory.parts)
        score = rng.uniform(*GHOST_SCORES) + 0.06 * correlated(
            rng, (length, 17), 1 / fps, memory.parts
        )
        where = (shape + place + jitter)[: len(when)]
        inside = kept & ((where >= -0.5) & (where < np.array([width, height]) - 0.5)).all(axis=-1)
        slots.append(when.astype(np.int64))
        keypoints.append(np.where(inside[..., None], where, np.nan))
        scores.append(np.where(inside, np.clip(score[: len(when)], 0.05, 0.9), 0.0))
    all_slots = np.concatenate(slots) if slots else np.zeros(0, dtype=np.int64)
    return all_slots, np.concatenate(keypoints), np.concatenate(scores)


def _ghost_shape(camera: Camera, area: tuple[Floats, float], rng: np.random.Generator) -> Floats:
    """Return `(17, 2)` pixels of a standing or sitting body around its own middle."""
    body = draw_body(rng)
    centre, radius = area
    xy = centre + radius * rng.uniform(-0.7, 0.7, 2)
    yaw = float(rng.uniform(-np.pi, np.pi))
    seated = bool(rng.uniform() < 0.3)
    hips = np.array([*xy, 0.54 if seated else body.ankle_height + 0.98 * body.leg])
    left = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0]) * (0.4 if seated else 0.0)
    ankles = [np.array([*xy, body.ankle_height]) + ahead + 0.1 * side * left for side in (1, -1)]
    angles = np.array([[yaw, 0.05, 0.0]])
    arms = (SEATED if seated else HANGING) + rng.uniform(-0.4, 0.4, (1, 2, 4))
    arms[..., 3] = np.maximum(arms[..., 3], 0.0)
    joints = joints_of(
        body,
        Posture(hips[None], angles, angles, angles, angles[:, 0], np.array(ankles)[None], arms),
    )[0]
    pixels = camera.project(joints)
    middle = camera.project(joints.mean(axis=0))
    height = camera.image_size[1]
    if np.isfinite(pixels).all() and 0.05 * height < np.ptp(pixels[:, 1]) < 2 * height:
        return np.asarray(pixels - middle)
    flat = np.stack(
        [(joints - joints.mean(axis=0)) @ left, -(joints - joints.mean(axis=0))[:, 2]], 1
    )
    return np.asarray(flat * 0.3 * height)


def _boxes(keypoints: Floats) -> Floats:
    """Return `(num_slots, num_persons, 4)` left, top, right, bottom; all NaN without a keypoint."""
    seen = np.isfinite(keypoints)
    low = np.where(seen, keypoints, np.inf).min(axis=2)
    high = np.where(seen, keypoints, -np.inf).max(axis=2)
    boxes = np.concatenate([low, high], axis=-1)
    return np.where(np.isfinite(boxes), boxes, np.nan)


def _iou(a: Floats, b: Floats) -> Floats:
    """Return `(num_slots,)` overlap (IoU) of boxes `(num_slots, 4)`; 0 where one is missing."""
    sides = np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
    common = np.maximum(sides, 0).prod(axis=1)
    union = (a[:, 2:] - a[:, :2]).prod(axis=1) + (b[:, 2:] - b[:, :2]).prod(axis=1) - common
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.nan_to_num(common / union, nan=0.0, posinf=0.0, neginf=0.0))


MIN_JOINTS = 3  # with fewer a detector does not speak of a person
LASTING_MERGE_S = 1.0  # people merge for as long as they overlap, if the detector guesses
# What takes away from the log-odds of the score of a joint in plain sight.
SPREAD = 0.75
SELF_COVERED = 1.3
COVERED = 2.4
# Log-odds for halving or doubling the distance beyond the range in which the lens is sharp.
OUT_OF_FOCUS = 0.7
FOCUS_RANGE = 1.8  # the sharp range is the focus distance divided and multiplied by this
SMALL_PX_PER_M = 120.0  # smaller people score lower and, far smaller, are missed altogether
TINY_PX_PER_M = 30.0
# Face and wrists are small, hips have no mark: what a joint scores more or less than the others.
JOINT_BIAS = np.array(
    [0.0, 0.0, 0.0, -0.1, -0.1, 0.25, 0.25, 0.0, 0.0, -0.3, -0.3, -0.2, -0.2, 0.1, 0.1, 0.0, 0.0]
)
SCORE_MEMORY = ((0.2, 0.0), (0.4, 0.25), (0.4, 3.0))  # share of the variance, seconds
MISS_MEMORY = ((0.3, 0.0), (0.7, 0.3))


def detect_people(
    camera: Camera,
    joints_m: Floats,
    offset_m: Floats,
    scene: Scene,
    focus_m: float,
    fps: float,
    settings: DetectorSettings,
    seed: np.random.SeedSequence,
    fields: Fields | None = None,
) -> ViewSeries:
    """Simulate the views of one camera.

    Args:
        camera: the camera, in the world.
        joints_m: `(num_slots, num_persons, 17, 3)` in the scene, NaN for people who are away.
        offset_m: `(3,)` where the origin of the scene lies in the world.
        scene: its things and walls, and the floor in use.
        focus_m: distance at which the lens is sharp.
        fps: slots per second.
        settings: how the detector errs.
        seed: each kind of error has a stream of its own, so that one can be changed by itself.
        fields: errors by situation, the same for all cameras; needed by `settings.guessing`.
    """
    num_slots = len(joints_m)
    streams = [np.random.default_rng(child) for child in seed.spawn(8)]
    world_m = joints_m + offset_m
    keypoints = camera.project(world_m)
    centre = camera.center_m - offset_m
    inside = camera.sees(world_m) & ~behind_things(centre, joints_m, scene.walls)
    if settings.perfect:
        scores = inside.astype(np.float64)
        slots, people = np.nonzero(inside.any(axis=-1))
        exact = keypoints[slots, people], scores[slots, people]
        return _gathered(slots, *exact, fps, num_slots, streams[7])
    hips = world_m[:, :, 11:13].mean(axis=2)
    depth = np.linalg.norm(hips - camera.center_m, axis=-1)
    depth = np.maximum(np.nan_to_num(depth, nan=1.0), 0.3)
    px_per_m = 0.5 * (camera.K[0, 0] + camera.K[1, 1]) / depth
    # Log-odds that blur and distance take from scores.
    blur = np.maximum(np.abs(np.log2(depth / focus_m)) - np.log2(FOCUS_RANGE), 0.0)
    small = np.maximum(np.log2(SMALL_PX_PER_M / px_per_m), 0.0)
    lost = OUT_OF_FOCUS * blur + small + settings.blur
    if settings.guessing is not None:
        assert fields is not None
        things = behind_things(centre, joints_m, scene.occluders)
        hid = hidden(camera, world_m, keypoints, things, px_per_m)
        found = guess(
            camera, world_m, keypoints, hid, px_per_m, lost, fps, fields, settings.guessing,
            settings.noise, streams[0],
        )  # fmt: skip
        seen = found.seen & ~behind_things(centre, joints_m, scene.walls)
    else:
        found = _by_score(
            centre, joints_m, keypoints, scene, lost, px_per_m, fps, settings, streams
        )
        seen = found.seen & inside
    keypoints, scores = found.keypoints_px, found.scores
    in_image = (keypoints >= -0.5) & (keypoints < np.array(camera.image_size) - 0.5)
    seen &= in_image.all(axis=-1) & (scores > LEAST_SCORE)
    seen &= seen.sum(axis=-1, keepdims=True) >= MIN_JOINTS
    scores = np.where(seen, scores, 0.0)
    keypoints = np.where(seen[..., None], keypoints, np.nan)
    merge_s = LASTING_MERGE_S
    if settings.guessing is None:
        keypoints, scores = swap_sides(keypoints, scores, streams[4], 1 / fps, settings.swap)
        merge_s = EPISODE_S
    keypoints, scores = merge_people(
        keypoints, scores, depth, streams[5], 1 / fps, settings.merge, merge_s
    )
    area = (offset_m[:2], scene.area_m)
    ghost_slots, ghosts, ghost_scores = add_ghosts(
        camera, num_slots, fps, area, streams[6], settings.ghosts, settings.memory
    )
    slots, people = np.nonzero(scores.any(axis=-1))
    fake = np.flatnonzero((ghost_scores > 0).sum(axis=-1) >= MIN_JOINTS)
    return _gathered(
        np.concatenate([slots, ghost_slots[fake]]),
        np.concatenate([keypoints[slots, people], ghosts[fake]]),
        np.concatenate([scores[slots, people], ghost_scores[fake]]),
        fps,
        num_slots,
        streams[7],
    )


def _by_score(
    centre: Floats,
    joints_m: Floats,
    pixels: Floats,
    scene: Scene,
    odds_lost: Floats,
    px_per_m: Floats,
    fps: float,
    settings: DetectorSettings,
    streams: Sequence[np.random.Generator],
) -> Seen:
    """Return the detections of a detector whose errors depend on the score alone."""
    own = covered_by_self(centre, joints_m)
    other = np.maximum(
        covered_by_others(centre, joints_m), behind_things(centre, joints_m, scene.occluders)
    )
    scores = _scores(own, other, odds_lost, fps, streams[0])
    # `(num_slots, num_persons, 17)`: joints that are missed, alone or with the person.
    own_miss = np.full(17, settings.self_occluded_miss)
    own_miss[FACE] = settings.behind_head_miss
    share = settings.joint_miss + (own_miss - settings.joint_miss) * own
    share = share + (settings.occluded_miss - share) * other
    missed = normal_cdf(correlated(streams[1], own.shape, 1 / fps, MISS_MEMORY)) < share
    tiny = np.clip(2 * (1 - px_per_m / TINY_PX_PER_M), 0.0, 1.0)
    nobody = episodes(streams[2], px_per_m.shape, 1 / fps, np.maximum(settings.person_miss, tiny))
    missed = missed | nobody[..., None]
    # Errors `(num_slots, num_persons, 17, 2)` in pixels are correlated in time.
    rng = streams[3]
    direction = correlated(rng, (*scores.shape, 2), 1 / fps, settings.memory.parts)
    gross = normal_cdf(correlated(rng, scores.shape, 1 / fps, GROSS_MEMORY))
    errors_px = residuals(direction, gross, scores, px_per_m[..., None])
    return Seen(pixels + settings.noise * errors_px, scores, ~missed)


def until(series: ViewSeries, end: float) -> ViewSeries:
    """Return the views of slots before `end`: those of a camera that is gone from then on."""
    kept = int(np.searchsorted(series.slots, end))
    people = int(series.starts[kept])
    return ViewSeries(
        series.slots[:kept],
        series.times_s[:kept],
        series.starts[: kept + 1],
        series.keypoints_px[:people],
        series.scores[:people],
    )


def _scores(
    own: Floats, other: Floats, odds_lost: Floats, fps: float, rng: np.random.Generator
) -> Floats:
    """Return scores `(num_slots, num_persons, 17)`: lower where covered, blurred or small."""
    odds = CLEAR + JOINT_BIAS + SPREAD * correlated(rng, own.shape, 1 / fps, SCORE_MEMORY)
    odds = odds - SELF_COVERED * own - COVERED * other
    odds -= odds_lost[..., None]
    return np.asarray(BEST_SCORE / (1 + np.exp(-odds)))


def _gathered(
    slots: NDArray[np.int64],
    keypoints: Floats,
    scores: Floats,
    fps: float,
    num_slots: int,
    rng: np.random.Generator,
) -> ViewSeries:
    """Sort detections by slot, in a random order within each."""
    order = np.lexsort((rng.uniform(size=len(slots)), slots))
    scores = scores[order]
    return ViewSeries(
        np.arange(num_slots, dtype=np.int64),
        np.arange(num_slots) / fps,
        np.searchsorted(slots[order], np.arange(num_slots + 1)).astype(np.int64),
        np.where(scores[..., None] > 0, keypoints[order], np.nan),
        scores,
    )
