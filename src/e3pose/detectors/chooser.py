"""The one chooser of the network, for every verb that is not told which."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from e3pose.base.quantities import shell
from e3pose.detectors.inference import PROVIDERS
from e3pose.detectors.weights import BOXES, MODELS, is_installed, networks

AUTO = "auto"  # in the place of a name: choose
# The best first: feet before none, then by the AP on COCO that their publishers state; of the last
# two as measured on the demo's clip (docs/reference/networks.md).
ORDER = (
    "rtmpose-halpe26", "rtmw-133", "rtmo-l", "rtmpose-body", "rtmo-m", "rtmo-s", "rtmo-t",
    "movenet-multipose", "openpose-thin",
)  # fmt: skip
QUICK = ("movenet-multipose", "openpose-thin")  # fast enough for live cameras without a GPU
GPU_DEVICES = ("/dev/nvidiactl", "/dev/nvhost-gpu", "/dev/nvhost-ctrl-gpu")


@dataclass(frozen=True, slots=True)
class Choice:
    """A network, and why it was chosen.

    Attributes:
        name: of the network.
        why: in words.
        installed: whether its weights are here.
        others: what else could be fetched, the next best first.
    """

    name: str
    why: str
    installed: bool
    others: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"network: {self.name}, {self.why}"


def choose_network(live: bool, gpu: bool | None = None) -> Choice:
    """Choose the best network that is here, else the best that can be fetched.

    Only networks of the catalogue's checksums are fetched unasked.

    Args:
        live: cameras wait for it, so that without a GPU only `QUICK` ones come into question.
        gpu: whether there is one that ONNX Runtime can use; looked for if None.
    """
    gpu = has_gpu() if gpu is None else gpu
    able = ORDER if gpu or not live else QUICK
    known = networks()
    here = [name for name in known if known[name].family != BOXES and is_installed(name)]
    best = [name for name in able if name in here]
    if best:
        why = "the best of those installed" if len(here) > 1 else "the only one installed"
        better = [name for name in QUICK if ORDER.index(name) < ORDER.index(best[0])]
        hint = f"; better: e3pose models pull {shell(better[0])}" if better else ""
        return Choice(best[0], f"{why}{hint}", True)
    own = [name for name in here if name not in ORDER]
    if own:
        return Choice(own[0], "the only one installed, your own", True)
    wanted = [name for name in able if MODELS[name].sha256 and (gpu or name in QUICK)]
    on = "a GPU" if gpu else "a CPU"
    return Choice(wanted[0], f"the best to fetch for {on}", False, tuple(wanted[1:]))


def has_gpu() -> bool:
    """Return whether ONNX Runtime has a provider for a GPU of NVIDIA, and there seems to be one."""
    if not shutil.which("nvidia-smi") and not any(Path(file).exists() for file in GPU_DEVICES):
        return False
    try:
        import onnxruntime
    except ImportError:
        return False
    return PROVIDERS["cuda"] in onnxruntime.get_available_providers()
