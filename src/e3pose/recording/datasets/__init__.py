"""Importers: other formats in, a recording out."""

from collections.abc import Callable

from e3pose.recording import Recording
from e3pose.recording.datasets.coco import import_coco
from e3pose.recording.datasets.human36m import import_human36m
from e3pose.recording.datasets.motion import import_cmu
from e3pose.recording.datasets.openpose import import_openpose
from e3pose.recording.datasets.panoptic import import_panoptic
from e3pose.recording.datasets.published import import_campus
from e3pose.recording.datasets.shelf import import_shelf

IMPORTERS: dict[str, Callable[..., Recording]] = {
    "shelf": import_shelf,
    "campus": import_campus,
    "human36m": import_human36m,
    "panoptic": import_panoptic,
    "openpose": import_openpose,
    "coco": import_coco,
    "cmu": import_cmu,
}
