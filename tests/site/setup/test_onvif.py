"""The streams of ONVIF cameras: a fake camera that checks passwords as they do, and liars."""

from __future__ import annotations

import base64
import hashlib
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.site.setup import onvif
from e3pose.site.setup.onvif import Denied, Login, streams_of

LOGIN = Login("admin", "s3cret <&>")
BEHIND = timedelta(hours=7)  # the camera's clock, which nobody set
ENVELOPE = (
    '<?xml version="1.0" encoding="UTF-8"?>'
    '<SOAP-ENV:Envelope xmlns:SOAP-ENV="http://www.w3.org/2003/05/soap-envelope" '
    'xmlns:tt="http://www.onvif.org/ver10/schema" xmlns:trt="http://www.onvif.org/ver10/media/wsdl"'
    ' xmlns:tds="http://www.onvif.org/ver10/device/wsdl"><SOAP-ENV:Body>{}</SOAP-ENV:Body>'
    "</SOAP-ENV:Envelope>"
)
PROFILE = (
    '<trt:Profiles token="{token}" fixed="true"><tt:Name>{name}</tt:Name>'
    "<tt:VideoEncoderConfiguration><tt:Resolution><tt:Width>{width}</tt:Width><tt:Height>{height}"
    "</tt:Height></tt:Resolution><tt:RateControl><tt:FrameRateLimit>25</tt:FrameRateLimit>"
    "</tt:RateControl></tt:VideoEncoderConfiguration></trt:Profiles>"
)
NOT_AUTHORIZED = (
    "<SOAP-ENV:Fault><SOAP-ENV:Code><SOAP-ENV:Value>SOAP-ENV:Sender</SOAP-ENV:Value>"
    '<SOAP-ENV:Subcode><SOAP-ENV:Value xmlns:ter="http://www.onvif.org/ver10/error">'
    "ter:NotAuthorized</SOAP-ENV:Value></SOAP-ENV:Subcode></SOAP-ENV:Code></SOAP-ENV:Fault>"
)


@dataclass
class Camera:
    """A camera at loopback.

    Attributes:
        media: address of its media service; its own by default.
        stream: address of its streams, with `{}` for the profile.
        answers: in place of the true ones, by question.
        asked: what it was asked.
    """

    port: int = 0
    media: str = ""
    stream: str = "rtsp://127.0.0.1:554/{}"
    answers: dict[str, tuple[int, bytes]] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)

    @property
    def service(self) -> str:
        return f"http://127.0.0.1:{self.port}/onvif/device_service"

    def now(self) -> datetime:
        return datetime.now(timezone.utc) - BEHIND

    def answer(self, question: str) -> tuple[int, bytes]:
        name = re.findall(r"<s:Body><(\w+)", question)[0]
        self.asked.append(name)
        if name in self.answers:
            return self.answers[name]
        if name != "GetSystemDateAndTime" and not self.knows(question):
            return 400, ENVELOPE.format(NOT_AUTHORIZED).encode()
        return 200, ENVELOPE.format(getattr(self, name)(question)).encode()

    def knows(self, question: str) -> bool:
        """Judge a UsernameToken as WS-Security has it, by our own clock."""
        found = {key: re.findall(rf"<\w:{key}[^>]*>([^<]+)<", question) for key in
                 ("Username", "Password", "Nonce", "Created")}  # fmt: skip
        if not all(found.values()) or found["Username"] != [LOGIN.user]:
            return False
        created = found["Created"][0]
        made = datetime.strptime(created, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=timezone.utc)
        if abs(made - self.now()) > timedelta(seconds=30):
            return False
        nonce = base64.b64decode(found["Nonce"][0])
        right = hashlib.sha1(nonce + created.encode() + LOGIN.password.encode()).digest()
        return base64.b64encode(right).decode() == str(found["Password"][0])

    def GetSystemDateAndTime(self, _: str) -> str:
        now = self.now()
        return (
            "<tds:GetSystemDateAndTimeResponse><tds:SystemDateAndTime><tt:UTCDateTime><tt:Time>"
            f"<tt:Hour>{now.hour}</tt:Hour><tt:Minute>{now.minute}</tt:Minute><tt:Second>"
            f"{now.second}</tt:Second></tt:Time><tt:Date><tt:Year>{now.year}</tt:Year><tt:Month>"
            f"{now.month}</tt:Month><tt:Day>{now.day}</tt:Day></tt:Date></tt:UTCDateTime>"
            "</tds:SystemDateAndTime></tds:GetSystemDateAndTimeResponse>"
        )

    def GetCapabilities(self, _: str) -> str:
        media = self.media or f"http://127.0.0.1:{self.port}/onvif/media"
        return f"<tt:Media><tt:XAddr>{media}</tt:XAddr></tt:Media>"

    def GetProfiles(self, _: str) -> str:
        return PROFILE.format(token="main&amp;1", name="Main", width=2560, height=1440) + (
            PROFILE.format(token="sub", name="Sub", width=640, height=360)
        )

    def GetStreamUri(self, question: str) -> str:
        token = re.findall(r"<ProfileToken>([^<]+)<", question)[0]
        uri = self.stream.format(token.replace("&amp;", "_"))
        return f"<trt:MediaUri><tt:Uri>{uri}</tt:Uri></trt:MediaUri>"


class Silent(BaseHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Say nothing."""


@contextmanager
def serving(handler: type[Silent]) -> Iterator[int]:
    """Serve at loopback; yield the port."""
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        try:
            yield server.server_port
        finally:
            server.shutdown()


@pytest.fixture
def camera() -> Iterator[Camera]:
    made = Camera()

    class Handler(Silent):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"])).decode()
            status, answer = made.answer(body)
            self.send_response(status)
            if status == 302:
                self.send_header("Location", answer.decode())
                answer = b""
            self.send_header("Content-Length", str(len(answer)))
            self.end_headers()
            self.wfile.write(answer)

    with serving(Handler) as made.port:
        yield made


def test_a_camera_tells_its_streams_for_its_password(camera: Camera) -> None:
    main, sub = streams_of(camera.service, LOGIN)
    assert main.name == "Main, 2560 × 1440, 25 per second"
    assert main.url == "rtsp://admin:s3cret%20%3C%26%3E@127.0.0.1:554/main_1"
    assert sub.name == "Sub, 640 × 360, 25 per second" and sub.url.endswith("/sub")
    assert camera.asked.count("GetStreamUri") == 2
    assert "s3cret" not in str(camera.asked)


def test_a_password_is_asked_for_where_a_camera_has_one(camera: Camera) -> None:
    with pytest.raises(Denied, match="wants a user and password"):
        streams_of(camera.service)
    with pytest.raises(Denied, match="wants another user and password"):
        streams_of(camera.service, Login("admin", "wrong"))
    camera.knows = lambda question: "Username" not in question  # type: ignore[method-assign]
    assert [stream.url for stream in streams_of(camera.service)] == [
        "rtsp://127.0.0.1:554/main_1", "rtsp://127.0.0.1:554/sub",
    ]  # fmt: skip


@each_case(
    ("question", "status", "answer", "said"),
    [
        ("GetProfiles", 200, b"no xml", "answers no ONVIF"),
        ("GetProfiles", 200, b"<a>" * 9999, "answers no ONVIF"),
        ("GetProfiles", 200, b"x" * 2**19, "answers no ONVIF"),
        ("GetProfiles", 200, b'<!DOCTYPE a [<!ENTITY b "c">]><a/>', "answers no ONVIF"),
        ("GetProfiles", 200, ENVELOPE.format("").encode(), "has no stream"),
        ("GetProfiles", 302, b"http://127.0.0.1:1/", "answers no ONVIF .HTTP 302."),
        ("GetCapabilities", 500, ENVELOPE.format("<SOAP-ENV:Fault><a>tired</a></SOAP-ENV:Fault>")
         .encode(), "tired"),
        ("GetStreamUri", 200, ENVELOPE.format("").encode(), "expected one of its own"),
        ("GetSystemDateAndTime", 200, ENVELOPE.format("<tt:UTCDateTime/>").encode(),
         "another user and password"),
    ],
)  # fmt: skip
def test_no_answer_is_refused(
    camera: Camera, question: str, status: int, answer: bytes, said: str
) -> None:
    camera.answers = {question: (status, answer)}
    with pytest.raises(InputError, match=said):
        streams_of(camera.service, LOGIN)


@each_case(
    "stream", ["rtsp://10.0.0.9/{}", "file:///etc/passwd", "http://127.0.0.1/{}", "rtsp://[bad"]
)
def test_streams_of_others_are_refused(camera: Camera, stream: str) -> None:
    camera.stream = stream
    with pytest.raises(InputError, match="expected one of its own"):
        streams_of(camera.service, LOGIN)


def test_a_camera_sends_us_nowhere_else(camera: Camera) -> None:
    camera.media = "http://192.0.2.7/onvif/media"
    with pytest.raises(InputError, match=r"sends us to .http://192\.0\.2\.7"):
        streams_of(camera.service, LOGIN)


def test_who_is_not_there_is_said() -> None:
    with pytest.raises(InputError, match="connection refused"):
        streams_of("http://127.0.0.1:9/onvif/device_service")
    for service in ("ftp://127.0.0.1/", "http://[bad", "rubbish"):
        with pytest.raises(InputError, match="expected an http address"):
            streams_of(service)


def test_an_answer_by_drops_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each byte comes within the time for one: nothing but a limit for all of them ends it."""
    monkeypatch.setattr(onvif, "WHOLE_S", 0.5)
    stop = threading.Event()

    class Drops(Silent):
        def do_POST(self) -> None:
            self.send_response(200)
            self.end_headers()
            while not stop.wait(0.05):
                self.wfile.write(b" ")

    with serving(Drops) as port:
        with pytest.raises(InputError, match="no answer in time"):
            streams_of(f"http://127.0.0.1:{port}/device")
        stop.set()
