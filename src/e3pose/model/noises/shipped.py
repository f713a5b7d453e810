"""Load a noise model: one of the package by detector, or a user's file."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from e3pose.base.bounded import read_shipped
from e3pose.model.noise import Noise
from e3pose.model.noises.file import FORMAT, VERSION, NoiseFile, decode_noise

DEFAULT = "unknown"  # of a recording that does not say what detected it
FILES = ("simulated", "openpose-thin", "movenet-multipose", "openpose")
# Detectors without a recording: how many times OpenPose's noise they are taken to have. That of the
# AI Camera is simulated (lab/benchmarks/sensor_noise.py), 1.5 is on the safe side.
MODEL_OF_ASSUMED = "openpose"
ASSUMED = {"imx500": 2.4, "yolo-pose": 1.5, "trt-pose": 1.5, "rtmlib": 1.5, DEFAULT: 1.5}
SHIPPED = (*FILES, *ASSUMED)
MAX_BYTES = 1_000_000


class Detected(Protocol):
    """A source of keypoints: a recording, or a live site."""

    @property
    def detector(self) -> str:
        """The name of the detector; empty where nobody gave one."""
        ...


def detector_of(place: Detected) -> str:
    """Return the detector that names the noise file of a recording; `DEFAULT` if unknown."""
    return place.detector if place.detector in SHIPPED else DEFAULT


def load_noise(name_or_path: str | Path) -> Noise:
    """Load the noise of a detector: one of `SHIPPED`, or a TOML file of the user's own.

    Raises:
        InputError: naming the file and the field that is wrong.
    """
    return load_noise_file(name_or_path).noise()


def load_noise_file(name_or_path: str | Path) -> NoiseFile:
    """Load a noise file with all its contents; see `load_noise`."""
    if str(name_or_path) in ASSUMED:
        detector = str(name_or_path)
        measured, larger = load_noise_file(MODEL_OF_ASSUMED), ASSUMED[detector]
        why = {DEFAULT: "the detector is unknown", "imx500": "simulated, by a COCO AP of 0.19"}
        return NoiseFile(
            format=FORMAT,
            version=VERSION,
            detector=detector,
            basis="assumed",
            source=f"{why.get(detector, 'not measured')}: {larger:g} times the noise "
            f"of {MODEL_OF_ASSUMED}",
            image_px=measured.image_px,
            scores=measured.scores,
            sigma_px=[larger * sigma for sigma in measured.sigma_px],
            memory=measured.memory,
        )
    return decode_noise(
        *read_shipped(name_or_path, "e3pose.model.noises", SHIPPED, "noise", MAX_BYTES)
    )
