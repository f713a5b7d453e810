"""Training end to end on toy motion: learns, resumes, exports the same, unpickles nothing."""

from __future__ import annotations

import csv
import pickle
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: pip install e3pose[train]")
pytest.importorskip("onnx", reason="onnx is not installed: pip install e3pose[train]")
ort = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

from e3pose.base.errors import InputError  # noqa: E402
from e3pose.model.skeleton import COCO17  # noqa: E402
from e3pose.predict.attention_lstm import AttentionLstm as Predictor  # noqa: E402
from e3pose.predict.kernels.network import run_network  # noqa: E402
from e3pose.predict.normalise import NUM_COMMON, NUM_CONTEXT, NUM_FEATURES  # noqa: E402
from e3pose_lab.train.attention_lstm import Training, TrainSettings, train  # noqa: E402
from e3pose_lab.train.export import export  # noqa: E402
from e3pose_lab.train.network import KEEP, AttentionLstm, NetworkSettings  # noqa: E402
from e3pose_lab.train.weights import network_of  # noqa: E402
from e3pose_lab.train.windows import Clip  # noqa: E402

SETTINGS = TrainSettings(
    network=NetworkSettings(history_slots=6, hidden=16), num_leads=5, steps=60, batch=32,
    validate_every=20, expert_windows=400,
)  # fmt: skip


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def swinging(seed: int, num_slots: int = 240) -> Clip:
    """Limbs that swing about a body that goes in circles: what velocity alone cannot tell."""
    rng = np.random.default_rng(seed)
    time = np.arange(num_slots)[:, None, None] / 30
    pose = rng.normal(size=(NUM_COMMON, 3)) * 0.4
    swing = (
        0.15
        * np.sin(6 * time + rng.uniform(0, 6, (NUM_COMMON, 1)))
        * rng.normal(size=(NUM_COMMON, 3))
    )
    path = 1.5 * np.concatenate([np.cos(0.8 * time), np.sin(0.8 * time), 0 * time], axis=-1)
    return Clip(f"swinging {seed}", (pose + swing + path).astype(np.float32), 30.0)


TRAINING = [swinging(seed) for seed in range(4)]
VALIDATION = [("swinging", [swinging(9)])]


def shaken(settings: NetworkSettings) -> AttentionLstm:
    """Return a network whose every weight matters."""
    torch.manual_seed(1)
    network = AttentionLstm(settings)
    network.eval()
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, 0, 0.08)
    with torch.no_grad():
        network.expert.weight.mul_(0.01)  # experts correct by centimetres, not by metres
        network.expert.bias.mul_(0.01)
    return network


@pytest.mark.parametrize("history_slots", [4, 10])
def test_the_exported_graph_equals_torch_for_any_batch_and_lead(history_slots: int) -> None:
    network = shaken(NetworkSettings(history_slots=history_slots, hidden=24))
    session = ort.InferenceSession(export(network, [1.0]), providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(0)
    for people in (1, 4, 33):
        for leads in (1, 5, 15):
            features = rng.normal(size=(history_slots, people, NUM_FEATURES)).astype(np.float32)
            context = rng.normal(size=(people, NUM_CONTEXT)).astype(np.float32)
            with torch.no_grad():
                wanted = network(torch.from_numpy(features), torch.from_numpy(context), leads)
            places, errors = session.run(
                ["places", "log_error"],
                {"features": features, "context": context, "num_leads": np.array([leads])},
            )
            places = places.reshape(leads, people, 3, NUM_COMMON).swapaxes(-1, -2)
            np.testing.assert_allclose(places, wanted[0].numpy(), atol=1e-5, rtol=1e-5)
            np.testing.assert_allclose(errors, wanted[1].numpy(), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(
    "changes",
    [{}, {"displaces": False}, {"context": True}, {"context": True, "moves": True},
     {"context": True, "moves": True, "smooths": True}],
)  # fmt: skip
def test_networks_without_some_parts_are_exported_alike(changes: dict[str, bool]) -> None:
    settings = replace(NetworkSettings(history_slots=5, hidden=12).as_published(), **changes)
    torch.manual_seed(2)
    network = AttentionLstm(settings).eval()
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, 0, 0.08)
    rng = np.random.default_rng(0)
    features = rng.normal(size=(5, 3, NUM_FEATURES)).astype(np.float32)
    context = rng.normal(size=(3, NUM_CONTEXT)).astype(np.float32)
    with torch.no_grad():
        wanted = network(torch.from_numpy(features), torch.from_numpy(context), 4)[0].numpy()
    content = export(network, [1.0])
    session = ort.InferenceSession(content, providers=["CPUExecutionProvider"])
    places, _ = session.run(
        None, {"features": features, "context": context, "num_leads": np.array([4])}
    )
    np.testing.assert_allclose(
        places.reshape(4, 3, 3, NUM_COMMON).swapaxes(-1, -2), wanted, atol=1e-5
    )
    again, _ = network_of(content, "there")
    with torch.no_grad():
        same = again.eval()(torch.from_numpy(features), torch.from_numpy(context), 4)[0]
    np.testing.assert_allclose(same.numpy(), wanted, atol=1e-5)


def test_a_regressor_of_places_is_trained_for_comparison_and_not_run(tmp_path: Path) -> None:
    places = replace(SETTINGS.network.as_published(), displaces=False)
    path = tmp_path / "places.onnx"
    path.write_bytes(export(AttentionLstm(places).eval(), [1.0]))
    with pytest.raises(InputError, match="regressor of places instead of displacements"):
        Predictor(COCO17, path)


def test_the_papers_network_runs_as_torch_says_and_states_no_error(tmp_path: Path) -> None:
    settings = replace(SETTINGS, network=SETTINGS.network.as_published(), loss="squared")
    weights = train(TRAINING, VALIDATION, tmp_path, settings)
    predictor = Predictor(COCO17, weights)
    history = np.random.default_rng(3).normal(scale=0.4, size=(6, 2, 17, 3))
    prediction = predictor.predict(history, 1 / 30, 5)
    assert np.isfinite(prediction.joints_m).all()
    assert np.isnan(prediction.error_m).all()
    network, _ = network_of(weights.read_bytes(), str(weights))
    rng = np.random.default_rng(0)
    features = rng.normal(size=(6, 3, NUM_FEATURES)).astype(np.float32)
    context = rng.normal(size=(3, NUM_CONTEXT)).astype(np.float32)
    with torch.no_grad():
        wanted = network.eval()(torch.from_numpy(features), torch.from_numpy(context), 5)[0]
    places = np.empty((5, 3, 3 * NUM_COMMON), np.float32)
    log_error = np.empty((5, 3, NUM_COMMON), np.float32)
    run_network(predictor.weights, features, context, places, log_error)
    np.testing.assert_allclose(
        places.reshape(5, 3, 3, NUM_COMMON).swapaxes(-1, -2), wanted.numpy(), atol=1e-4
    )
    rows = log_of(tmp_path)
    assert float(rows[-1]["loss"]) < float(rows[0]["loss"])


def test_parts_of_the_decoder_that_moves_need_it() -> None:
    with pytest.raises(InputError, match="network: found 10 experts"):
        NetworkSettings(moves=False)


def test_an_untrained_network_is_close_to_constant_velocity() -> None:
    network = AttentionLstm(NetworkSettings(history_slots=4, hidden=8)).eval()
    features = torch.randn(4, 2, NUM_FEATURES)
    context = torch.zeros(2, NUM_CONTEXT)
    with torch.no_grad():
        places = network(features, context, 1)[0][0]
    newest = features[-1].reshape(2, 7, NUM_COMMON)
    expected = newest[:, :3] + 0.01 * torch.sigmoid(torch.tensor(KEEP)) * newest[:, 3:6]
    torch.testing.assert_close(places, expected.transpose(-1, -2))


def log_of(out: Path) -> list[dict[str, str]]:
    with (out / "log.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_training_learns_and_leaves_weights_card_and_log(tmp_path: Path) -> None:
    shares: list[float] = []
    weights = train(
        TRAINING, VALIDATION, tmp_path, SETTINGS, lambda share, text: shares.append(share)
    )
    rows = log_of(tmp_path)
    assert [int(row["step"]) for row in rows] == [20, 40, 60]
    assert float(rows[-1]["loss"]) < 0.9 * float(rows[0]["loss"])
    assert shares == sorted(shares) and shares[-1] == 1
    card = (tmp_path / "model-card.md").read_text(encoding="utf-8")
    assert "- swinging 3: 8 s" in card and "- swinging 9: 8 s" in card.split("Validated on")[1]
    assert "swinging 9" not in card.split("Validated on")[0]
    assert "### swinging, noisy" in card and "history_slots" in card
    predictor = Predictor(COCO17, weights)
    assert predictor.history_slots == 6
    history = np.random.default_rng(0).normal(size=(6, 2, 17, 3))
    assert np.isfinite(predictor.predict(history, 0.04, 5).joints_m).all()


def test_a_killed_training_goes_on_as_if_nothing_had_been(tmp_path: Path) -> None:
    whole = train(TRAINING, VALIDATION, tmp_path / "whole", SETTINGS).read_bytes()

    def kill(share: float, text: str) -> None:
        if share > 0.7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(TRAINING, VALIDATION, tmp_path / "cut", SETTINGS, kill)
    assert not (tmp_path / "cut" / "attention-lstm.onnx").exists()
    assert train(TRAINING, VALIDATION, tmp_path / "cut", SETTINGS).read_bytes() == whole
    steps = [row["step"] for row in log_of(tmp_path / "cut")]
    assert steps == ["20", "40", "60"]


def test_training_goes_on_from_weights_and_keeps_what_is_better(tmp_path: Path) -> None:
    first = train(TRAINING, VALIDATION, tmp_path / "first", SETTINGS)
    network, _ = network_of(first.read_bytes(), "first")
    shape = replace(network.settings, dropout=0.4)
    settings = replace(SETTINGS, network=shape, started_from="first", seed=7)
    train(TRAINING, VALIDATION, tmp_path / "second", settings, start=network)
    before, after = (
        [float(row["loss"]) for row in log_of(tmp_path / name)] for name in ("first", "second")
    )
    assert min(after) < min(before)
    assert "- started from: first" in (tmp_path / "second" / "model-card.md").read_text("utf-8")
    harmful = replace(settings, learning_rate=1.0)
    spoilt = train(TRAINING, VALIDATION, tmp_path / "third", harmful, start=network)
    kept, _ = network_of(spoilt.read_bytes(), "third")
    for name, value in network.state_dict().items():
        torch.testing.assert_close(kept.state_dict()[name], value, atol=1e-6, rtol=1e-3)


class Evil:
    def __reduce__(self) -> tuple[object, Sequence[str]]:
        return (Path.touch, (Path("/tmp/e3pose-evil-checkpoint"),))  # type: ignore[return-value]


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 not a zip", b"evil", b"other"])
def test_a_damaged_or_foreign_checkpoint_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "checkpoint.pt"
    trace = Path("/tmp/e3pose-evil-checkpoint")
    if content == b"evil":
        path.write_bytes(pickle.dumps(Evil()))
    elif content == b"other":
        Training(TrainSettings(network=SETTINGS.network, seed=5)).save(path)
    else:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"checkpoint\.pt"):
        train(TRAINING, VALIDATION, tmp_path, SETTINGS)
    assert not trace.exists()


def test_training_stops_early_without_progress(tmp_path: Path) -> None:
    settings = TrainSettings(
        network=SETTINGS.network, num_leads=5, steps=10_000, batch=8, learning_rate=0.0,
        validate_every=1, patience=3, expert_windows=400,
    )  # fmt: skip
    train(TRAINING, VALIDATION, tmp_path, settings)
    assert len(log_of(tmp_path)) <= 10
