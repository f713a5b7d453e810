"""`e3pose evaluate` as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.cli.commands import run
from tests.cli.one_person import one_person

from e3pose.recording import save_recording

NUM_SLOTS = 30


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One person seen exactly by four cameras, so that every policy gets everything right."""
    path = tmp_path_factory.mktemp("evaluate") / "recording"
    save_recording(one_person([0.3, 1.5, 3.1, 4.4], NUM_SLOTS), path)
    return path


@pytest.mark.slow
def test_comparison_in_parallel_processes(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "figures.json"
    code = run(
        "evaluate", str(folder), "--policies", "all,random,round-robin", "--cameras", "2,3",
        "--pipeline", "paper", "--seeds", "2", "--jobs", "2", "--battery-wh", "20",
        "--json", str(figures),
    )  # fmt: skip
    assert code == 0
    rows = json.loads(figures.read_text())["rows"]
    assert [(row["policy"], row["cameras"], row["seeds"]) for row in rows] == [
        ("all", None, 2),  # once: a number of cameras means nothing to it
        *((policy, count, 2) for policy in ("random", "round-robin") for count in (2, 3)),
    ]
    for row in rows:
        asked = 4 if row["policy"] == "all" else row["cameras"]
        # In slot 10 the first decision is made, for slot 11.
        expected = (11 * 4 + 19 * asked) / NUM_SLOTS
        assert row["selection"]["mean_cameras"]["mean"] == pytest.approx(expected)
        assert row["metrics"]["mpjpe_mm"]["mean"] < 0.1
        assert row["metrics"]["ap"]["25"]["mean"] == pytest.approx(100)
        assert row["energy"]["battery_wh"]["mean"] == 20
    # Drawn anew with every seed: some camera was on for another share of the slots.
    duty = rows[1]["selection"]["duty"]
    assert any(share["sd"] > 0 for share in duty.values())
    output = capsys.readouterr().out
    assert "round-robin" in output
    assert "MPJPE" in output


@pytest.mark.parametrize("queue", [False, True])
def test_weights_and_budgets_are_compared_in_every_combination(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], queue: bool
) -> None:
    figures = tmp_path / "figures.json"
    code = run(
        "evaluate", str(folder), "--policies", "round-robin,independent,e3pose-mv",
        "--cameras", "2", "-V", "0,0.5", "-E", "0.6,1", "--seeds", "1", "--jobs", "1",
        "--json", str(figures), *["--independent-queue"] * queue,
    )  # fmt: skip
    assert code == 0
    found = [
        (row["policy"], row["quality_weight"], row["budget"])
        for row in json.loads(figures.read_text())["rows"]
    ]
    balances = [(0, 0.6), (0.5, 0.6), (0, 1), (0.5, 1)]
    assert found == [
        ("round-robin", None, None),  # neither means anything to these
        *[("independent", None, budget) for budget in ((0.6, 1) if queue else (None,))],
        *[("e3pose-mv", *balance) for balance in balances],
    ]
    reported = capsys.readouterr().out
    assert " V " in reported and " E " in reported


def test_leads_are_drawn(folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    plot = tmp_path / "leads.svg"
    assert run("evaluate", str(folder), "--policies", "random", "--cameras", "2", "--leads", "1,3",
               "--seeds", "1", "--jobs", "1", "--plot", str(plot)) == 0  # fmt: skip
    text = plot.read_text()
    assert "random" in text
    assert "MPJPE, mm" in text  # COCO-17 truth has no PCP


def test_bad_days_are_asked_for_on_the_command_line(folder: Path, tmp_path: Path) -> None:
    figures = tmp_path / "bad.json"
    options = ["--policies", "all", "--seeds", "4", "--jobs", "1", "--json", str(figures)]
    bad = ["--kill-camera", "each@5", "--kill-camera", "c0@0.2s", "--loss", "0.25", "--fps", "12.5"]
    assert run("evaluate", str(folder), *options, *bad) == 0
    (row,) = json.loads(figures.read_text())["rows"]
    # Of 15 slots c0 is awake in the first 3; every other camera is gone in one repetition of four.
    assert row["selection"]["duty"]["c0"]["mean"] == pytest.approx(3 / 15)
    assert 0.5 < row["selection"]["duty"]["c1"]["mean"] < 0.9
    assert row["selection"]["mean_views"]["mean"] < 0.9 * row["selection"]["mean_cameras"]["mean"]
