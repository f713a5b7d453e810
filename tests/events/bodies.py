"""Simulated bodies for tests of states and events: exact joints over time."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.events.people import Seen
from e3pose.model.people import People
from e3pose.simulate.activities import Life
from e3pose.simulate.body import draw_body
from e3pose.simulate.episodes import plan_episode
from e3pose.simulate.simulation import move

FPS = 12.5
START_S = 3.0


@cache
def doing(kind: str, seed: int, stays_s: float = 6.0, seconds: float = 20.0) -> Floats:
    """Return `(num_slots, 17, 3)` joints of somebody who stands, does something and stands."""
    times_s = np.arange(0, seconds, 0.02)
    rng = np.random.default_rng(seed)
    body = draw_body(rng)
    still = np.zeros(len(times_s))
    present = np.ones(len(times_s), dtype=bool)
    life = Life(np.zeros((len(times_s), 2)), still, present, still.copy())
    life.episodes.append(plan_episode(kind, START_S, rng, stays_s))
    joints_m = move(body, life, times_s, np.arange(int(seconds * FPS) - 2) / FPS, rng)
    joints_m.flags.writeable = False
    return joints_m


def seen(joints_m: Floats, sigma_m: float = 0.02, track: int = 1, seed: int = 0) -> Iterator[Seen]:
    """Yield the slots of one person, with noise."""
    rng = np.random.default_rng(seed)
    for slot, pose in enumerate(joints_m):
        noisy = pose + sigma_m * rng.standard_normal(pose.shape)
        ids, sigma = np.array([track]), np.full((1, len(pose)), sigma_m)
        people = People(ids, noisy[None], sigma_m=sigma)
        yield Seen(slot, round(slot / FPS * 1e9), people)
