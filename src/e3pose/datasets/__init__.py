"""Importers: other formats in, a recording out."""

from collections.abc import Callable

from e3pose.datasets.coco import import_coco
from e3pose.datasets.motion import import_cmu
from e3pose.datasets.openpose import import_openpose
from e3pose.datasets.panoptic import import_panoptic
from e3pose.datasets.shelf import import_shelf
from e3pose.recording import Recording

IMPORTERS: dict[str, Callable[..., Recording]] = {
    "shelf": import_shelf,
    "panoptic": import_panoptic,
    "openpose": import_openpose,
    "coco": import_coco,
    "cmu": import_cmu,
}
