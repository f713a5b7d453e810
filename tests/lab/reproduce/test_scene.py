"""Pictures of one scene: a panel a camera and two in 3D; the slot is the one that gains most."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from e3pose.model.skeleton import COCO17, SHELF14, convert
from e3pose.recording import Recording, Truth
from e3pose.simulate import SceneSettings, simulate
from e3pose_lab.reproduce.items.base import Scale
from e3pose_lab.reproduce.items.scene import section
from e3pose_lab.reproduce.scene import Scene, SceneAsked, in_order, scene
from e3pose_lab.reproduce.sources import Sources


def labelled() -> Recording:
    """Three people before five cameras, labelled as Shelf is."""
    made = simulate(SceneSettings("crossing", people=3, seconds=1.0, fps=10, cameras=5), 701)
    assert made.truth is not None
    joints_m = made.truth.joints_m
    known = np.asarray(np.isfinite(joints_m).all(axis=-1), dtype=np.float64)
    shelf = [convert(m, k, COCO17, SHELF14)[0] for m, k in zip(joints_m, known, strict=True)]
    return replace(made, truth=Truth(SHELF14, made.truth.person_ids, np.stack(shelf)))


def test_slot_is_that_in_which_three_cameras_gain_most() -> None:
    recording = labelled()
    found = scene(Sources(shelf=recording), SceneAsked(0, recording.num_slots))
    assert len(found.chosen) == 3 and found.error_mm[1] <= found.error_mm[0]
    assert len(found.seen) == len(found.projected) == len(recording.rig)
    truth = recording.truth
    assert truth is not None
    wanted = np.isfinite(truth.joints_m[found.slot]).any(axis=(1, 2)).sum()
    assert sum(bool(limbs) for limbs in found.people["truth"]) == wanted >= 3
    assert all(len(limb) == 6 for limbs in found.people["chosen"] for limb in limbs)
    alone = scene(Sources(shelf=recording), SceneAsked(found.slot, found.slot + 1))
    assert alone == found


def test_a_panel_for_each_camera_and_two_in_three_dimensions() -> None:
    def made(piece: Any) -> Scene:
        body = [[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]
        image = [[1.0, 2.0, 3.0, 4.0]]
        people = {"all": [body], "chosen": [body], "truth": [body, body]}
        return Scene(7, [1, 2, 3], [80.0, 50.0], [[image]] * 5, [[image]] * 5, people)

    found = section(Scale(), made)  # type: ignore[arg-type]
    assert [panel.name for panel in found.panels] == [
        *(f"scene-camera{number}" for number in range(5)), "scene-all", "scene-chosen",
    ]  # fmt: skip
    first, last = found.panels[0], found.panels[-1]
    assert [line.second for line in first.lines] == [False, True]
    assert [line.second for line in last.lines] == [False, True, True]
    assert first.lines[0].x[:2] == (1.0, 3.0) and math.isnan(float(first.lines[0].x[2]))
    assert "cameras 1, 2, 3 50 mm" in found.ours


def test_people_are_put_in_the_order_of_others() -> None:
    rng = np.random.default_rng(0)
    like = rng.normal(size=(3, 5, 3)) + 10.0 * np.arange(3)[:, None, None]
    stranger, empty = like[:1] + 100.0, np.full((1, 5, 3), np.nan)
    people = np.concatenate([stranger, like[2:] + 0.01, empty, like[:1]])
    people[3, 2] = np.nan  # a joint that nobody saw
    found = in_order(people, like, 0.5)
    assert np.isnan(found[1]).all()  # nobody is like the second
    expected = np.concatenate([like[:1], like[1:2] * np.nan, like[2:] + 0.01, stranger])
    expected[0, 2] = np.nan
    np.testing.assert_array_equal(found, expected)
    assert in_order(people[:0], like, 0.5).shape == like.shape
