"""The noise files that come with the package, one per detector, and those of users."""

from __future__ import annotations

from pathlib import Path

from e3pose.files.shipped import read_shipped
from e3pose.model.noise import Noise
from e3pose.model.noises.file import NoiseFile, decode_noise

DEFAULT = "unknown"  # of a recording that does not say what detected it
# By detector, and the words by which the source of a recording names it, the longest first.
SHIPPED = {
    "simulated": ("simulated by e3pose",),
    "openpose-thin": ("openpose-thin",),
    "movenet-multipose": ("movenet-multipose", "movenet"),
    "yolo-pose": ("yolo-pose", "yolo"),
    "trt-pose": ("trt-pose", "trt_pose"),
    "rtmlib": ("rtmlib", "rtmpose", "rtmo"),
    "openpose": ("openpose",),
    DEFAULT: (),
}
MAX_BYTES = 1_000_000


def detector_of(source: str) -> str:
    """Return the detector that the source of a recording names, or `DEFAULT`."""
    text = source.lower()
    for name, words in SHIPPED.items():
        if any(word in text for word in words):
            return name
    return DEFAULT


def load_noise(name_or_path: str | Path) -> Noise:
    """Load the noise of a detector: one of `SHIPPED`, or a TOML file of the user's own.

    Raises:
        InputError: naming the file and the field that is wrong.
    """
    return load_noise_file(name_or_path).noise()


def load_noise_file(name_or_path: str | Path) -> NoiseFile:
    """Load a noise file with all that it says; see `load_noise`."""
    return decode_noise(
        *read_shipped(name_or_path, "e3pose.model.noises", SHIPPED, "noise", MAX_BYTES)
    )
