"""2D pose from pixels: a family of detectors behind one protocol."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.plugins import maker, member
from e3pose.detectors.base import Detector as Detector
from e3pose.detectors.base import Image as Image
from e3pose.detectors.drawn import Drawn
from e3pose.detectors.ecpose import EcPose
from e3pose.detectors.inference import SUFFIXES, Network, load_network
from e3pose.detectors.movenet import MoveNet
from e3pose.detectors.openpose import OpenPose, check_maps
from e3pose.detectors.rtmo import Rtmo
from e3pose.detectors.top_down import open_top_down
from e3pose.detectors.topology import TOPOLOGIES
from e3pose.detectors.weights import find_weights
from e3pose.detectors.yolo import YoloPose
from e3pose.model.skeleton import COCO17, COCO18, Skeleton

Factory = Callable[[Path | None, str, int | None], Detector]

__all__ = ["DETECTORS", "Detector", "Image", "identify", "make_detector"]

# What each makes of its network, and the skeleton of its poses.
NETWORKS: dict[str, tuple[Callable[[Network], Detector], Skeleton]] = {
    "movenet-multipose": (MoveNet, COCO17),
    "openpose-thin": (partial(OpenPose, topology=TOPOLOGIES["openpose-thin"]), COCO18),
    "trt-pose": (partial(OpenPose, topology=TOPOLOGIES["trt-pose"]), COCO18),
    "yolo-pose": (YoloPose, COCO17),
    "rtmo": (Rtmo, COCO17),
    "rtmo-m": (Rtmo, COCO17),
    "rtmo-l": (Rtmo, COCO17),
    "ecpose": (EcPose, COCO17),
}


def _of_one_network(name: str, model: Path | None, provider: str, threads: int | None) -> Detector:
    make, _ = NETWORKS[name]
    path = find_weights(name) if model is None else model
    return make(load_network(path, provider, threads, known=model is None))


def _drawn(model: Path | None, provider: str, threads: int | None) -> Detector:
    return Drawn()


def _top_down(name: str, model: Path | None, provider: str, threads: int | None) -> Detector:
    if model is None:
        raise InputError("model", "none", f"the folder with the two networks of {name}")
    return open_top_down(model, name, provider, threads)[1]


GROUP = "e3pose.detectors"  # the entry points of other packages
DETECTORS: dict[str, Factory] = {
    **{name: partial(_of_one_network, name) for name in NETWORKS},
    "rtmpose": partial(_top_down, "rtmpose"),
    "vitpose": partial(_top_down, "vitpose"),
    "drawn": _drawn,
}

# What each outputs, where that is known before its weights are there.
SKELETONS = {name: skeleton for name, (_, skeleton) in NETWORKS.items()} | {"drawn": COCO17}


def make_detector(
    name: str, model: Path | None = None, provider: str = "auto", threads: int | None = None
) -> Detector:
    """Load a detector.

    Args:
        name: a key of `DETECTORS`, or the path of a network file, or of a folder with the two of a
            top-down detector, whose kind then follows from inputs and outputs.
        model: a network file to use instead of the one that `name` has in the user's cache.
        provider: `auto` for the first of `inference.PROVIDERS` that is there, or one of them,
            which must then be there.
        threads: CPU threads for the network; None uses all cores.

    Raises:
        InputError: when the name is unknown, the weights are not there or not what they should be,
            or the provider cannot be had.
    """
    path = Path(name)
    if name not in DETECTORS and model is None and is_network(path):
        name, model = identify(path), path
    more = f", the path of an {SUFFIXES} file"
    return maker(GROUP, "detector", name, DETECTORS, more)(model, provider, threads)


def is_network(path: Path) -> bool:
    """Return whether a path is meant as the file of a network, or the folder of several."""
    return path.suffix in (".onnx", ".tflite", ".pb") or path.is_file() or any(path.glob("*.onnx"))


def identify(path: Path) -> str:
    """Tell which detector a network file, or a folder of two, is for from inputs and outputs.

    Raises:
        InputError: when it is for none.
    """
    if path.is_dir():
        return open_top_down(path, provider="cpu", threads=1)[0]
    if path.suffix == ".pb":
        return "openpose-thin"  # the only one published as a TensorFlow graph
    network = load_network(path, "cpu", 1)
    checks: dict[str, Callable[[], object]] = {
        "movenet-multipose": lambda: MoveNet(network),
        "yolo-pose": lambda: YoloPose(network),
        "rtmo": lambda: Rtmo(network),
        "ecpose": lambda: EcPose(network),
        **{name: partial(check_maps, network, row) for name, row in TOPOLOGIES.items()},
    }
    for name, check in checks.items():
        try:
            check()
        except InputError:
            continue
        return name
    raise InputError(
        f"{path}: found input {list(network.input_shape)} and outputs "
        f"{[list(shape) for shape in network.output_shapes]}, expected a network of one of "
        f"{', '.join(checks)}"
    )


def skeleton_of(name: str, model: Path | None = None) -> Skeleton | None:
    """Return the skeleton of a detector's poses; None where nothing says it before it runs.

    A detector of the user's own is made if its class does not have it.

    Args:
        name: as of `make_detector`.
        model: likewise.

    Raises:
        InputError: when a network file that says it cannot be used.
    """
    path = Path(name) if name not in DETECTORS and is_network(Path(name)) else model
    if name not in DETECTORS and path in (None, model):
        found = member(GROUP, "detector", name, DETECTORS)
        stated = getattr(found, "skeleton", None)
        made = found if isinstance(stated, Skeleton) else make_detector(name, model)
        skeleton = getattr(made, "skeleton", None)
        return skeleton if isinstance(skeleton, Skeleton) else None
    if name in SKELETONS or path is None or not path.exists():
        return SKELETONS.get(name)
    if not path.is_dir():
        return SKELETONS.get(identify(path))

    return open_top_down(path, provider="cpu", threads=1)[1].skeleton
