"""`e3pose models bench` says what a detection costs on this machine."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.cli.commands import run
from tests.detectors.test_chooser import NAP_S, NAPPER
from tests.detectors.test_networks import write_onnx

from e3pose.energy.meters.base import Reading
from e3pose.energy.profiles import Activity
from e3pose.site import bench
from e3pose.site.bench import measure

pytestmark = pytest.mark.slow


class Watts:
    """Draws 5 W, and 9 W while the camera detects."""

    def read(self, mode: Activity) -> Reading:
        return Reading(9.0 if mode == "active" else 5.0, None, True, "measured: a test")


def test_joules_are_those_beyond_idling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "IDLE_S", 0.01)
    (tmp_path / "napper.py").write_text(NAPPER)
    cost = measure(f"{tmp_path}/napper.py:Napper", (64, 48), "auto", None, 0.2, Watts())
    assert cost.detect_s >= NAP_S and cost.first_s >= NAP_S
    assert cost.energy_j == pytest.approx(4.0 * cost.detect_s)


def test_table_names_network_time_and_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench, "IDLE_S", 0.01)
    boxes, points = np.zeros((1, 2, 5), np.float32), np.zeros((1, 2, 17, 3), np.float32)
    file = write_onnx(tmp_path / "tiny.onnx", (1, 3, 64, 64), boxes, points)
    words = ("--resolution", "64x48", "--resolution", "32x24", "--seconds", "0.1")
    assert run("models", "bench", file, "drawn", *words, "--provider", "cpu") == 0
    out = capsys.readouterr().out
    assert re.search(r"tiny\.onnx +64 x 48 +[\d.]+ .* cpu", out), out
    assert len(re.findall(r"^drawn ", out, re.M)) == 2
    # Joules are printed where the machine has a meter, and otherwise why there are none.
    assert re.search(r"^(no joules|measured): \w", out, re.M), out


@each_case(
    ("words", "message"),
    [
        (("--resolution", "big"), "--resolution: found 'big', expected WIDTHxHEIGHT"),
        (("--seconds", "0"), "--seconds: found 0"),
        ((), "no network is installed: e3pose models pull movenet-multipose"),
    ],
)
def test_what_cannot_be_measured_is_one_line(
    words: tuple[str, ...],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path))
    assert run("models", "bench", *(("drawn",) if words else ()), *words) == 2
    assert message in capsys.readouterr().err
