"""Person boxes from outputs `dets` and `labels` of MMDeploy's detectors: RTMDet and YOLOX.

Lyu et al., "RTMDet: An Empirical Study of Designing Real-Time Object Detectors", 2022; Ge et al.,
"YOLOX: Exceeding YOLO Series in 2021". The exported networks suppress overlapping boxes themselves
(`detection_onnxruntime_static`). RTMDet's images are normalised, YOLOX's are not. Nothing else in
the two files differs in name or shape but what the image goes through first: RTMDet's convolution,
or the slices from which YOLOX makes four images of half the size.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.detectors.base import Image
from e3pose.detectors.fit import letterbox
from e3pose.detectors.inference import FLOATS, Network
from e3pose.detectors.onnx_bytes import first_operators

SIDE = 320  # pixels, where the network leaves it free: RTMDet-nano's
GREY = 114  # beyond the image, as in training
MEAN_BGR = np.array([103.53, 116.28, 123.675], dtype=np.float32)
DEVIATION_BGR = np.array([57.375, 57.12, 58.395], dtype=np.float32)
RTMDET, YOLOX = "Conv", "Slice"  # the operator that reads the image
PERSON = 0  # of COCO's labels
PERSON_SCORE = 0.3  # of the publisher's example
MAX_PEOPLE = 20  # each costs a run of the keypoint network


class PersonBoxes:
    """Float `(1, 3, height, width)` BGR in; `(1, N, 5)` boxes with a score and `(1, N)` labels out.

    The input of RTMDet is normalised, that of YOLOX is 0..255; boxes are x, y of two corners in
    pixels of the input.

    Raises:
        InputError: when the network's input or outputs are others.
    """

    def __init__(self, network: Network) -> None:
        self._network = network
        shape, outputs = network.input_shape, network.output_shapes
        boxes = [i for i, s in enumerate(outputs) if len(s) == 3 and s[2] in (5, None)]
        labels = [i for i, s in enumerate(outputs) if len(s) == 2]
        image = len(shape) == 4 and shape[1] in (3, None) and network.input_dtype in FLOATS
        if not (image and len(outputs) == 2 and boxes and labels):
            found = f"input {list(shape)}, outputs {[list(output) for output in outputs]}"
            raise InputError(
                str(network.path), found, "float [1, 3, H, W], dets [1, N, 5] and labels [1, N]"
            )
        self._boxes, self._labels = boxes[0], labels[0]
        first = first_operators(network.path)
        if not first & {RTMDET, YOLOX}:
            found = f"an image that is first read by {', '.join(sorted(first)) or 'nothing'}"
            wanted = f"{RTMDET} as in RTMDet, or {YOLOX} as in YOLOX"
            raise InputError(str(network.path), found, wanted)
        self._normalised = YOLOX not in first

    def find(self, image: Image) -> NDArray[np.float64]:
        """Return `(num_persons, 4)` x, y of two corners in pixels of an RGB image.

        By falling score; measured from the outer edge of the first pixel.
        """
        height, width = self._network.input_shape[2:]
        fit = letterbox((image.shape[1], image.shape[0]), (width or SIDE, height or SIDE))
        pixels = fit.apply(image, GREY)[..., ::-1].astype(np.float32)
        if self._normalised:
            pixels = (pixels - MEAN_BGR) / DEVIATION_BGR
        tensor = pixels.transpose(2, 0, 1)[None].astype(FLOATS[self._network.input_dtype])
        outputs = self._network.run(np.ascontiguousarray(tensor))
        boxes, labels = outputs[self._boxes], outputs[self._labels]
        if boxes.ndim != 3 or boxes.shape[2] != 5 or labels.shape != boxes.shape[:2]:
            raise self._error([boxes.shape, labels.shape])
        rows = boxes[0].astype(np.float64)
        kept = (labels[0] == PERSON) & (rows[:, 4] > PERSON_SCORE) & np.isfinite(rows).all(axis=1)
        rows = rows[kept]
        rows = rows[np.argsort(-rows[:, 4], kind="stable")][:MAX_PEOPLE]
        corners = fit.to_image(rows[:, :4].reshape(-1, 2, 2) - 0.5) + 0.5
        return corners.reshape(-1, 4)

    def _error(self, shapes: Any) -> InputError:
        found = f"outputs {[list(shape) for shape in shapes]}"
        return InputError(str(self._network.path), found, "dets [1, N, 5] and labels [1, N]")
