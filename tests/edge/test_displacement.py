"""A camera that was knocked is noticed by where published people appear in its views."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.calibrate.people_scenes import knocked, walk
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.edge.displacement import DisplacementWatch, Votes, WorldCheck, moved, turned_deg
from e3pose.evaluate.replay import ReplaySettings, replay, selected_views
from e3pose.model.camera import Camera, Rig
from e3pose.model.noises import load_noise
from e3pose.recording.record import Recording

pytestmark = pytest.mark.slow

FROM_S = 15.0
RNG_SEED = 5


@pytest.fixture(scope="module")
def calm() -> Recording:
    return walk(703, people=2, seconds=50.0)


def watch_run(
    recording: Recording,
) -> tuple[list[tuple[float, str, str | None]], DisplacementWatch]:
    """Return seconds, kind and camera of all events while two cameras look."""
    watch, found = DisplacementWatch(recording.rig), []
    for record in replay(recording, ReplaySettings(policy="round-robin", num_selected=2)):
        watch.observe(record, selected_views(recording, record.slot, record.arrived))
        found += [(record.time_s, kind, camera) for kind, _, camera in watch.events()]
    return found, watch


def test_knock_is_reported_the_right_camera_and_nothing_before(calm: Recording) -> None:
    found, watch = watch_run(knocked(calm, 1, 2.0, 703, FROM_S))
    assert [(kind, camera) for _, kind, camera in found] == [("camera-moved", "cam1")]
    assert FROM_S < found[0][0] < FROM_S + 35
    assert watch.found is not None and 0.8 < watch.found.degrees < 2.3
    assert watch_run(calm)[0] == []


@each_case("late_slots", [1, 2])
def test_camera_whose_views_are_late_has_not_moved(late_slots: int, calm: Recording) -> None:
    watch, events = DisplacementWatch(calm.rig), []
    for record in replay(calm, ReplaySettings(policy="all")):
        views = dict(selected_views(calm, record.slot, record.arrived))
        if (late := calm.view(max(record.slot - late_slots, 0), 1)) is not None:
            views[1] = late
        watch.observe(record, views)
        events += watch.events()
    assert events == []


def voted(
    turn_deg: float,
    others: float,
    seconds: float = 20.0,
    late_s: float = 0.0,
    one_way: float = 0.0,
) -> Floats:
    """Return votes of a camera that was turned, and a share of two people who were mixed up.

    Its views may be late, of people who walk to and fro, or one way for a share of their speed.
    """
    rng = np.random.default_rng(RNG_SEED)
    places = rng.uniform(-0.4, 0.4, (200, 2))
    turn = Rotation.from_rotvec(np.radians(turn_deg) * np.array([0.6, 0.8, 0.0])).as_matrix()
    rays = np.column_stack([places, np.ones(200)]) @ turn.T
    offsets = rays[:, :2] / rays[:, 2:] - places + rng.normal(0, 0.003, (200, 2))
    motion = 0.3 * (np.array([one_way, 0.0]) + (1 - one_way) * rng.normal(size=(200, 2)))
    offsets -= late_s * motion
    wrong = rng.random(200) < others
    offsets[wrong] = rng.uniform(-0.2, 0.2, (int(wrong.sum()), 2))
    stated = motion + rng.normal(0, 0.02, (200, 2))
    pose = np.zeros(200)
    return np.column_stack([np.linspace(0, seconds, 200), pose, places, offsets, stated])


@each_case("degrees", [0.0, 0.5, 2.0, 8.0])
def test_turn_is_found_among_votes_of_mixed_people(degrees: float) -> None:
    found, least = turned_deg(Votes((voted(degrees, 0.4),)))
    assert found[0] == pytest.approx(degrees, abs=0.1)
    assert least[0] <= found[0] + 1e-9
    assert (moved(found, least) is not None) == (degrees > 0.25)


@each_case("one_way", [0.0, 0.5, 0.8, 1.0])
@each_case("late_s", [0.03, 0.05, 0.1, 0.15])
def test_delay_is_no_turn_and_hides_none(late_s: float, one_way: float) -> None:
    found, least = turned_deg(Votes((voted(0.0, 0.0, late_s=late_s, one_way=one_way),)))
    assert moved(found, least) is None and found[0] < 0.25
    turned, least = turned_deg(Votes((voted(2.0, 0.0, late_s=late_s, one_way=one_way),)))
    assert moved(turned, least) is not None
    assert one_way > 0.5 or turned[0] == pytest.approx(2.0, abs=0.2)


def test_few_votes_or_seconds_say_nothing() -> None:
    assert np.isnan(turned_deg(Votes((voted(2.0, 0.0)[::8],)))[0][0])
    assert np.isnan(turned_deg(Votes((voted(2.0, 0.0, seconds=3.0),)))[0][0])


def test_worst_camera_alone_is_named() -> None:
    found = moved(np.array([0.4, 1.5, np.nan]), np.array([0.3, 1.2, np.nan]))
    assert found is not None and found.camera == 1
    assert moved(np.full(3, np.nan), np.full(3, np.nan)) is None


def test_scale_and_axes_are_compared_with_people_after_ten_seconds(calm: Recording) -> None:
    noise = load_noise("openpose")
    for scale, words in ((10.0, "m tall: are the calibration's lengths metres"), (1.0, "")):
        cameras = tuple(
            Camera.from_world_to_camera(c.camera_id, c.image_size, c.K, c.R, scale * c.t)
            for c in calm.rig.cameras
        )
        check = WorldCheck(Rig(cameras), calm.skeleton, noise, Path("rig.toml"))
        watch = DisplacementWatch(calm.rig, check)
        for slot in range(round(11 * calm.fps)):
            views = {
                camera: view
                for camera in range(len(calm.rig))
                if (view := calm.view(slot % calm.num_slots, camera)) is not None
            }
            check.observe(slot / calm.fps, views)
        check.thread.join()
        events = watch.events()
        assert ("world-doubted" in [kind for kind, _, _ in events]) == bool(words)
        assert words in check.words and watch.events() == []


def test_camera_counts_as_moved_until_it_is_seen_to_be_back(calm: Recording) -> None:
    turned = knocked(calm, 1, 2.0, 703, 0.0)
    watch, kinds = DisplacementWatch(calm.rig), []
    start_s = 0.0
    for recording in (turned, calm):
        for record in replay(recording, ReplaySettings(policy="all")):
            later = replace(record, time_s=record.time_s + start_s)
            watch.observe(later, selected_views(recording, record.slot, record.arrived))
            kinds += [(kind, camera) for kind, _, camera in watch.events()]
        start_s += recording.num_slots / recording.fps
    assert kinds == [("camera-moved", "cam1"), ("camera-in-place", "cam1")]
