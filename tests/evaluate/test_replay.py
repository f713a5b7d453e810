"""Replays: what is read, what is refused, and the noise that was assumed and learned."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case
from tests.rigs import around

from e3pose.base.errors import InputError
from e3pose.energy.profiles import load_profile
from e3pose.evaluate.figures import as_json
from e3pose.evaluate.replay import ReplaySettings, replay, selected_views
from e3pose.evaluate.summary import summarise
from e3pose.evaluate.tables import noise_lines
from e3pose.model.camera import Rig
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose.select.policies import POLICIES
from e3pose.settings.parts import noise_warning
from e3pose.simulate import SceneSettings, simulate

NUM_SLOTS, NUM_CAMERAS = 40, 4
SETTINGS = ReplaySettings(num_selected=2)


@cache
def recording() -> Recording:
    """Return two people who walk, seen exactly by four cameras."""
    rig = around(np.linspace(0.3, 4.5, NUM_CAMERAS), 4.0, 1.5)
    rng = np.random.default_rng(0)
    body = rng.normal(scale=[0.2, 0.2, 0.4], size=(17, 3)) + [0, 0, 1]
    truth = np.stack([[body + [0.01 * s, 0, 0], body + [0, 0.9, 0]] for s in range(NUM_SLOTS)])
    series = []
    for camera in rig.cameras:
        views = [Poses2D(camera.project(people), np.ones((2, 17))) for people in truth]
        series.append(
            ViewSeries.from_views(views, range(NUM_SLOTS), (np.arange(NUM_SLOTS) / 25).tolist(), 17)
        )
    return Recording(
        "two people", rig, 25.0, NUM_SLOTS, COCO17, tuple(series),
        truth=Truth(COCO17, ("a", "b"), truth),
    )  # fmt: skip


@each_case("policy", sorted(POLICIES))
def test_every_policy_replays_the_whole_recording(policy: str) -> None:
    records = list(replay(recording(), replace(SETTINGS, policy=policy)))
    assert [record.slot for record in records] == list(range(NUM_SLOTS))
    assert all((record.arrived <= record.selected).all() for record in records)
    assert records[0].selected.all()


class Blinkers:
    """A recording that fails when a view is read that was not selected."""

    def __init__(self, whole: Recording) -> None:
        self.whole = whole
        self.allowed: set[tuple[int, int]] = set()

    def __getattr__(self, name: str) -> Any:
        if name == "truth":
            raise AssertionError("the truth was read")
        return getattr(self.whole, name)

    def view(self, slot: int, camera: int) -> Poses2D | None:
        assert slot < 10 or (slot, camera) in self.allowed, f"view {camera} of slot {slot} was read"
        return self.whole.view(slot, camera)


@each_case("policy", ["e3pose", "random", "independent"])
def test_unselected_views_and_truth_are_not_even_read(policy: str) -> None:
    blinkers = Blinkers(recording())
    records = []
    for record in replay(blinkers, replace(SETTINGS, policy=policy, lead_slots=1)):  # type: ignore[arg-type]
        records.append(record)
        for camera in np.flatnonzero(record.next_selection):
            blinkers.allowed.add((record.slot + 1, int(camera)))
    assert len(records) == NUM_SLOTS


def test_lost_view_is_not_handed_over() -> None:
    series = recording().views[1]
    lost = ViewSeries(
        series.slots[1:],
        series.times_s[1:],
        series.starts[1:] - 2,
        series.keypoints_px[2:],
        series.scores[2:],
    )
    views = (recording().views[0], lost, *recording().views[2:])
    damaged = replace(recording(), views=views)
    assert set(selected_views(damaged, 0, np.ones(NUM_CAMERAS, dtype=bool))) == {0, 2, 3}


def test_replays_repeat_to_the_last_bit() -> None:
    runs = [list(replay(recording(), replace(SETTINGS, policy="random", seed=3))) for _ in range(2)]
    for first, second in zip(*runs, strict=True):
        np.testing.assert_array_equal(first.people.joints_m, second.people.joints_m)
        np.testing.assert_array_equal(first.next_selection, second.next_selection)


def two_views_that_disagree(by_px: float) -> Recording:
    """Return one person before two cameras, of which the second sees them `by_px` too low."""
    series = []
    for index in range(2):
        views = [recording().view(slot, index) for slot in range(NUM_SLOTS)]
        there = [
            Poses2D(view.keypoints_px[:1] + [0.0, index * by_px], view.scores[:1])
            for view in views
            if view
        ]
        times_s = (np.arange(NUM_SLOTS) / 25).tolist()
        series.append(ViewSeries.from_views(there, range(NUM_SLOTS), times_s, 17))
    rig = Rig(recording().rig.cameras[:2])
    return replace(recording(), rig=rig, views=tuple(series))


@each_case(("distance_m", "people"), [(0.1, 0), (None, 1), (0.2, 1)])
def test_views_that_disagree_match_up_to_the_distance(
    distance_m: float | None, people: int
) -> None:
    source = two_views_that_disagree(27.0)  # 0.12 m at 4 m, 0.13 m with the prior of matching
    settings = replace(
        SETTINGS, pipeline="paper", policy="all", matcher="rays", match_distance_m=distance_m
    )
    assert len(next(replay(source, settings)).people) == people


@each_case(("epipolar_px", "people"), [(10.0, 0), (None, 1), (20.0, 1)])
def test_the_paper_matches_by_pixels_from_epipolar_lines(
    epipolar_px: float | None, people: int
) -> None:
    source = two_views_that_disagree(18.0)
    settings = replace(SETTINGS, pipeline="paper", policy="all", epipolar_px=epipolar_px)
    assert len(next(replay(source, settings)).people) == people


RAYS = {"pipeline": "paper", "matcher": "rays"}


@each_case(
    ("changes", "message"),
    [
        ({"pipeline": "memory", "matcher": "rays"}, "matcher: found with the pipeline memory"),
        ({"match_distance_m": 0.15}, "match_distance: found with the pipeline memory"),
        (RAYS | {"match_distance_m": 0.0}, "match_distance: found 0 mm"),
        (RAYS | {"match_distance_m": 0.3}, "match_distance: found 300 mm, expected .* less than"),
        (RAYS | {"match_distance_m": float("nan")}, "match_distance: found nan mm"),
        ({"epipolar_px": 20.0}, "epipolar_px: found with the pipeline memory"),
        ({"pipeline": "paper", "matcher": "best"}, "matcher: found 'best', expected rays or"),
        ({"pipeline": "paper", "epipolar_px": 0.0}, "epipolar_px: found 0 px"),
        ({"pipeline": "paper", "epipolar_px": float("nan")}, "epipolar_px: found nan px"),
        (
            {"pipeline": "paper", "match_distance_m": 0.1},
            "match_distance: found with the matcher epipolar, expected the matcher rays",
        ),
        (
            {"pipeline": "paper", "matcher": "rays", "epipolar_px": 20.0},
            "epipolar_px: found with the matcher rays, expected the matcher epipolar",
        ),
    ],
)
def test_each_matcher_has_its_own_threshold(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replay(recording(), replace(SETTINGS, **changes))


def test_python_and_the_command_line_run_the_same_system_by_default() -> None:
    from e3pose.cli.options import LoopOptions

    default = ReplaySettings()
    assert LoopOptions().settings() == default
    assert default.policy_name == "information"


@pytest.mark.parametrize(("pipeline", "count"), [("memory", 2), ("paper", 3)])
def test_a_rig_of_two_cameras_has_defaults_too(pipeline: str, count: int) -> None:
    settings = ReplaySettings(pipeline=pipeline)
    assert settings.for_rig(2).num_selected == 2
    assert settings.for_rig(5).num_selected == count


@pytest.fixture(scope="module")
def noisy_recording() -> Recording:
    return simulate(SceneSettings(scene="ring", seconds=6.0, fps=12.5), 705)


def test_unknown_detector_is_reported(noisy_recording: Recording) -> None:
    unknown = replace(noisy_recording, detector="a network of our own")
    assert "no noise model for this detector" in noise_warning(unknown, ReplaySettings())
    assert noise_warning(unknown, ReplaySettings(noise="openpose")) == ""
    assert noise_warning(unknown, ReplaySettings(pipeline="paper")) == ""
    assert noise_warning(noisy_recording, ReplaySettings()) == ""


def test_summary_has_what_was_learned(noisy_recording: Recording) -> None:
    noisy = noisy_recording.rig.camera_ids[1]
    views = list(noisy_recording.views)
    keypoints_px = views[1].keypoints_px.copy()
    keypoints_px[::2] += 12.0  # its keypoints jump to and fro
    keypoints_px[1::2] -= 12.0
    views[1] = replace(views[1], keypoints_px=keypoints_px)
    jumpy = replace(noisy_recording, views=tuple(views))
    settings = ReplaySettings(policy="all", num_selected=5)
    summary = summarise(jumpy, settings, list(replay(jumpy, settings)), load_profile("generic"))
    factors = json.loads(json.dumps(as_json(summary)))["noise"]["factors"]
    assert max(factors, key=factors.get) == noisy
    assert [line for line in noise_lines(summary) if line.startswith(f"{noisy}: keypoint noise ")]
    assert all(line.endswith("x what simulated states") for line in noise_lines(summary))
