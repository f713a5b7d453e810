"""Ridge regression from noisy histories to true places and motions: where the experts start."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose_lab.prediction.normalise import normalise, to_person
from e3pose_lab.train.network import NUM_AXES, AttentionLstm, evidence
from e3pose_lab.train.windows import Corruption, Sampler, usual_error

# Kinds of histories: with noise in a range, each at rates in a range. The first expert is for exact
# histories, and does nothing: what regression finds there it finds in this motion alone.
NOISE_M = ((0.004, 0.015), (0.015, 0.035), (0.035, 0.08))
FPS = ((5.0, 16.0), (16.0, 40.0), (40.0, 60.0))
RIDGE = 3.0
BATCH = 1000
FLOOR_M = 0.0003
LATE_SHARE = 0.01  # of the usual error at the last lead, which tells how hard a window is
GATED = [0, 1, 3]  # what of the context tells kinds apart: speed, slot length, roughness


def start_experts(
    network: AttentionLstm, sampler: Sampler, rng: np.random.Generator, windows: int
) -> None:
    """Let every expert be the ridge regression of one kind of history, and gate by its kind.

    The gate starts as the linear discriminant of the kinds. Experts that there are too many of
    start as nothing, and kinds that there are too many of are left out.

    Args:
        network: is changed.
        sampler: of windows.
        rng: random numbers.
        windows: how many to use per kind.
    """
    slots = network.settings.history_slots
    exact = Corruption(exact=1.0, missing=0.3, short=0.0)
    _, spoilt, interval = sampler.motion(rng, windows, exact)
    kinds = [normalise(spoilt, interval, slots).context[:, GATED].astype(np.float64)]
    parts = [np.zeros((slots * NUM_AXES + 1, 2 * NUM_AXES), dtype=np.float32)]
    for noise in NOISE_M:
        for fps in FPS:
            solution, contexts = _solve(slots, sampler, rng, windows, noise, fps)
            parts.append(solution)
            kinds.append(contexts)
    spread = np.mean([np.cov(contexts.T) for contexts in kinds], axis=0) + 0.01 * np.eye(len(GATED))
    centre = np.array([contexts.mean(axis=0) for contexts in kinds])
    towards = centre @ np.linalg.inv(spread)
    number = min(network.settings.experts, len(parts))
    size = 2 * NUM_AXES
    with torch.no_grad():
        for index in range(number):
            rows = slice(size * index, size * (index + 1))
            network.expert.weight[rows] = torch.from_numpy(parts[index][:-1].T)
            network.expert.bias[rows] = torch.from_numpy(parts[index][-1])
        network.gate.weight[:number, GATED] = torch.from_numpy(towards[:number]).float()
        apart = -0.5 * np.einsum("ki,ki->k", towards, centre)[:number]
        network.gate.bias[:number] = torch.from_numpy(apart).float()


def _solve(
    slots: int,
    sampler: Sampler,
    rng: np.random.Generator,
    windows: int,
    noise_m: tuple[float, float],
    fps: tuple[float, float],
) -> tuple[NDArray[np.float32], Floats]:
    """Return the regression of one kind, and the context of the windows that it is from.

    It is weighted so that slow motion counts as much as fast.
    """
    size = slots * NUM_AXES + 1
    squares, products = RIDGE * np.eye(size), np.zeros((size, 2 * NUM_AXES))
    contexts = []
    low, high = np.log(noise_m)
    corruption = Corruption(0.0, 0.7, 0.0, (float(low), float(high)))
    for _ in range(max(1, windows // BATCH)):
        joints, spoilt, interval = sampler.motion(rng, min(BATCH, windows), corruption, fps)
        normal = normalise(spoilt, interval, slots)
        speed = torch.from_numpy(normal.speed_m[:, None].astype(np.float32))
        read = evidence(torch.from_numpy(normal.features), speed).numpy()
        read = np.concatenate([read, np.ones((len(read), 1))], axis=1)
        true = to_person(normal, joints[slots - 1 : slots + 1])
        now, then = true.swapaxes(-1, -2).reshape(2, -1, NUM_AXES)
        newest = normal.features[-1].astype(np.float64)
        motion = newest[:, NUM_AXES : 2 * NUM_AXES] * normal.speed_m[:, None]
        wanted = np.concatenate([now - newest[:, :NUM_AXES], then - now - motion], axis=1)
        wanted[~np.tile(normal.seen, (1, 6))] = 0
        usual = usual_error(spoilt, joints[slots:])
        weight = 1 / (usual[0] + FLOOR_M + LATE_SHARE * usual[-1])[:, None]
        weight /= np.sqrt(np.square(weight).mean())
        squares += (read * weight).T @ (read * weight)
        products += (read * weight).T @ (wanted * weight)
        contexts.append(normal.context[:, GATED].astype(np.float64))
    return np.linalg.solve(squares, products).astype(np.float32), np.concatenate(contexts)
