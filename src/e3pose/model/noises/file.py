"""Noise files: TOML, versioned, validated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import msgspec
import numpy as np
import tomli_w

from e3pose.base.errors import InputError
from e3pose.base.table import read_table
from e3pose.model.noise import ASSUMED_WEIGHT, IMAGE_PX, KNOWN_WEIGHT, ErrorMemory, Noise

FORMAT = "e3pose-noise"
VERSION = 2
# Version 1 listed the parts of the memory as they were measured, not corrected for errors of the
# reference, which hide what is new in every slot. Nothing read them; nothing reads them now.
UNCORRECTED = ("memory_s", "memory_share")
MAX_KNOTS = 100
MAX_VIEWS = 1000
MAX_TEXT = 2000
MAX_SIGMA_PX = 1e4
LEAST_IMAGE_PX, MOST_IMAGE_PX = 16.0, 1e5


class ViewFigures(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Statistics of one camera's keypoints, for people: the filter does not read them.

    Attributes:
        keypoints: how many were compared.
        sigma_px: standard deviation of either coordinate, of all scores together.
        gross_share: share of gross errors.
        bias_px: how far the mean of a joint is off, the median over joints; NaN if unknown.
        shift_px: median error of all keypoints, right and down.
    """

    keypoints: int
    sigma_px: float
    gross_share: float
    bias_px: float
    shift_px: tuple[float, float]


class NoiseFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The noise of one detector, and where it comes from.

    Attributes:
        format: `e3pose-noise`.
        version: 2.
        detector: whose keypoints these are.
        basis: `measured` on a recording, `assumed` where none was at hand, or `known` because
            somebody made the noise.
        source: what was measured, or what the assumption rests on.
        image_px: size of the images that the pixels below belong to, the longer side.
        scores: rising keypoint scores, in (0, 1].
        sigma_px: standard deviation of either coordinate at those scores.
        measured_px: the same before it was corrected for errors of the reference.
        gross_share: share of errors beyond 40 pixels of 1032.
        counts: keypoints behind each of them.
        memory: how long errors last.
        views: by camera.
    """

    format: str
    version: int
    detector: str
    basis: Literal["measured", "assumed", "known"]
    source: str
    image_px: float
    scores: list[float]
    sigma_px: list[float]
    measured_px: list[float] = []
    gross_share: list[float] = []
    counts: list[int] = []
    memory: ErrorMemory = ErrorMemory()
    views: dict[str, ViewFigures] = {}

    def noise(self) -> Noise:
        """Return the noise for the filter, in pixels of the images of its limits."""
        weight = ASSUMED_WEIGHT if self.basis == "assumed" else KNOWN_WEIGHT
        scores, sigma_px = np.array(self.scores), np.array(self.sigma_px)
        noise = Noise(scores, sigma_px, self.image_px, weight, self.memory)
        return noise.in_images_of(IMAGE_PX)


def encode_noise(file: NoiseFile) -> str:
    """Return the text of a noise file."""
    table: dict[str, Any] = msgspec.to_builtins(file)
    empty = [key for key, value in table.items() if value in ([], {})]
    return tomli_w.dumps({key: value for key, value in table.items() if key not in empty})


def decode_noise(table: Mapping[str, Any], where: str) -> NoiseFile:
    """Return the noise file that a TOML table holds.

    Args:
        table: as parsed.
        where: the name of the file, for errors.

    Raises:
        InputError: naming the file and the field that is wrong.
    """
    if table.get("format") != FORMAT:
        raise _error(where, "format", table.get("format"), repr(FORMAT))
    version = table.get("version")
    if version not in (1, VERSION) or isinstance(version, bool):
        raise _error(where, "version", version, f"1 or {VERSION}")
    if version == 1:
        table = {key: value for key, value in table.items() if key not in UNCORRECTED}
        table["version"] = VERSION
    try:
        file = read_table(NoiseFile, table)
    except InputError as error:
        raise error.at(where) from None
    _check(file, where)
    return file


def _check(file: NoiseFile, where: str) -> None:
    for field, text in (("detector", file.detector), ("source", file.source)):
        if not 1 <= len(text) <= MAX_TEXT or not text.isprintable():
            raise _error(where, field, text, f"1 to {MAX_TEXT} printable characters")
    if not LEAST_IMAGE_PX <= file.image_px <= MOST_IMAGE_PX:
        expected = f"{LEAST_IMAGE_PX:g} to {MOST_IMAGE_PX:g} pixels"
        raise _error(where, "image_px", file.image_px, expected)
    knots = len(file.scores)
    if not 1 <= knots <= MAX_KNOTS:
        raise _error(where, "scores", f"{knots} numbers", f"1 to {MAX_KNOTS}")
    rising = all(a < b for a, b in zip([0.0, *file.scores], file.scores, strict=False))
    if not (rising and file.scores[-1] <= 1):
        raise _error(where, "scores", file.scores, "rising numbers in (0, 1]")
    for field, values, most in (
        ("sigma_px", file.sigma_px, MAX_SIGMA_PX),
        ("measured_px", file.measured_px, MAX_SIGMA_PX),
        ("gross_share", file.gross_share, 1.0),
        ("counts", file.counts, 1e15),
    ):
        if len(values) != knots and (values or field == "sigma_px"):
            raise _error(where, field, f"{len(values)} numbers", f"{knots}, as many as scores")
        least = 1e-6 if field.endswith("px") else 0.0
        for value in values:
            if not least <= value <= most:
                raise _error(where, field, value, f"{least:g} to {most:g}")
    if len(file.views) > MAX_VIEWS:
        raise _error(where, "views", f"{len(file.views)} cameras", f"at most {MAX_VIEWS}")


def _error(where: str, field: str, found: object, expected: str) -> InputError:
    return InputError(field, repr(str(found)[:80]), expected, where)
