"""Detectors like OpenPose: heatmaps and part-affinity fields, decoded into people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats, Integers
from e3pose.base.errors import InputError
from e3pose.detectors.base import Image, check_image, poses_in_image
from e3pose.detectors.fit import Fit, letterbox, letterbox_to_side, stretch
from e3pose.detectors.focus import InParts, Part
from e3pose.detectors.inference import Network, check_image_input
from e3pose.detectors.topology import Topology
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D

# Decode heatmaps and part-affinity fields: peaks, then limbs, then people.
#
# The bottom-up method of Cao et al., "Realtime multi-person 2D pose estimation using part affinity
# fields" (2017), over any `Topology`.

Maps = NDArray[np.float32]

MAX_PEAKS = 64  # of one part; bounds the work on noise
# What is added to a heatmap where a joint is expected, and as how wide a spot beyond the reach of
# the prediction: networks of this kind are trained with spots of 7 pixels, 0.9 cells.
HEAT = 0.1
SPOT_CELLS = 0.9
NINE_OF_TEN = 2.146  # the 90 % distance over sigma, of a normal error in the image


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Where people are expected.

    Attributes:
        places: `(num_people, num_parts, 2)` map cells; NaN where unknown.
        reach: `(num_people,)` cells that nine of ten parts are off at most.
    """

    places: Floats
    reach: Floats


def decode(
    heatmaps: Maps, affinity: Maps, topology: Topology, prior: Prior | None = None
) -> tuple[Floats, Floats]:
    """Find the people in a network's maps.

    Args:
        heatmaps: `(num_parts, height, width)`, about 1 where a part is.
        affinity: `(num_affinity, height, width)` components of unit vectors along limbs.
        topology: what the channels mean.
        prior: who is expected; their joints are added to the heatmaps before peaks are sought. The
            field alone says what is a limb.

    Returns:
        `(num_persons, num_parts, 2)` map cells, counted from cell centres, NaN where missing, and
        `(num_persons, num_parts)` scores, 0 where missing; the most complete person first.
    """
    if prior is not None and len(prior.places):
        heatmaps = heatmaps + expected_heat(prior, heatmaps.shape[1:])
    parts, cells, scores = find_peaks(
        heatmaps, topology.upsample, topology.blur_cells, topology.peak_threshold
    )
    limbs, first, second, strengths = score_limbs(parts, cells, affinity, topology)
    people = assemble(parts, limbs, first, second, strengths, len(topology.parts))
    people = people[(people >= 0).sum(axis=1) >= topology.min_parts]
    found = people >= 0
    keypoints = np.full((*people.shape, 2), np.nan)
    keypoints[found] = cells[people[found]]
    part_scores = np.zeros(people.shape)
    part_scores[found] = scores[people[found]]
    order = np.argsort(-part_scores.sum(axis=1), kind="stable")
    return keypoints[order], part_scores[order]


def expected_heat(prior: Prior, shape: tuple[int, ...]) -> Maps:
    """Return `(num_parts, height, width)`: heatmaps of expected joints, as a network would give.

    After Bultmann and Behnke, "Real-time multi-view 3D human pose estimation using semantic
    feedback to smart edge sensors" (RSS 2021). A joint's spot is as wide as its prediction may be
    off; where spots meet, the highest counts.

    Args:
        prior: who is expected.
        shape: height and width of the maps in cells.
    """
    sigma = np.hypot(SPOT_CELLS, prior.reach / NINE_OF_TEN)[:, None, None]
    sides = (np.arange(size) for size in shape[::-1])
    spots = [
        np.exp(
            -0.5 * np.nan_to_num((side - prior.places[..., axis, None]) / sigma, nan=np.inf) ** 2
        )
        for axis, side in enumerate(sides)
    ]  # (num_people, num_parts, width) and (num_people, num_parts, height)
    heat = (spots[1][..., None] * spots[0][..., None, :]).max(axis=0)
    return np.asarray(HEAT * heat, dtype=np.float32)


def find_peaks(
    heatmaps: Maps, upsample: int, blur_cells: float, threshold: float
) -> tuple[Integers, Floats, Floats]:
    """Find the local maxima of smoothed heatmaps.

    Returns:
        For every peak its part, `(num_peaks, 2)` x and y in map cells counted from cell centres, to
        a fraction of a cell, and its height clipped to 1. At most `MAX_PEAKS` of a part, highest
        first.
    """
    import cv2

    parts, cells, heights = [], [], []
    for part, heatmap in enumerate(heatmaps):
        if not heatmap.max() > threshold:
            continue
        smooth = np.asarray(heatmap, dtype=np.float32)
        if upsample > 1:
            smooth = np.asarray(
                cv2.resize(smooth, None, fx=upsample, fy=upsample, interpolation=cv2.INTER_CUBIC)
            )
        if blur_cells > 0:
            smooth = np.asarray(cv2.GaussianBlur(smooth, (0, 0), blur_cells))
        summits = (smooth >= cv2.dilate(smooth, np.ones((3, 3), np.uint8))) & (smooth > threshold)
        rows, columns = np.nonzero(summits)
        found = smooth[rows, columns]
        order = np.argsort(-found, kind="stable")[: 4 * MAX_PEAKS]
        rows, columns, found = rows[order], columns[order], found[order]
        refined = np.stack(
            [columns + _summit(smooth, rows, columns, 1), rows + _summit(smooth, rows, columns, 0)],
            axis=-1,
        )
        # Cells of one flat summit are one peak.
        keep = _apart(refined, radius=float(upsample))[:MAX_PEAKS]
        parts.append(np.full(len(keep), part))
        cells.append((refined[keep] + 0.5) / upsample - 0.5)
        heights.append(found[keep])
    if not parts:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0)
    return (
        np.concatenate(parts).astype(np.int64),
        np.concatenate(cells),
        np.clip(np.concatenate(heights).astype(np.float64), 0.0, 1.0),
    )


def score_limbs(
    parts: Integers, cells: Floats, affinity: Maps, topology: Topology
) -> tuple[Integers, Integers, Integers, Floats]:
    """Score every pair of peaks that could be a limb by the field along the line between them.

    Returns:
        Of the pairs that pass the topology's thresholds: limb, first peak, second peak, strength.
    """
    members = [np.flatnonzero(parts == part) for part in range(len(topology.parts))]
    sizes = [len(members[a]) * len(members[b]) for a, b, _, _ in topology.limbs]
    limb = np.repeat(np.arange(len(topology.limbs)), sizes)
    first = np.concatenate(
        [np.repeat(members[a], len(members[b])) for a, b, _, _ in topology.limbs]
    )
    second = np.concatenate([np.tile(members[b], len(members[a])) for a, b, _, _ in topology.limbs])
    along = cells[second] - cells[first]
    length = np.linalg.norm(along, axis=-1)
    steps = np.linspace(0.0, 1.0, topology.samples)
    points = cells[first][:, None] + steps[:, None] * along[:, None]  # (num_pairs, samples, 2)
    channels = np.asarray(topology.limbs)[:, 2:]
    field = _bilinear(affinity, channels[limb], points)  # (num_pairs, samples, 2)
    direction = along / np.maximum(length, 1e-9)[:, None]
    dots = (field * direction[:, None]).sum(axis=-1)
    # A limb longer than half the image is unlikely; the farther beyond, the more.
    strength = dots.mean(axis=-1) + np.minimum(
        0.5 * affinity.shape[1] / np.maximum(length, 1e-9) - 1.0, 0.0
    )
    passed = (
        ((dots > topology.sample_threshold).sum(axis=-1) >= topology.min_samples)
        & (dots.mean(axis=-1) > topology.min_mean)
        & (strength > 0)
        & (length > 0)
    )
    return limb[passed], first[passed], second[passed], strength[passed]


def assemble(
    parts: Integers,
    limbs: Integers,
    first: Integers,
    second: Integers,
    strengths: Floats,
    num_parts: int,
) -> Integers:
    """Join peaks into people, strongest limb first.

    A limb is taken if neither of its peaks has that limb yet and the two people it would join have
    no part in common.

    Returns:
        `(num_people, num_parts)` peak of each part, -1 where missing.
    """
    owner: dict[int, dict[int, int]] = {}  # peak to its person, who is {part: peak}
    used: set[tuple[int, int, int]] = set()
    for pair in np.argsort(-strengths, kind="stable"):
        limb, a, b = int(limbs[pair]), int(first[pair]), int(second[pair])
        if (limb, 0, a) in used or (limb, 1, b) in used:
            continue
        one = owner.setdefault(a, {int(parts[a]): a})
        other = owner.setdefault(b, {int(parts[b]): b})
        if one is not other:
            if one.keys() & other.keys():
                continue
            one.update(other)
            for peak in other.values():
                owner[peak] = one
        used |= {(limb, 0, a), (limb, 1, b)}
    unique = {id(person): person for person in owner.values()}
    people = np.full((len(unique), num_parts), -1, dtype=np.int64)
    for row, person in enumerate(unique.values()):
        people[row, list(person)] = list(person.values())
    return people


def _summit(smooth: Maps, rows: Integers, columns: Integers, axis: int) -> Floats:
    """Offset of the vertex of the parabola through a maximum and its two neighbours, in cells."""
    index, size = (rows, columns)[axis], smooth.shape[axis]
    before, after = np.clip(index - 1, 0, size - 1), np.clip(index + 1, 0, size - 1)
    if axis == 0:
        low, high = smooth[before, columns], smooth[after, columns]
    else:
        low, high = smooth[rows, before], smooth[rows, after]
    bend = (low - 2.0 * smooth[rows, columns] + high).astype(np.float64)
    offset = np.where(bend < 0, 0.5 * (low - high) / np.where(bend < 0, bend, -1.0), 0.0)
    return np.where((index > 0) & (index < size - 1), np.clip(offset, -0.5, 0.5), 0.0)


def _apart(points: Floats, radius: float) -> Integers:
    """Indices of the points that no earlier kept point is within `radius` of."""
    near = np.linalg.norm(points[:, None] - points[None], axis=-1) <= radius
    kept: list[int] = []
    for index in range(len(points)):
        if not near[index, kept].any():
            kept.append(index)
    return np.asarray(kept, dtype=np.int64)


def _bilinear(maps: Maps, channels: Integers, points: Floats) -> Floats:
    """Read `(num_pairs, 2)` channels at `(num_pairs, samples, 2)` cells, giving that shape."""
    height, width = maps.shape[1:]
    x = np.clip(points[..., 0], 0, width - 1)
    y = np.clip(points[..., 1], 0, height - 1)
    column = np.minimum(x.astype(np.int64), max(width - 2, 0))
    row = np.minimum(y.astype(np.int64), max(height - 2, 0))
    right, below = np.minimum(column + 1, width - 1), np.minimum(row + 1, height - 1)
    fx, fy = (x - column)[..., None], (y - row)[..., None]
    channel = channels[:, None, :]
    row, below, column, right = (index[..., None] for index in (row, below, column, right))
    top = maps[channel, row, column] * (1 - fx) + maps[channel, row, right] * fx
    bottom = maps[channel, below, column] * (1 - fx) + maps[channel, below, right] * fx
    value: Floats = top * (1 - fy) + bottom * fy
    return value


# tuned: px | lab/experiments/2026-11-27-crops-of-people.md: of the demo's videos and pizza, in
#   parts and crops | 200, as in its training: a quarter more pixels, 5 % less noise
PERSON_PX = 150.0
PAD = 0  # both networks saw black beyond the border in training


class OpenPose(InParts):
    """A network with part heatmaps and part-affinity fields.

    Args:
        network: takes `(1, 3, height, width)` float32.
        topology: what its channels mean and how to read them.

    Raises:
        InputError: when the network's input or outputs are not those of the topology.
    """

    def __init__(self, network: Network, topology: Topology) -> None:
        check_image_input(network, topology.name, ("float",))
        declared = [output[1] for output in network.output_shapes if len(output) == 4]
        for count in topology.outputs:
            if count not in declared and None not in declared:
                raise _mismatch(network, topology, [list(shape) for shape in network.output_shapes])
        self.skeleton = topology.skeleton
        self._network = network
        self.provider, self.threads = network.provider, network.threads
        self._topology = topology
        self.person_px, self.long_side = PERSON_PX, topology.long_side
        self.multiple = topology.multiple
        self.free_input = topology.keep_proportions and None in network.input_shape[2:]
        self._joints = [topology.parts.index(joint) for joint in self.skeleton.joints]

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """See `Focusing.detect_part`."""
        check_image(image)
        fit = self._fit(part)
        pixels = fit.apply(part.cut(image), PAD)
        row = self._topology
        if row.bgr:
            pixels = pixels[..., ::-1]
        mean, deviation = (np.asarray(v, dtype=np.float32) for v in (row.mean, row.deviation))
        tensor = np.ascontiguousarray(((pixels - mean) / deviation).transpose(2, 0, 1)[None])
        maps = self._maps(tensor)
        parts = len(self._topology.parts)
        heatmaps, affinity = maps[:parts], maps[self._topology.affinity_start :]
        stride = np.asarray(fit.input_size) / (maps.shape[2], maps.shape[1])
        prior = None if expected is None else self._prior(expected, part, fit, stride)
        cells, scores = decode(heatmaps, affinity, self._topology, prior)
        keypoints = fit.to_image((cells + 0.5) * stride - 0.5)
        found = poses_in_image(keypoints[:, self._joints], scores[:, self._joints], part.size)
        return part.in_image(found)

    def _prior(self, expected: ExpectedView, part: Part, fit: Fit, stride: Any) -> Prior | None:
        """Return in map cells who is expected; None of another skeleton's."""
        points = expected.keypoints_px
        if points.shape[1] != len(self.skeleton):
            return None
        places = np.full((len(points), len(self._topology.parts), 2), np.nan)
        inputs = fit.to_input(points - (part.left, part.top))
        places[:, self._joints] = (inputs + 0.5) / stride - 0.5
        scale = fit.content_size[0] / fit.image_size[0] / float(np.mean(stride))
        return Prior(places, expected.reach_px * scale)

    def _fit(self, part: Part) -> Fit:
        row, size = self._topology, part.size
        height, width = self._network.input_shape[2:]
        if height is None or width is None:
            if row.keep_proportions:
                return letterbox_to_side(size, part.long_side, row.multiple)
            return stretch(size, (part.long_side, part.long_side))
        return (letterbox if row.keep_proportions else stretch)(size, (width, height))

    def _maps(self, tensor: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return all outputs as one `(channels, height, width)`, in the order of the topology."""
        outputs = self._network.run(tensor)
        by_channels: dict[int, NDArray[Any]] = {
            output.shape[1]: output for output in outputs if output.ndim == 4
        }
        found = [output.shape for output in outputs]
        wanted = self._topology.outputs
        chosen = [by_channels[count] for count in wanted if count in by_channels]
        if len(chosen) != len(wanted) or len({output.shape[2:] for output in chosen}) != 1:
            raise self._error(found)
        maps = np.concatenate([output[0] for output in chosen])
        if not np.isfinite(maps).all():
            raise InputError(f"{self._network.path}: output: found values that are not finite")
        return np.asarray(maps, dtype=np.float32)

    def _error(self, found: Any) -> InputError:
        return _mismatch(self._network, self._topology, found)


def _mismatch(network: Network, topology: Topology, found: Any) -> InputError:
    wanted = " and ".join(f"[1, {count}, height, width]" for count in topology.outputs)
    return InputError(
        f"{network.path}: output: found {found}, expected {wanted} for {topology.name}"
    )
