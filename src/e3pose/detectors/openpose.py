"""Detectors like OpenPose: heatmaps and part-affinity fields, decoded into people."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.detectors.base import Image, check_image, poses_in_image
from e3pose.detectors.fit import Fit, letterbox, letterbox_to_side, stretch
from e3pose.detectors.focus import InParts, Part
from e3pose.detectors.inference import Network, check_image_input
from e3pose.detectors.part_affinity import Prior, decode
from e3pose.detectors.topology import Topology
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D

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
        check_maps(network, topology)
        self.skeleton = topology.skeleton
        self._network, self.provider = network, network.provider
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
        maps = self._maps(self._tensor(fit.apply(part.cut(image), PAD)))
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

    def _tensor(self, pixels: Image) -> NDArray[np.float32]:
        row = self._topology
        if row.bgr:
            pixels = pixels[..., ::-1]
        mean, deviation = (np.asarray(v, dtype=np.float32) for v in (row.mean, row.deviation))
        return np.ascontiguousarray(((pixels - mean) / deviation).transpose(2, 0, 1)[None])

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


def check_maps(network: Network, topology: Topology) -> None:
    """Raise `InputError` unless the network's declared shapes can be those of `topology`."""
    check_image_input(network, topology.name, ("float",))
    declared = [output[1] for output in network.output_shapes if len(output) == 4]
    for count in topology.outputs:
        if count not in declared and None not in declared:
            raise _mismatch(network, topology, [list(shape) for shape in network.output_shapes])


def _mismatch(network: Network, topology: Topology, found: Any) -> InputError:
    wanted = " and ".join(f"[1, {count}, height, width]" for count in topology.outputs)
    return InputError(
        f"{network.path}: output: found {found}, expected {wanted} for {topology.name}"
    )
