"""Sources of cameras in settings files."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.settings.sources import is_live, is_recorded, located, place_of, put_away, revealed


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


SECRET = "rtsp://admin:s3cret@10.0.0.7/1"


def test_an_address_with_a_password_moves_to_a_private_file(tmp_path: Path) -> None:
    named = put_away(SECRET, tmp_path, "cam0")
    assert named == "secret:secrets/cam0" and is_live(named)
    assert (tmp_path / "secrets" / "cam0").stat().st_mode & 0o777 == 0o600
    assert revealed(located(named, lambda name: tmp_path / name)) == SECRET
    assert put_away(SECRET, tmp_path, "cam0") == "secret:secrets/cam0-2"  # another camera's stays
    for source in ("usb:0", "rtsp://10.0.0.7/1", named):
        assert put_away(source, tmp_path, "cam1") == source


def test_an_address_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOOR", SECRET)
    assert is_live("env:DOOR") and located("env:DOOR", near) == "env:DOOR"
    assert revealed("env:DOOR") == SECRET
    with pytest.raises(InputError, match="env:NO_DOOR: missing: the camera's address"):
        revealed("env:NO_DOOR")


def test_a_secret_that_others_read_or_that_is_no_address_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "cam0"
    for mode, text, words in (
        (0o644, SECRET, "others can read"),
        (0o600, "walk.mp4", "no address"),
        (0o600, "", "empty"),
    ):
        file.write_text(text)
        file.chmod(mode)
        with pytest.raises(InputError, match=words) as refused:
            revealed(f"secret:{file}")
        assert "s3cret" not in str(refused.value)
    with pytest.raises(InputError, match="secret:FILE"):
        place_of("secret:")
