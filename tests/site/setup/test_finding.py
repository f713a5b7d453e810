"""What a page may open as a source, and cameras that are found in the network."""

from __future__ import annotations

import os
import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.site.setup.cameras import check_typed, find_films, free_name, look_around, read_answer
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


ANSWER = """<?xml version="1.0" encoding="utf-8"?>
<SOAP-ENV:Envelope xmlns:SOAP-ENV="http://www.w3.org/2003/05/soap-envelope"
 xmlns:wsa="http://schemas.xmlsoap.org/ws/2004/08/addressing"
 xmlns:d="http://schemas.xmlsoap.org/ws/2005/04/discovery">
<SOAP-ENV:Header><wsa:RelatesTo>uuid:{asked}</wsa:RelatesTo></SOAP-ENV:Header>
<SOAP-ENV:Body><d:ProbeMatches><d:ProbeMatch>
<d:Scopes>onvif://www.onvif.org/type/video_encoder onvif://www.onvif.org/name/Front%20door
 onvif://www.onvif.org/hardware/IPC-1</d:Scopes>
<d:XAddrs>http://{host}/onvif/device_service</d:XAddrs>
</d:ProbeMatch></d:ProbeMatches></SOAP-ENV:Body></SOAP-ENV:Envelope>"""


@contextmanager
def responder(answers: Callable[[str], list[bytes]]) -> Iterator[tuple[str, int]]:
    """Answer one question with some datagrams; yield where it listens."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))

        def answer() -> None:
            question, sender = server.recvfrom(65_507)
            found = re.search(rb"uuid:([0-9a-f-]{36})", question)
            assert found is not None and b"NetworkVideoTransmitter" in question
            for message in answers(found[1].decode()):
                server.sendto(message, sender)

        thread = threading.Thread(target=answer)
        thread.start()
        yield ("127.0.0.1", server.getsockname()[1])
        thread.join(10)


def test_a_camera_that_answers_is_found_with_its_name() -> None:
    def answers(asked: str) -> list[bytes]:
        return [
            b"no xml at all",
            ANSWER.format(asked="another-question", host="127.0.0.1").encode(),
            ANSWER.format(asked=asked, host="127.0.0.1").encode(),
        ]

    with responder(answers) as place:
        (camera,) = look_around(0.5, place)
    with responder(lambda asked: []) as place:
        assert look_around(0.2, place) == []
    assert camera.host == "127.0.0.1" and camera.name == "Front door IPC-1"
    assert camera.service == "http://127.0.0.1/onvif/device_service"


@each_case(
    "answer",
    [
        ANSWER.format(asked="ours", host="10.0.0.66"),  # sends us to somebody else
        ANSWER.format(asked="ours", host="[::bad"),
        '<!DOCTYPE a [<!ENTITY b "c">]>' + ANSWER.format(asked="ours", host="10.0.0.7"),
        "<a>" * 20_000,
        "",
    ],
)
def test_answers_that_lie_are_left_out(answer: str) -> None:
    assert read_answer(answer.encode(), "ours", "10.0.0.7") is None
    assert read_answer(answer.encode("utf-16"), "ours", "10.0.0.7") is None
