"""The motion gate: the network rests where the image is that of its last look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from e3pose.camera.gate import Gate
from e3pose.model.expected import ExpectedView
from e3pose.model.pose import MOST_UNCHANGED_S, Poses2D

Image = NDArray[np.uint8]
NS = 10**9


@dataclass
class Counting:
    """Finds one person, elsewhere in every look."""

    looks: int = 0

    def detect(self, image: Image) -> Poses2D:
        self.looks += 1
        return Poses2D(np.full((1, 17, 2), float(self.looks)), np.ones((1, 17)))


def room(seed: int = 0, noise: float = 5.0) -> Image:
    """Return an image of an empty room with the noise of a sensor."""
    rng = np.random.default_rng(seed)
    walls = np.linspace(60, 180, 640)[None, :, None] * np.ones((480, 1, 3))
    noisy = walls + rng.normal(scale=noise, size=walls.shape)
    return np.asarray(np.clip(noisy, 0, 255), dtype=np.uint8)


def with_somebody(image: Image, left: int, width: int = 40, grey: int = 30) -> Image:
    there: Image = image.copy()
    there[200:320, left : left + width] = grey
    return there


def test_noise_alone_lets_the_network_rest() -> None:
    network = Counting()
    gate = Gate(network, on=True)
    found = [gate.look(room(seed), None, seed * NS // 20) for seed in range(10)]
    assert network.looks == 1
    assert [pose.unchanged_s for pose in found] == [seed / 20 for seed in range(10)]
    assert all((pose.keypoints_px == 1).all() for pose in found)


def test_it_looks_at_somebody_who_comes_in_or_moves() -> None:
    network = Counting()
    gate = Gate(network, on=True)
    gate.look(room(0), None, 0)
    assert gate.look(with_somebody(room(1), 0), None, NS // 20).unchanged_s == 0
    assert gate.look(with_somebody(room(2), 0), None, 2 * NS // 20).unchanged_s > 0
    assert gate.look(with_somebody(room(3), 12), None, 3 * NS // 20).unchanged_s == 0
    assert network.looks == 3


def test_slow_motion_adds_up_and_it_looks_again_after_a_while() -> None:
    network = Counting()
    gate = Gate(network, on=True)
    for step in range(20):
        gate.look(with_somebody(room(step), 200 + step), None, step * NS // 20)
    assert network.looks > 2
    still = Counting()
    gate = Gate(still, on=True)
    for tenth in range(int(10 * MOST_UNCHANGED_S) + 2):
        gate.look(room(tenth), None, tenth * NS // 10)
    assert still.looks == 2


def test_a_look_at_a_part_does_not_stand_for_the_whole() -> None:
    network = Counting()
    gate = Gate(network, on=True)
    expected = ExpectedView(np.full((1, 17, 2), 100.0), np.full(1, 20.0))
    gate.look(room(0), expected, 0)
    assert gate.look(room(1), expected, NS // 20).unchanged_s > 0
    assert gate.look(room(2), None, 2 * NS // 20).unchanged_s == 0
    assert gate.look(room(3), expected, 3 * NS // 20).unchanged_s > 0


def test_it_looks_at_another_size_after_a_clock_was_set_back_and_always_where_it_is_off() -> None:
    gate = Gate(Counting(), on=True)
    for image, at_ns in ((room(), NS), (room(), NS // 2), (room()[:, :320], NS)):
        assert gate.look(image, None, at_ns).unchanged_s == 0
    gate = Gate(Counting(), on=False)
    assert all(gate.look(room(), None, at).unchanged_s == 0 for at in (0, 1, 2))
