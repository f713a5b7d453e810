"""Noise files: what ships, what a user writes, and what is wrong with one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.noise import ErrorMemory
from e3pose.model.noises import (
    DEFAULT,
    SHIPPED,
    NoiseFile,
    ViewFigures,
    decode_noise,
    detector_of,
    encode_noise,
    load_noise,
    load_noise_file,
)
from e3pose.simulate.noise import MEDIAN_PX, SCORES

GOOD: dict[str, Any] = {
    "format": "e3pose-noise",
    "version": 2,
    "detector": "mine",
    "basis": "measured",
    "source": "a test",
    "image_px": 1000.0,
    "scores": [0.2, 0.9],
    "sigma_px": [10.0, 2.0],
}


@each_case("name", sorted(SHIPPED))
def test_shipped_noise_falls_with_the_score(name: str) -> None:
    file = load_noise_file(name)
    assert file.detector == name
    assert (np.diff(file.sigma_px) <= 0).all()
    # A detector is no better than a thousandth of the image, and no worse than a thirtieth.
    assert all(1 <= 1000 * sigma / file.image_px <= 33 for sigma in file.sigma_px)
    assert file.basis != "measured" or (len(file.counts) == len(file.scores) and file.views)
    noise = load_noise(name)
    share = file.sigma_px[0] / file.image_px  # of the image, which is what the filter goes by
    assert noise.of(np.array(file.scores[0])) / noise.image_px == pytest.approx(share)


def test_file_survives_writing(tmp_path: Path) -> None:
    view = ViewFigures(120, 3.0, 0.01, float("nan"), (1.0, -2.0))
    file = NoiseFile(
        **GOOD,
        measured_px=[11.0, 4.0],
        gross_share=[0.1, 0.0],
        counts=[300, 400],
        memory=ErrorMemory(lasting_share=0.3, quick_share=0.2),
        views={"cam 1.x": view},
    )
    (tmp_path / "a.toml").write_text(encode_noise(file))
    again = load_noise_file(tmp_path / "a.toml")
    assert again.views["cam 1.x"].shift_px == (1.0, -2.0)
    assert np.isnan(again.views["cam 1.x"].bias_px)
    assert encode_noise(again) == encode_noise(file)


@each_case(
    ("change", "named"),
    [
        ({"format": "e3pose-recording"}, "format: found 'e3pose-recording'"),
        ({"version": 3}, "version: found '3', expected 1 or 2"),
        ({"version": True}, "version: found 'True'"),
        ({"basis": "guessed"}, "basis"),
        ({"surprise": 1}, "surprise"),
        ({"detector": ""}, "detector: found ''"),
        ({"source": "\x1b[2J"}, "source: found"),
        ({"image_px": 0.0}, "image_px: found '0.0'"),
        ({"image_px": float("nan")}, "image_px: found 'nan'"),
        ({"scores": [], "sigma_px": []}, "scores: found '0 numbers'"),
        ({"scores": [0.9, 0.2]}, "scores: found '[0.9, 0.2]'"),
        ({"scores": [0.2, 1.2]}, "scores: found"),
        ({"scores": [0.0, 0.2]}, "scores: found"),
        ({"scores": ["a", "b"]}, "scores"),
        ({"sigma_px": [10.0]}, "sigma_px: found '1 numbers'"),
        ({"sigma_px": [10.0, 0.0]}, "sigma_px: found '0.0'"),
        ({"sigma_px": [10.0, float("inf")]}, "sigma_px: found 'inf'"),
        ({"gross_share": [0.1, 1.5]}, "gross_share: found '1.5'"),
        ({"counts": [1]}, "counts: found '1 numbers'"),
        ({"memory_s": [1.0]}, "unknown key 'memory_s'"),
        ({"memory": {"lasting_share": 1.5}}, "memory.lasting_share: found 1.5"),
        ({"memory": {"lasting_share": 0.6, "quick_share": 0.6}}, "memory.lasting_share + quick"),
        ({"memory": {"quick_s": 0.0}}, "memory.quick_s: found 0.0"),
        ({"memory": {"quick_s": 3.0}}, "memory.quick_s: found 3.0, expected less than lasting_s"),
        ({"memory": {"lasting_s": float("nan")}}, "memory.lasting_s: found nan"),
        ({"memory": {"slow": 1.0}}, "unknown key 'slow'"),
        ({"scores": [i / 200 for i in range(1, 150)]}, "scores: found '149 numbers'"),
    ],
)
def test_what_is_wrong_is_named(change: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError) as caught:
        decode_noise({**GOOD, **change}, "my.toml")
    assert str(caught.value).startswith("my.toml: ")
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


def test_version_1_is_read_with_the_usual_memory() -> None:
    lists = {"memory_s": [0.0, 0.1, 2.5], "memory_share": [0.0, 0.4, 0.6]}
    file = decode_noise({**GOOD, "version": 1, **lists}, "old.toml")
    assert file.noise().memory == ErrorMemory()
    own = decode_noise({**GOOD, "memory": {"lasting_share": 0.2}}, "my.toml")
    assert own.noise().memory == ErrorMemory(lasting_share=0.2)


def test_missing_field_and_missing_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="sigma_px"):
        decode_noise({k: v for k, v in GOOD.items() if k != "sigma_px"}, "my.toml")
    with pytest.raises(InputError, match="noise: no such file, expected simulated, openpose"):
        load_noise(tmp_path / "absent.toml")
    (tmp_path / "bad.toml").write_text("format = ")
    with pytest.raises(InputError, match="text that is not TOML"):
        load_noise(tmp_path / "bad.toml")


def test_detector_that_is_stated_counts() -> None:
    @dataclass(frozen=True)
    class Place:
        detector: str

    assert detector_of(Place("openpose")) == "openpose"
    assert detector_of(Place("a network of ours")) == DEFAULT
    assert detector_of(Place("")) == DEFAULT


def test_noise_of_simulated_people_is_the_simulators() -> None:
    noise = load_noise("simulated")
    np.testing.assert_allclose(noise.scores, SCORES)
    np.testing.assert_allclose(noise.sigma_px, MEDIAN_PX / np.sqrt(2 * np.log(2)), rtol=0.03)


def test_noise_that_nobody_measured_is_larger_than_openposes() -> None:
    openpose, unknown = load_noise("openpose"), load_noise(DEFAULT)
    np.testing.assert_allclose(unknown.sigma_px, 1.5 * openpose.sigma_px)
    assert unknown.weight < openpose.weight  # and it is learned sooner
    assert unknown.memory == openpose.memory
