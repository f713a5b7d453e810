"""RTMPose and RTMO through the optional package `rtmlib`, which brings its own weights."""

from __future__ import annotations

from typing import Any

import numpy as np

from e3pose.detectors.base import Image, check_image, poses_in_image
from e3pose.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

NAME = "rtmlib"
MIN_KEYPOINT_SCORE = 0.3
DEVICES = {"auto": "cpu", "cpu": "cpu", "cuda": "cuda"}


class RtmlibBody:
    """rtmlib's `Body` (a person detector, then RTMPose on each; or RTMO, which needs no detector).

    Args:
        body: an `rtmlib.Body` made with `to_openpose=False`.
    """

    def __init__(self, body: Any) -> None:
        self.skeleton = COCO17
        self._body = body

    def detect(self, image: Image) -> Poses2D:
        """Return the people in a `(height, width, 3)` RGB image, in its pixels."""
        size = check_image(image)
        bgr = np.ascontiguousarray(image[..., ::-1])
        if self._body.one_stage:
            keypoints, scores = self._body.pose_model(bgr)
        else:
            boxes = self._body.det_model(bgr)
            # Without a box, rtmlib's pose model takes the whole image for a person.
            if len(boxes) == 0:
                return Poses2D.empty(len(self.skeleton))
            keypoints, scores = self._body.pose_model(bgr, bboxes=boxes)
        if np.shape(keypoints)[1:] != (len(self.skeleton), 2):
            raise InputError(
                f"rtmlib: found keypoints of shape {np.shape(keypoints)}, expected "
                f"(num_persons, {len(self.skeleton)}, 2)"
            )
        return poses_in_image(keypoints, scores, size, MIN_KEYPOINT_SCORE)


def make_rtmlib(provider: str = "auto", mode: str = "balanced") -> RtmlibBody:
    """Load rtmlib's networks, which it downloads to a cache of its own the first time.

    Args:
        provider: `auto` and `cpu` run on the CPU, `cuda` on the GPU.
        mode: `lightweight`, `balanced` or `performance`.

    Raises:
        InputError: when rtmlib is not installed, cannot fetch its weights or has no such provider.
    """
    if provider not in DEVICES:
        raise InputError(f"provider: found {provider!r}, rtmlib has {', '.join(DEVICES)}")
    try:
        import rtmlib
    except ImportError:
        raise InputError(
            "detector rtmlib: the package rtmlib is not installed, expected `pip install rtmlib`"
        ) from None
    try:
        body = rtmlib.Body(
            mode=mode, to_openpose=False, backend="onnxruntime", device=DEVICES[provider]
        )
    except OSError as error:
        raise InputError(f"detector rtmlib: could not fetch its weights: {error}") from None
    return RtmlibBody(body)
