"""How far calibrations of simulated rigs are from the truth: by boards, balls and films in time.

    python lab/benchmarks/calibration_error.py

People are in `bench_calibration.py`.

Distances are largest over the cameras, after the similarity that fits the cameras best; `scale`
is by how much sizes were wrong before it.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from e3pose.calibrate.board import Board
from e3pose.calibrate.from_boards import solve_boards
from e3pose.calibrate.places import KnownLength, from_points_seen, from_wand_seen
from e3pose.calibrate.synchronise import RATE, onsets, shift_of, synchronise
from e3pose.calibrate.wand import Wand
from e3pose.model.camera import Rig
from e3pose.model.noises import load_noise
from e3pose.model.rigs import ring_rig
from e3pose.simulate import SceneSettings, simulate

sys.path.append(str(Path(__file__).resolve().parents[2]))  # scenes of the tests

from tests.calibrate import test_sound as sound
from tests.calibrate.people_scenes import (
    distances,
    every,
    without_calibration,
)
from tests.calibrate.wand_scenes import carried as wand_carried
from tests.calibrate.wand_scenes import ring

BOARD = Board.parse("charuco-5x7-54mm")
CORNER_NOISE_PX = 0.3
SEEDS = (741, 742, 743)


def quiet(what: str, done: int, total: int) -> None:
    del what, done, total


def carried(rig: Rig, rng: np.random.Generator, times: int) -> NDArray[np.float64]:
    """Corners of a board carried through the room, seen from its front within 66 degrees."""
    pixels = np.full((len(rig), times, len(BOARD.corners_m), 2), np.nan)
    middle = BOARD.corners_m.mean(axis=0)
    for index in range(times):
        place = np.array([*rng.uniform(-1.3, 1.3, 2), rng.uniform(0.8, 1.8)])
        turn = Rotation.from_euler("Z", rng.uniform(0, 2 * np.pi)).as_matrix()
        turn = turn @ Rotation.from_euler("X", -np.pi / 2 + rng.uniform(-0.5, 0.5)).as_matrix()
        corners = (BOARD.corners_m - middle) @ turn.T + place
        for number, camera in enumerate(rig.cameras):
            away = camera.center_m - place
            if -(turn[:, 2] @ away) > 0.4 * np.linalg.norm(away) and camera.sees(corners).all():
                noise = rng.normal(0, CORNER_NOISE_PX, (len(corners), 2))
                pixels[number, index] = camera.project(corners) + noise
    return pixels


def boards() -> None:
    print("board, 150 places, corners good to 0.3 px: cameras, seed, degrees, mm")
    for cameras in (4, 6, 8):
        for seed in SEEDS:
            rng = np.random.default_rng(seed)
            rig = ring_rig(cameras, 4.0, 2.0, (1280, 720), rng)
            # The lens is known as well as half a minute of film tells it.
            lenses = Rig(
                tuple(
                    replace(c, K=c.K * [[1 + s, 1, 1], [1, 1 + s, 1], [1, 1, 1]])
                    for c, s in zip(rig.cameras, rng.normal(0, 0.0005, cameras), strict=True)
                )
            )
            found = solve_boards(lenses, BOARD.corners_m, carried(rig, rng, 150)).adjusted.rig
            degrees, millimetres, _ = distances(found, rig, with_scale=False)
            print(f"  {cameras} {seed} {degrees:.3f} {millimetres:.1f}", flush=True)


def balls() -> None:
    print("balls at 150 places, good to 0.7 px, 2 % wild: cameras, seed, degrees, mm, scale")
    wands = {
        "wand of two": Wand.parse("green,red=500mm"),
        "wand of three": Wand.parse("green,blue,red=200mm,500mm"),
    }
    for cameras in (4, 6, 8):
        for seed in SEEDS:
            rig = ring(seed, cameras)
            apart_m = float(np.linalg.norm(rig.centers_m[1] - rig.centers_m[0]))
            for name, wand in wands.items():
                seen = wand_carried(rig, wand, seed)
                _told(f"{cameras} {seed} {name}", from_wand_seen(rig, wand, seen).rig, rig)
            for off_m in (0.0, 0.01):
                known = KnownLength(distance=("cam0", "cam1", apart_m + off_m))
                found = from_points_seen(rig, seen[:, :, 0], known)
                off = f"a distance {1000 * off_m:.0f} mm off"
                _told(f"{cameras} {seed} ball, {off}", found.rig, rig)


def _told(what: str, found: Rig, truth: Rig) -> None:
    degrees, millimetres, _ = distances(found, truth, with_scale=False)
    print(f"  {what}: {degrees:.3f} {millimetres:.1f} {distances(found, truth)[2]:.4f}", flush=True)


def films() -> None:
    print("films shifted: people, seed, calibration, largest error in frames of 15 a second")
    for number, seed in ((1, 751), (1, 752), (2, 753)):
        fast = simulate(SceneSettings(people=number, seconds=30, cameras=4, fps=60), seed)
        begins = (0, 5, 11, 18)
        shifted = every(fast, 4, begins)
        for name, recording in (("known", shifted), ("none", without_calibration(shifted))):
            found = synchronise(recording, load_noise("simulated"), 3.0)
            error = (found.offsets_s - np.array(begins) / fast.fps) * recording.fps
            print(f"  {number} {seed} {name} {np.abs(error).max():.3f}", flush=True)


def sounds() -> None:
    print("films by sound: claps, seconds, largest and median error in ms, least ahead; unrelated")
    for claps, seconds in ((6, 25.0), (6, 12.0), (3, 25.0), (2, 25.0)):
        errors_ms, ahead, unrelated = [], [], []
        for seed in range(701, 717):
            rng = np.random.default_rng(seed)
            one, other = (sound.room(rng, seconds + 7, RATE, claps) for _ in range(2))
            late_s = rng.uniform(0, 4)
            first, second, apart = (
                onsets(sound.heard(heard, rng, RATE, begin_s, seconds, fast=fast))
                for heard, begin_s, fast in ((one, 0, 0.0), (one, late_s, 5e-5), (other, 0, 0.0))
            )
            shift_s, _, clear = shift_of(first, second, 10.0)
            errors_ms.append(1000 * abs(shift_s - late_s))
            ahead.append(clear)
            unrelated.append(shift_of(first, apart, 10.0)[2])
        print(
            f"  {claps} {seconds:g} {max(errors_ms):.1f} {np.median(errors_ms):.1f} "
            f"{min(ahead):.2f} {max(unrelated):.2f}", flush=True,
        )  # fmt: skip


if __name__ == "__main__":
    boards()
    balls()
    films()
    sounds()
