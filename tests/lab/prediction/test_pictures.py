"""Pictures are drawn from the numbers: coordinates inside the file against known values."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from e3pose.base.errors import InputError
from e3pose.model.skeleton import COCO17
from e3pose.predict import make_predictor
from e3pose.recording import Recording
from e3pose.simulate import SceneSettings, simulate
from e3pose_lab.evaluate.drawing import picture
from e3pose_lab.evaluate.lead_picture import draw_leads
from e3pose_lab.prediction.motion import BODY_JOINTS, Motion
from e3pose_lab.prediction.pictures import draw_claims, draw_curves
from e3pose_lab.prediction.scores import PredictionSettings
from e3pose_lab.prediction.skeleton_picture import draw_skeletons
from e3pose_lab.prediction.windows import Window, choose_windows, ranked_lead, sample_windows

pytestmark = pytest.mark.skipif(
    find_spec("matplotlib") is None, reason="matplotlib is not installed"
)

SVG = "{http://www.w3.org/2000/svg}"
LEADS = (1, 5, 10)


@cache
def recording() -> Recording:
    return simulate(SceneSettings(people=1, seconds=0.1, cameras=2), seed=0)


def texts(path: Path) -> list[str]:
    return ["".join(item.itertext()) for item in ET.parse(path).iter(f"{SVG}text")]


def curves(path: Path, colour: str) -> list[np.ndarray[Any, Any]]:
    """Return the points `(num_points, 2)` of every line of a colour, rightwards and downwards."""
    found = []
    for item in ET.parse(path).iter(f"{SVG}path"):
        if f"stroke: {colour}" in item.get("style", ""):
            numbers = re.findall(r"[ML] (\S+) (\S+)", item.get("d", ""))
            if len(numbers) >= 3:
                found.append(np.array(numbers, dtype=float))
    return found


def walk(speed_mps: float, slots: int = 40) -> Motion:
    """Return one COCO-17 person of random shape who glides along x, faster with every slot."""
    body = np.random.default_rng(0).uniform(0, 1.7, (17, 3))
    way = speed_mps * (np.arange(slots) / 25) ** 2
    joints_m = body + np.stack([way, 0 * way, 0 * way], axis=-1)[:, None]
    return Motion("walk", "truth", COCO17, recording().rig, 1 / 25, (joints_m,))


def test_curve_has_the_heights_of_the_numbers(tmp_path: Path) -> None:
    errors = {"1": 10.0, "5": 50.0, "10": 30.0}
    iou = {"1": 0.9, "5": 0.8, "10": 0.7}
    draw_curves(
        tmp_path / "a.svg", {"exact": {"zero-velocity": {"mpjpe_mm": errors, "box_iou": iou}}}
    )
    (line,) = [c for c in curves(tmp_path / "a.svg", "#9ca3af") if len(c) == 3][:1]
    steps = np.diff(line, axis=0)
    assert steps[0, 0] / steps[1, 0] == pytest.approx(4 / 5, abs=0.01)
    assert steps[0, 1] / steps[1, 1] == pytest.approx(40 / -20, abs=0.01)
    assert "zero-velocity" in texts(tmp_path / "a.svg")


def test_the_same_numbers_give_the_same_small_file(tmp_path: Path) -> None:
    for name in ("a.svg", "b.svg"):
        with picture(tmp_path / name, 3.0, 2.0) as figure:
            axes = figure.subplots()
            axes.plot([0, 1, 2], [0.0475, 0.0483, 0.0525], marker="o")
            axes.set_yticks([0.0475, 0.0525])
    text = (tmp_path / "a.svg").read_text()
    assert text == (tmp_path / "b.svg").read_text() and len(text) < 20_000
    assert ">0.0475<" in text and ">0.0525<" in text, "labels keep their digits"
    words = [word for part in text.split(' d="')[1:] for word in part.split('"')[0].split()]
    assert words and not any(len(word.partition(".")[2]) > 2 for word in words)
    with pytest.raises(ZeroDivisionError), picture(tmp_path / "c.svg", 2, 2):
        raise ZeroDivisionError
    assert not (tmp_path / "c.svg").exists(), "one that fails leaves no file"


def test_claims_of_nobody_are_no_picture(tmp_path: Path) -> None:
    draw_claims(tmp_path / "a.svg", {"exact": {}})
    assert not (tmp_path / "a.svg").exists()
    groups = [{"expected_mm": 10.0 * n, "actual_mm": 20.0 * n, "joints": 5} for n in (1, 2, 4)]
    draw_claims(tmp_path / "a.svg", {"exact": {"attention-lstm": groups}})
    line, honest = curves(tmp_path / "a.svg", "#0072b2")[0], curves(tmp_path / "a.svg", "#1f2937")
    assert any(len(c) == 7 for c in honest)
    # Twice as much everywhere is parallel to what would be honest, in logarithmic scales.
    assert np.diff(line[:, 0]) == pytest.approx(-np.diff(line[:, 1]), abs=0.05)


def test_windows_are_ranked_by_their_error() -> None:
    settings = PredictionSettings(leads=LEADS, history_slots=10)
    windows = sample_windows(walk(1.0), settings, make_predictor("constant-velocity", COCO17))
    assert len(windows) == 40 - 10 - 10 + 1
    # Constant velocity misses an acceleration of 2 m/s2: by a t (t + dt) / 2 after t seconds.
    assert [w.error_m for w in windows] == pytest.approx([0.4 * (0.4 + 0.04)] * len(windows))
    assert ranked_lead(settings) == 10
    assert ranked_lead(PredictionSettings(leads=(3, 15))) == 3
    assert ranked_lead(PredictionSettings(leads=(15,))) == 15


def test_chosen_windows_have_that_share_below_them() -> None:
    body = np.zeros((1, 17, 3))
    windows = [
        Window("w", COCO17, 0.04, body, body, error)
        for error in np.random.default_rng(1).permutation(101) / 100
    ]
    chosen = choose_windows(windows, (0.5, 0.75, 0.95))
    assert [w.error_m for _, w in chosen] == [0.5, 0.75, 0.95]
    assert choose_windows([]) == []


def test_windows_without_a_whole_future_are_not_shown() -> None:
    motion = walk(1.0)
    motion.people[0][25:] = np.nan
    settings = PredictionSettings(leads=LEADS, history_slots=10)
    windows = sample_windows(motion, settings, make_predictor("zero-velocity", COCO17))
    assert len(windows) == 25 - 10 - 10 + 1


def test_skeletons_tell_the_true_error(tmp_path: Path) -> None:
    settings = PredictionSettings(leads=LEADS, history_slots=10)
    windows = sample_windows(walk(1.0), settings, make_predictor("zero-velocity", COCO17))
    chosen = choose_windows(windows)
    path = tmp_path / "a.svg"
    draw_skeletons(path, chosen, ["constant-velocity"], LEADS, make_predictor)
    written = texts(path)
    for lead, wanted in ((1, 3), (5, 48), (10, 176)):  # a t (t + dt) / 2, in mm
        assert written.count(f"{wanted} mm") == len(chosen), lead
    assert len(BODY_JOINTS) == 14


def test_leads_need_something_that_tells_how_good(tmp_path: Path) -> None:
    row = {"policy": "e3pose", "cameras": 3, "seeds": 2, "stage_ms": {}}
    with pytest.raises(InputError, match="without truth"):
        draw_leads(tmp_path / "a.svg", [{**row, "lead": 1}])
    rows = [
        {**row, "lead": lead, "metrics": {"pcp": {"average": {"mean": 90.0 - lead, "sd": 0.5}}}}
        for lead in (1, 2, 4)
    ]
    draw_leads(tmp_path / "a.svg", rows)
    assert "PCP average, %, 2 seeds" in texts(tmp_path / "a.svg")
    steps = np.diff(curves(tmp_path / "a.svg", "#0072b2")[0], axis=0)
    assert steps[1] == pytest.approx(2 * steps[0], abs=0.05)
