"""2D pose from pixels: a family of detectors behind one protocol."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.plugins import maker, member
from e3pose.base.system import num_cores
from e3pose.detectors.base import Detector as Detector
from e3pose.detectors.base import Image as Image
from e3pose.detectors.chooser import AUTO as AUTO
from e3pose.detectors.chooser import choose_network
from e3pose.detectors.drawn import Drawn
from e3pose.detectors.ecpose import EcPose, RfDetr
from e3pose.detectors.inference import SUFFIXES, Network, check_threads, load_network
from e3pose.detectors.movenet import MoveNet
from e3pose.detectors.openpose import OpenPose
from e3pose.detectors.rtmo import Rtmo
from e3pose.detectors.top_down import files_of, open_top_down
from e3pose.detectors.topology import TOPOLOGIES
from e3pose.detectors.weights import ENDINGS, find_weights, is_installed, networks
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
    "ecpose": (EcPose, COCO17),
    "rf-detr": (RfDetr, COCO17),
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
    return open_top_down(files_of(model), name, provider, threads)[1]


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
        name: a key of `DETECTORS`, a network of `weights.networks()`, `auto` for the one that
            `chooser` chooses, or the path of a network file, or of a folder with the two of a
            top-down detector, whose kind then follows from inputs and outputs.
        model: a network file to use instead of the one that `name` has in the user's cache.
        provider: `auto` for the first of `inference.PROVIDERS` that is there, or one of them,
            which must then be there.
        threads: CPU threads for the network; None uses all cores.

    Raises:
        InputError: when the name is unknown, the weights are not there or not what they should be,
            or the provider cannot be had.
    """
    name = chosen_name(name, model)
    if model is None:
        known = networks().get(name)
        if known is not None and known.source is not None:
            files = [find_weights(each) for each in (known.boxes, name) if each]
            family = known.family if known.family in DETECTORS else identify(files[-1])
            if known.boxes and not files[-1].is_dir():
                return open_top_down(files, family, provider, threads)[1]
            name, model = family, files[-1]
        elif name not in DETECTORS and is_network(Path(name)):
            name, model = identify(Path(name)), Path(name)
    more = f", the path of an {SUFFIXES} file"
    return maker(GROUP, "detector", name, DETECTORS, more)(model, provider, threads)


def chosen_name(name: str, model: Path | None = None, live: bool = True) -> str:
    """Return a detector's name where it is `auto`: that of its file, or the chooser's choice."""
    if name != AUTO:
        return name
    return choose_network(live).name if model is None else identify(model)


def side_by_side(load: Callable[[int | None], Detector], threads: int | None = None) -> Detector:
    """Return a detector for several looks at a time, each on one thread, where that is possible.

    Args:
        load: loads it for so many CPU threads a look; None for all cores.
        threads: of a look, where one goes on at a time.
    """
    made = load(1)
    if threads == 1 or threads_of(made) is not None:
        return made
    del made  # a device may be there once
    return load(threads)


def threads_of(detector: Detector) -> int | None:
    """Return `Network.threads` of a detector's network; None also where it does not say."""
    threads = getattr(detector, "threads", None)
    return threads if isinstance(threads, int) else None


def looks_at_a_time(detectors: Iterable[Detector], threads: int | None = None) -> int:
    """Return how many looks may go on at a time on so many CPU threads; None for all cores."""
    check_threads(threads)
    threads = threads or num_cores()
    each = [threads_of(detector) or threads for detector in detectors]
    return max(1, threads // max(each, default=1))


def is_network(path: Path) -> bool:
    """Return whether a path is meant as the file of a network, or the folder of several."""
    return path.suffix in ENDINGS or path.is_file() or any(path.glob("*.onnx"))


def identify(path: Path) -> str:
    """Tell which detector a network file, or a folder of two, is for from inputs and outputs.

    Raises:
        InputError: when it is for none.
    """
    if path.is_dir():
        return open_top_down(files_of(path), provider="cpu", threads=1)[0]
    if path.suffix == ".pb":
        return "openpose-thin"  # the only one published as a TensorFlow graph
    network = load_network(path, "cpu", 1)
    for name, (make, _) in NETWORKS.items():
        try:
            make(network)
        except InputError:
            continue
        return name
    raise InputError(
        f"{path}: found input {list(network.input_shape)} and outputs "
        f"{[list(shape) for shape in network.output_shapes]}, expected a network of one of "
        f"{', '.join(NETWORKS)}"
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
    name = chosen_name(name, model)
    known = networks().get(name)
    if known is not None and known.source is not None:
        if known.family in SKELETONS or not is_installed(name):
            return SKELETONS.get(known.family)
        return make_detector(name, None, "cpu", 1).skeleton
    path = Path(name) if name not in DETECTORS and is_network(Path(name)) else model
    if name not in DETECTORS and path in (None, model):
        found = member(GROUP, "detector", name, DETECTORS)
        stated = getattr(found, "skeleton", None)
        made = found if isinstance(stated, Skeleton) else make_detector(name, model)
        skeleton = getattr(made, "skeleton", None)
        return skeleton if isinstance(skeleton, Skeleton) else None
    if name in SKELETONS or path is None or not path.exists():
        return SKELETONS.get(name)
    return make_detector(str(path), None, "cpu", 1).skeleton
