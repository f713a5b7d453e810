"""What a page may open as a source: devices, streams, and films in the folder alone."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.site.setup.cameras import check_typed, find_films, free_name
from e3pose.site.setup.plan import ChosenCamera


def test_films_are_found_below_the_folder_and_no_others(tmp_path: Path) -> None:
    for name in ("a.mp4", "deep/b.MKV", "notes.txt", ".hidden/c.mp4", "1/2/3/4/5/far.mp4"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    os.symlink(tmp_path / "a.mp4", tmp_path / "link.mp4")
    assert find_films(tmp_path) == ["a.mp4", "deep/b.MKV"]


def test_sources_are_as_a_site_file_has_them(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").touch()
    assert check_typed(" usb:2 ", tmp_path) == "usb:2"
    assert check_typed("rtsp://10.0.0.7/stream", tmp_path) == "rtsp://10.0.0.7/stream"
    assert check_typed("a.mp4", tmp_path) == str(tmp_path / "a.mp4")
    assert check_typed(str(tmp_path / "a.mp4"), tmp_path) == str(tmp_path / "a.mp4")


@each_case(
    ("source", "said"),
    [
        ("../outside.mp4", "a folder above your films"),
        ("/etc/passwd", "a folder above your films"),
        ("recorded:../../walk", "a folder above your films"),
        ("link/a.mp4", "a folder above your films"),
        ("absent.mp4", "file not found"),
        ("file:///etc/passwd", "expected rtsp://HOST/PATH"),
        ("concat://a", "expected rtsp://HOST/PATH"),
        ("rtsp://", "expected rtsp://HOST/PATH"),
        ("gstreamer:videotestsrc ! filesink location=x", "a pipeline may write files"),
        ("usb:x", "usb:by-id/NAME"),
        ("0", "usb:0"),
        ("", "expected usb:0"),
        ("a\nb", "expected usb:0"),
        ("x" * 501, "expected usb:0"),
    ],
)
def test_what_no_page_may_open_is_refused(source: str, said: str, tmp_path: Path) -> None:
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    (outside / "a.mp4").touch()
    (tmp_path / "outside.mp4").touch()
    os.symlink(outside, inside / "link")
    with pytest.raises(InputError, match=said):
        check_typed(source, inside)


def test_cameras_are_named_after_their_films_else_by_number() -> None:
    taken = (ChosenCamera("cam0"), ChosenCamera("door"))
    assert free_name("/films/left.mp4", taken) == "left"
    assert free_name("/films/door.mp4", taken) == "cam1"
    assert free_name("/films/-x.mp4", taken) == "cam1"
    assert free_name("usb:0", taken) == "cam1"
