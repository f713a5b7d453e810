"""A detector for films of simulated people, which costs what a network does.

Networks find nobody in such films. This one runs MoveNet on each image for the work that it is,
and returns the people who are drawn. Named to a camera as FILE:drawn_by_network, with MoveNet's
weights as its model.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from e3pose.detectors import make_detector
from e3pose.detectors.base import Image
from e3pose.detectors.drawn import Drawn
from e3pose.detectors.focus import Part, detect_expected
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import Poses2D

NETWORK = "movenet-multipose"


class DrawnByNetwork:
    """Finds who is drawn, after a network has looked."""

    def __init__(self, network: Any) -> None:
        self._network, self._drawn = network, Drawn()
        self.skeleton = self._drawn.skeleton
        self.person_px, self.long_side = network.person_px, network.long_side
        self.multiple = network.multiple

    def detect(self, image: Image) -> Poses2D:
        """Look at a whole image."""
        self._network.detect(image)
        return self._drawn.detect(image)

    def detect_part(
        self, image: Image, part: Part, expected: ExpectedView | None = None
    ) -> Poses2D:
        """Look at a part of an image; see `Focusing.detect_part`.

        Where the network looks at crops, dots are read in the part, as few are left of them there.
        """
        detect_expected(self._network, image, expected)
        return self._drawn.detect_part(image, part, expected)


def drawn_by_network(model: Path | None, provider: str, threads: int | None) -> DrawnByNetwork:
    """Return the detector."""
    return DrawnByNetwork(make_detector(NETWORK, model, provider, threads))
