"""Frames are counted, not believed."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from tests.camera.mjpeg import network_camera

from e3pose.base.errors import InputError
from e3pose.camera.frame_rate import LEAST, NEWEST, FrameRate, rate_hz, rounded_hz
from e3pose.camera.probe import Probe, probe, probe_all
from e3pose.site.check.sources import compare_rates


def times_ns(fps: float, count: int, begin_s: float = 0.0, jitter_s: float = 0.0) -> list[int]:
    jitter = np.random.default_rng(1).uniform(-jitter_s, jitter_s, count)
    return [round((begin_s + n / fps + j) * 1e9) for n, j in enumerate(jitter)]


def test_rate_is_that_of_the_frames() -> None:
    assert rate_hz(times_ns(12.5, 38)) == pytest.approx(12.5)
    assert rate_hz(times_ns(12.5, 38, jitter_s=0.02)) == pytest.approx(12.5, rel=0.02)
    assert rate_hz([]) is None and rate_hz([5]) is None and rate_hz([5, 5]) is None


def test_nominal_rate_is_kept_where_nothing_else_was_measured() -> None:
    assert rounded_hz(24.6, 25.0) == 25.0 and rounded_hz(None, 25.0) == 25.0
    assert rounded_hz(12.4937, 25.0) == 12.5 and rounded_hz(31.2, 25.0) == 31.2


def test_running_rate_follows_its_source_and_forgets_pauses() -> None:
    rate = FrameRate()
    for taken_ns in times_ns(12.5, LEAST - 1):
        rate.add(taken_ns)
    assert rate.hz(25.0) == 25.0
    for taken_ns in times_ns(12.5, NEWEST):
        rate.add(taken_ns)  # begins anew, as time went back
    assert rate.hz(25.0) == pytest.approx(12.5)
    for taken_ns in times_ns(30.0, LEAST, begin_s=60.0):
        rate.add(taken_ns)
    assert rate.hz(25.0) == pytest.approx(30.0)


def test_frames_of_a_network_camera_are_counted() -> None:
    with network_camera(12.5) as url:
        seen = probe(url)
    assert seen.fps == pytest.approx(12.5, rel=0.1) and seen.nominal_fps == 25.0
    assert seen.image_size == (64, 48) and "(25 announced)" in seen.rate_words()


def test_cameras_are_probed_at_once_and_each_failure_is_its_own() -> None:
    together, done = threading.Barrier(3, timeout=30), list[tuple[int, int]]()

    def good() -> Probe:
        together.wait()  # breaks unless all three are asked at once
        return Probe("usb:0", (640, 480), 25.0, False)

    def bad() -> Probe:
        together.wait()
        time.sleep(0.05)
        raise InputError("source usb:1: cannot be opened")

    found = probe_all({"a": good, "b": bad, "c": good}, lambda *share: done.append(share))
    assert list(found) == ["a", "b", "c"] and isinstance(found["b"], InputError)
    assert isinstance(found["a"], Probe) and done == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_site_faster_than_a_source_is_a_problem_with_the_rate_to_set() -> None:
    probes = {
        "a": Probe("http://a", (640, 480), 12.5, False, 25.0),
        "b": Probe("http://b", (640, 480), 23.0, False, 25.0),
    }
    slow, fine = compare_rates(probes, 25.0)
    assert (slow.level, fine.level) == ("problem", "ok")
    assert slow.found.endswith("fps = 25: 50% of the slots ordered of it get no view")
    assert slow.advice == "fps = 12.5 in the site file, or raise the camera's frame rate"
    assert [finding.level for finding in compare_rates(probes, 12.5)] == ["ok", "ok"]
