"""`e3pose evaluate-predictor` as a user runs it."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from tests.cli.commands import run

from e3pose.recording import save_recording
from e3pose.simulate import DetectorSettings, SceneSettings, simulate

pytestmark = pytest.mark.slow

predicted = partial(run, "evaluate-predictor")
BASELINES = "zero-velocity,constant-velocity,damped-velocity"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two simulated people, with their truth in `known` and without it in `unknown`."""
    path = tmp_path_factory.mktemp("predict")
    settings = SceneSettings(
        people=2, seconds=3.0, cameras=3, detector=DetectorSettings(perfect=True)
    )
    recording = simulate(settings, seed=0)
    save_recording(recording, path / "known")
    save_recording(replace(recording, truth=None, name="estimated"), path / "unknown")
    return path


def test_figures_of_truth_and_of_estimates(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "out.json"
    assert predicted(folder / "known", folder / "unknown", "--predictors", BASELINES,
                     "--leads", "5,1", "--json", file) == 0  # fmt: skip
    report = json.loads(file.read_text())
    assert report["settings"]["leads"] == [1, 5]
    known, unknown = report["recordings"]
    assert (known["motion"], set(known["figures"])) == ("truth", {"exact", "noisy"})
    assert (unknown["motion"], set(unknown["figures"])) == ("estimates", {"estimated"})
    for name in BASELINES.split(","):
        exact = known["figures"]["exact"][name]
        assert exact["mpjpe_mm"]["1"] < known["figures"]["noisy"][name]["mpjpe_mm"]["1"]
        assert exact["box_iou"]["1"] > exact["box_iou"]["5"] > 0.5
        # Exact detections give nearly the truth again, so predictions err alike.
        estimated = unknown["figures"]["estimated"][name]
        assert estimated["mpjpe_mm"]["5"] == pytest.approx(exact["mpjpe_mm"]["5"], rel=0.3)
        assert report["latency_ms"][name]["people"] == 4
        assert report["latency_ms"][name]["leads"]["5"]["median"] > 0
        # One recording has each kind of history, so pooling changes nothing.
        assert report["pooled"]["exact"][name] == exact
    printed = capsys.readouterr().out
    assert "all 2 recordings, noisy histories: absolute MPJPE, mm" in printed
    assert "time of a call for 4 people" in printed


def test_the_same_seed_gives_the_same_figures(folder: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        tokens = (folder / "known", "--predictors", "damped-velocity", "--leads", "2", "--every", 5,
                  "--seed", seed, "--json", tmp_path / name)  # fmt: skip
        assert predicted(*tokens) == 0
    a, b, c = (json.loads((tmp_path / name).read_text())["pooled"]["noisy"] for name in "abc")
    assert a == b != c


def test_plot_is_a_page_without_need_of_a_network(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "curves.html"
    assert predicted(folder / "known", "--predictors", "zero-velocity", "--every", 10,
                "--plot", page) == 0  # fmt: skip
    text = page.read_text()
    assert "zero-velocity, noisy" in text
    assert "<script src=" not in text


def test_pictures_are_drawn_and_replaced_only_when_asked(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tokens = (folder / "known", "--predictors", "zero-velocity", "--every", 10, "--pictures")
    assert predicted(*tokens, tmp_path / "drawn") == 0
    names = {path.name for path in (tmp_path / "drawn").iterdir()}
    assert names == {"skeletons.svg", "error-by-lead.svg"}  # nobody states an expected error
    assert predicted(*tokens, tmp_path / "drawn") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert predicted(*tokens, tmp_path / "drawn", "--overwrite") == 0
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    assert predicted(*tokens, tmp_path / "mine", "--overwrite") == 2
    assert (tmp_path / "mine" / "thesis.txt").exists()


def test_slots_choose_a_part(folder: Path, tmp_path: Path) -> None:
    tokens = (folder / "known", "--predictors", "zero-velocity", "--leads", 1, "--json")
    counts = []
    for slots in ("0:75", "0:40", "0:40,45:75"):
        assert predicted(*tokens, tmp_path / "a.json", "--slots", slots) == 0
        counts.append(json.loads((tmp_path / "a.json").read_text())["recordings"][0]["windows"])
    # The last slot of all has no window, that of a part before another has one without a future.
    assert counts == [2 * 65, 2 * 30, 2 * (31 + 20)]  # ten of history before the first
