"""e3pose train and e3pose learn as a user runs them."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Literal

import pytest

from e3pose.base.errors import InputError
from e3pose.base.installing import install_command
from e3pose.edge.learn.versions import Version, VersionStore
from e3pose.model.skeleton import COCO17
from e3pose.predict.attention_lstm import SHIPPED, AttentionLstm
from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose_lab.cli.learning import TrainingOptions, learn_replay, list_versions, rollback
from e3pose_lab.cli.training import DataOptions, NetworkOptions, StepOptions, train


@pytest.fixture
def room(tmp_path: Path) -> Path:
    for module in ("torch", "onnx"):
        pytest.importorskip(module, reason=f"{module} is not installed: pip install e3pose[train]")
    folder = tmp_path / "room"
    save_recording(simulate(SceneSettings(people=2, seconds=3.0), seed=0), folder)
    return folder


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"history": 12}, "--history: found 12, expected 10 as in"),
        ({"hidden": 32}, "--hidden: found 32, expected 96 as in"),
    ],
)
def test_weights_of_other_sizes_are_not_gone_on_from(
    room: Path, options: dict[str, int], message: str
) -> None:
    out = room.parent / "out"
    with pytest.raises(InputError, match=message):
        train([room], out=out, network=NetworkOptions(start=Path("shipped"), **options))  # type: ignore[arg-type]
    assert not out.exists()


def test_a_missing_file_of_weights_is_named(room: Path) -> None:
    with pytest.raises(InputError, match=r"none\.onnx"):
        train(
            [room], out=room.parent / "out", network=NetworkOptions(start=room.parent / "none.onnx")
        )


@pytest.mark.parametrize("loss", ["relative", "squared"])
def test_the_papers_network_is_trained_on_what_the_least_occluded_cameras_see(
    room: Path, loss: Literal["relative", "squared"]
) -> None:
    other = room.parent / "other"
    save_recording(simulate(SceneSettings(people=2, seconds=3.0), seed=1), other)
    out = room.parent / "out"
    train(
        [room], out=out, data=DataOptions(validate=[other]),
        network=NetworkOptions(published=True, hidden=8, history=5, leads=4),
        optimisation=StepOptions(steps=2, batch=4, loss=loss),
    )  # fmt: skip
    card = (out / "model-card.md").read_text()
    assert f"- loss: {loss}" in card and "- variety: motion" in card
    assert "as its cameras estimate it" in card  # the truth is there, and not learned from
    predictor = AttentionLstm(COCO17, out / "attention-lstm.onnx")
    assert not predictor.states_error


def test_the_papers_network_goes_on_from_its_shipped_weights(room: Path) -> None:
    other = room.parent / "other"
    save_recording(simulate(SceneSettings(people=2, seconds=3.0), seed=1), other)
    out = room.parent / "out"
    train(
        [room], out=out, data=DataOptions(validate=[other]),
        network=NetworkOptions(published=True, start=Path("shipped")),
        optimisation=StepOptions(steps=1, batch=4),
    )  # fmt: skip
    card = (out / "model-card.md").read_text()
    assert "- started from: attention-lstm-paper.onnx, sha256 " in card
    assert "- variety: motion" in card and "- learning rate: 0.001" in card
    assert not AttentionLstm(COCO17, out / "attention-lstm.onnx").states_error


def test_the_papers_network_does_not_go_on_from_another(room: Path) -> None:
    with pytest.raises(InputError, match="--published: found another network in "):
        train(
            [room], out=room.parent / "out",
            network=NetworkOptions(published=True, start=SHIPPED),
        )  # fmt: skip


def filled(folder: Path) -> Path:
    store = VersionStore(folder / "versions")
    for number in (1, 2):
        version = Version(0, number - 1, 1.8e9, "", (1, 5), (0.011, 0.022), (0.0333, 0.0444), 300)
        store.add(f"weights {number}".encode(), "# Card\n", version)
    return folder


def test_versions_are_listed_with_their_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    list_versions(filled(tmp_path))
    text = capsys.readouterr().out
    heading, *lines = (line.split() for line in text.splitlines())
    rows = {line[0]: " ".join(line) for line in lines[:3]}
    assert set(rows) == {"0", "1", "2"} and " ".join(heading[:2]) == "version parent"
    assert rows["2"].startswith("2 * 1 2027-") and "44.4 -> 22.0" in rows["2"]
    assert "*" not in rows["1"] and "lead 5, mm" in text


def test_one_goes_back_by_one_or_to_a_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rollback(filled(tmp_path))
    assert "version 1 is now current" in capsys.readouterr().out
    rollback(tmp_path, to=0)
    rollback(tmp_path, to=2)
    assert VersionStore(tmp_path / "versions").read().current == 2
    with pytest.raises(InputError, match="version: found 9"):
        rollback(tmp_path, to=9)


def test_a_folder_without_versions_is_named(tmp_path: Path) -> None:
    for call in (list_versions, rollback):
        with pytest.raises(InputError, match="found no versions, expected"):
            call(tmp_path / "nothing")
    assert not (tmp_path / "nothing").exists()


@pytest.mark.skipif(importlib.util.find_spec("torch") is not None, reason="torch is installed")
def test_without_torch_the_system_runs_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = simulate(SceneSettings(people=2, seconds=6.0, fps=10.0, cameras=3), seed=4)
    save_recording(recording, tmp_path / "recording")
    learn_replay(
        [tmp_path / "recording"],
        out=tmp_path / "out",
        training=TrainingOptions(held_back=1.0, least=2.0, minutes=0.1),
    )
    said = capsys.readouterr().out
    assert "recording: 60 slots with version 0" in said
    assert "torch is not installed" in said and install_command("train") in said


def test_recordings_must_fit_together(tmp_path: Path) -> None:
    for name, fps in (("slow", 10.0), ("fast", 20.0)):
        settings = SceneSettings(people=1, seconds=1.0, fps=fps, cameras=2)
        save_recording(simulate(settings, seed=0), tmp_path / name)
    with pytest.raises(InputError, match="several skeletons or rates"):
        learn_replay([tmp_path / "slow", tmp_path / "fast"], out=tmp_path / "out")
