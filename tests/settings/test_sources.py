"""Sources of cameras in settings files."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.settings.sources import is_recorded, located, place_of


def near(name: str) -> Path:
    return Path("/site") / name


@each_case(
    "source", ["usb:0", "gstreamer:v4l2src ! appsink", "rtsp://10.0.0.2/stream", "udp://@:5000"]
)
def test_devices_and_streams_have_no_place(source: str) -> None:
    assert place_of(source) is None
    assert located(source, near) == source


def test_files_are_relative_to_the_settings_file() -> None:
    assert located("cam1.mp4", near) == "/site/cam1.mp4"
    assert located("/films/cam1.mp4", near) == "/films/cam1.mp4"


def test_recordings_keep_their_prefix() -> None:
    assert located("recorded:take 1", near) == "recorded:/site/take 1"
    assert place_of("recorded:take 1") == "take 1"
    assert is_recorded("recorded:take 1")
    assert not is_recorded("cam1.mp4")
    assert not is_recorded(None)


def test_recording_without_a_name_is_refused() -> None:
    with pytest.raises(InputError, match="recorded:RECORDING"):
        located("recorded:", near)
