"""Experts start as regressions that tell noise from pose better than the history itself."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: pip install e3pose[train]")

from e3pose.predict.normalise import NUM_COMMON  # noqa: E402
from e3pose_lab.prediction.normalise import normalise, to_person  # noqa: E402
from e3pose_lab.train.experts import FPS, NOISE_M, start_experts  # noqa: E402
from e3pose_lab.train.network import AttentionLstm, NetworkSettings  # noqa: E402
from e3pose_lab.train.windows import Clip, Corruption, Sampler  # noqa: E402


def walking(seed: int) -> Clip:
    """A body that glides and sways as a whole, so that joints tell of each other."""
    rng = np.random.default_rng(seed)
    pose = np.random.default_rng(0).normal(size=(NUM_COMMON, 3)) * 0.4
    time = np.arange(400)[:, None, None] / 30
    path = time * np.array([1.2, 0, 0]) + 0.1 * np.sin(4 * time + rng.uniform(0, 6, (1, 1, 3)))
    return Clip(f"walking {seed}", (pose + path).astype(np.float32), 30.0)


def newest_error(network: AttentionLstm, sampler: Sampler, corruption: Corruption) -> float:
    """Return how far off the first place of the decoder is, relative to the newest of history."""
    slots = network.settings.history_slots
    joints, spoilt, interval = sampler.motion(np.random.default_rng(9), 500, corruption)
    normal = normalise(spoilt, interval, slots)
    features, context = torch.from_numpy(normal.features), torch.from_numpy(normal.context)
    with torch.no_grad():
        (_, _, place, _, _), _ = network.eval().encode(features, context)
    found = place.numpy().reshape(-1, 3, NUM_COMMON).swapaxes(1, 2)
    true = to_person(normal, joints[slots - 1 : slots])[0]
    given = normal.features[-1].reshape(-1, 7, NUM_COMMON)[:, :3].swapaxes(1, 2)
    return float(np.linalg.norm(found - true, axis=-1).mean()) / max(
        float(np.linalg.norm(given - true, axis=-1).mean()), 1e-3
    )


def test_experts_take_out_noise_and_leave_exact_motion_alone() -> None:
    torch.set_num_threads(1)
    sampler = Sampler([walking(seed) for seed in range(3)], 6, 5)
    network = AttentionLstm(NetworkSettings(history_slots=6, hidden=8))
    noisy = Corruption(0.0, 0.0, 0.0, (float(np.log(0.03)), float(np.log(0.031))))
    exact = Corruption(1.0, 0.0, 0.0)
    assert newest_error(network, sampler, noisy) == pytest.approx(1)
    start_experts(network, sampler, np.random.default_rng(0), 2000)
    assert newest_error(network, sampler, noisy) < 0.93
    assert newest_error(network, sampler, exact) < 0.8  # of a millimetre


@pytest.mark.parametrize("experts", [1, len(NOISE_M) * len(FPS) + 3])
def test_any_number_of_experts_can_start(experts: int) -> None:
    sampler = Sampler([walking(0)], 4, 5)
    network = AttentionLstm(NetworkSettings(history_slots=4, hidden=8, experts=experts))
    start_experts(network, sampler, np.random.default_rng(0), 300)
    assert all(bool(torch.isfinite(p).all()) for p in network.parameters())
