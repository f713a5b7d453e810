"""Cameras in the network: a responder that answers as ONVIF cameras do, and those that lie."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tests.cases import each_case

from e3pose.site.setup.cameras import look_around, read_answer

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
    assert camera.host == "127.0.0.1" and camera.name == "Front door IPC-1"
    assert camera.service == "http://127.0.0.1/onvif/device_service"


def test_nobody_answers() -> None:
    with responder(lambda asked: []) as place:
        assert look_around(0.2, place) == []


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


def test_an_honest_answer_is_read() -> None:
    answer = ANSWER.format(asked="ours", host="10.0.0.7").encode()
    assert read_answer(answer, "ours", "10.0.0.7") is not None
