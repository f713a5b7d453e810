"""Recordings that the paper's evaluation needs, as far as the user has them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.detectors.weights import is_installed
from e3pose.recording import Recording, load_recording
from e3pose.recording.folder import HEADER
from e3pose.site.demo_clip import find_clip
from e3pose_lab.datasets.panoptic import import_panoptic
from e3pose_lab.datasets.shelf import import_shelf

SHELF, PANOPTIC = "shelf", "panoptic"
SHELF_FEEDBACK, PIZZA = "shelf-feedback", "pizza"
CLIP, NETWORK = "clip", "openpose-thin"
SHELF_FILE = "shelf.npz"
FRAGMENT_FILE = "160906_band1.npz"
MOTION_FILE = "171026_pose3_train.npz"
WHERE = {
    SHELF: "Shelf with OpenPose detections: DATA/shelf, a recording or shelf.npz, see "
    "docs/reference/import-formats.md",
    SHELF_FEEDBACK: "Shelf as e3pose detect --feedback sees it: DATA/shelf-feedback, a recording, "
    "see docs/how-to/reproduce.md",
    PIZZA: "160906_pizza1 of CMU Panoptic with OpenPose's detections: DATA/pizza, a recording",
    PANOPTIC: "fragments of CMU Panoptic (domedb.perception.cs.cmu.edu): DATA/panoptic with "
    f"{FRAGMENT_FILE} and {MOTION_FILE}",
    CLIP: "the four videos of the demo, which `e3pose demo` fetches",
    NETWORK: f"the network {NETWORK}, which `e3pose models pull {NETWORK}` fetches",
}


@dataclass(frozen=True, slots=True, eq=False)
class Sources:
    """Data sets at hand.

    Attributes:
        shelf: the Shelf sequence with detections and labels; None if it was not found.
        feedback: the same with detections made with semantic feedback.
        pizza: a test sequence of the paper with detections, without truth.
        panoptic: three people on Panoptic's five cameras, truth alone.
        motion: one person's real motion on the same cameras, truth alone.
        stamp: a digest of the files.
        broken: why data that are there could not be read, by data set.
    """

    shelf: Recording | None = None
    feedback: Recording | None = None
    pizza: Recording | None = None
    panoptic: Recording | None = None
    motion: Recording | None = None
    stamp: str = ""
    broken: Mapping[str, str] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Which data sets there are."""
        there = {
            SHELF: self.shelf is not None,
            SHELF_FEEDBACK: self.feedback is not None,
            PIZZA: self.pizza is not None,
            PANOPTIC: self.panoptic is not None and self.motion is not None,
            CLIP: find_clip() is not None,
            NETWORK: is_installed(NETWORK),
        }
        return tuple(name for name, found in there.items() if found)

    @property
    def detectors(self) -> dict[str, str]:
        """Detectors of the keypoints of Shelf, by data set, where the recording names one."""
        found = {SHELF: self.shelf, SHELF_FEEDBACK: self.feedback}
        return {name: each.detector for name, each in found.items() if each and each.detector}


def load_sources(folder: Path | None) -> Sources:
    """Load what a folder has.

    Args:
        folder: holds `shelf`, `shelf-feedback`, `pizza` and `panoptic`, or some of them; nothing
            is looked for if None.

    Raises:
        InputError: when the folder does not exist. Broken files are named in the result.
    """
    if folder is None:
        return Sources()
    if not folder.is_dir():
        raise InputError("data", str(folder), "a folder with shelf, pizza and panoptic in it")
    digest = hashlib.sha256()
    for path in _files(folder):
        digest.update(path.read_bytes())
    fragment, motion = (folder / PANOPTIC / name for name in (FRAGMENT_FILE, MOTION_FILE))
    both = fragment.exists() and motion.exists()
    broken: dict[str, str] = {}

    def read(name: str, load: Callable[[], Recording | None]) -> Recording | None:
        try:
            return load()
        except InputError as error:
            broken[name] = str(error)
            return None

    return Sources(
        shelf=read(SHELF, lambda: _shelf(folder / SHELF)),
        feedback=read(SHELF_FEEDBACK, lambda: _shelf(folder / SHELF_FEEDBACK)),
        pizza=read(PIZZA, lambda: _recording(_pizza(folder))),
        panoptic=read(PANOPTIC, lambda: import_panoptic(fragment)) if both else None,
        motion=read(PANOPTIC, lambda: _motion(motion, fragment)) if both else None,
        stamp=digest.hexdigest()[:16],
        broken=broken,
    )


def _shelf(folder: Path) -> Recording | None:
    shelf = folder / SHELF_FILE
    return import_shelf(shelf) if shelf.exists() else _recording(folder)


def _pizza(folder: Path) -> Path:
    """Return the folder of the recording, which may be inside that of the data set."""
    inside = folder / PIZZA / "recording"
    return inside if inside.is_dir() else folder / PIZZA


def _recording(folder: Path) -> Recording | None:
    return load_recording(folder) if (folder / HEADER).exists() else None


def _motion(path: Path, fragment: Path) -> Recording:
    return import_panoptic(path, calibration=fragment)


def _files(folder: Path) -> Iterator[Path]:
    places = (folder / SHELF, folder / SHELF_FEEDBACK, folder / PANOPTIC, _pizza(folder))
    for place in places:
        found = (*place.glob("*"), *place.glob("keypoints/*"))
        yield from sorted(path for path in found if path.is_file())
