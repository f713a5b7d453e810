"""A phone as a source: its frames and times, and what others send to its port."""

from __future__ import annotations

import socket
import ssl
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from tests.manual_clock import ManualClock
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.base.clock import WallClock
from e3pose.base.errors import InputError
from e3pose.camera import phone
from e3pose.camera import probe as phone_probe
from e3pose.camera.live_source import make_source
from e3pose.camera.phone import PhoneSource
from e3pose.camera.phone_file import CODE_S, PhoneFile, load_phone, save_phone
from e3pose.site.phones import Shown, show_phone

START_NS = 1_700_000_000 * 10**9


def jpeg(width: int = 64, height: int = 48, grey: int = 90) -> bytes:
    return bytes(cv2.imencode(".jpg", np.full((height, width, 3), grey, np.uint8))[1].tobytes())


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(START_NS)


@pytest.fixture
def shown(tmp_path: Path) -> Shown:
    path = tmp_path / "anna.toml"
    save_phone(path, PhoneFile(free_port()))
    return show_phone(path, None, "127.0.0.1")


@pytest.fixture
def source(shown: Shown, clock: ManualClock, tmp_path: Path) -> Iterator[PhoneSource]:
    made = PhoneSource(tmp_path / "anna.toml", clock)
    made.open()
    yield made
    made.close()


@pytest.fixture
def client(shown: Shown, tmp_path: Path) -> Iterator[httpx.Client]:
    """A phone that trusts the authority, as one does on which it was installed."""
    trusts = ssl.create_default_context(cafile=str(tmp_path / "authority.pem"))
    with httpx.Client(base_url=shown.url.partition("/#")[0], verify=trusts, timeout=10) as made:
        yield made


def code_of(shown: Shown) -> str:
    return shown.url.partition("#")[2]


def join(client: httpx.Client, shown: Shown) -> dict[str, str]:
    answer = client.post("/join", content=code_of(shown))
    assert answer.status_code == 200, answer.text
    return {"Authorization": f"Bearer {answer.json()['secret']}"}


def test_frames_come_with_the_time_at_which_the_phone_took_them(
    source: PhoneSource, client: httpx.Client, shown: Shown, clock: ManualClock
) -> None:
    secret = join(client, shown)
    now_ms = client.get("/time", headers=secret).json()["now_ms"]
    assert now_ms == pytest.approx(START_NS / 1e6)
    sent = {**secret, "Taken": str(now_ms - 40), "Rate": "30"}
    assert client.post("/frame", content=jpeg(grey=120), headers=sent).json() == {"fps": 30.0}
    frame = source.read()
    assert frame is not None and frame.image_size == (64, 48) and source.fps == 30
    assert (START_NS - frame.captured_ns) / 1e6 == pytest.approx(40, abs=0.01)
    image = frame.image()
    assert image.shape == (48, 64, 3) and abs(int(image[0, 0, 0]) - 120) < 3


def test_a_time_that_cannot_be_is_that_of_the_arrival(
    source: PhoneSource, client: httpx.Client, shown: Shown
) -> None:
    secret = join(client, shown)
    impossible = ("", "nan", "inf", "1e40", "-5", "0", "x" * 50, "1800000000000")
    for number, taken in enumerate(impossible):
        sent = {**secret, "Taken": taken}
        assert client.post("/frame", content=jpeg(), headers=sent).status_code == 200
        frame = source.read()
        assert frame is not None and frame.captured_ns == START_NS + number, taken


def test_the_rate_is_measured_and_the_newest_frame_counts(
    source: PhoneSource, client: httpx.Client, shown: Shown, clock: ManualClock
) -> None:
    secret = join(client, shown)
    for grey in range(100, 120):
        said = client.post("/frame", content=jpeg(grey=grey), headers=secret).json()
        clock.advance(0.1)
    assert said["fps"] == pytest.approx(10.0)
    frame = source.read()
    assert frame is not None and abs(int(frame.image()[0, 0, 0]) - 119) < 3
    assert source._newest is None, "it is given once"


def test_a_code_is_for_one_phone_and_a_new_one_forgets_it(
    source: PhoneSource, client: httpx.Client, shown: Shown, tmp_path: Path
) -> None:
    first = join(client, shown)
    again = client.post("/join", content=code_of(shown))
    assert again.status_code == 403 and "used already" in again.json()["detail"]
    assert client.post("/frame", content=jpeg(), headers=first).status_code == 200
    other = show_phone(tmp_path / "anna.toml", None, "127.0.0.1")
    assert (other.port, other.fingerprint) == (shown.port, shown.fingerprint)
    assert client.post("/frame", content=jpeg(), headers=first).status_code == 401
    second = join(client, other)
    assert client.post("/frame", content=jpeg(), headers=second).status_code == 200


def test_codes_grow_old_and_secrets_are_kept_as_hashes(shown: Shown, tmp_path: Path) -> None:
    path = tmp_path / "anna.toml"
    told = load_phone(path)
    with pytest.raises(InputError, match="too old"):
        told.taken(code_of(shown), time.time() + CODE_S + 1)
    taken, secret = told.taken(code_of(shown), time.time())
    save_phone(path, taken)
    assert secret not in path.read_text() and code_of(shown) not in path.read_text()
    assert path.stat().st_mode & 0o077 == 0
    assert (tmp_path / "page.key").stat().st_mode & 0o077 == 0
    assert taken.sends(secret) and not taken.sends("") and not told.sends("")


def test_who_is_not_the_phone_sends_nothing(
    source: PhoneSource, client: httpx.Client, shown: Shown
) -> None:
    for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": "Bearer"}):
        assert client.post("/frame", content=jpeg(), headers=headers).status_code == 401
        assert client.get("/time", headers=headers).status_code == 401
    assert client.post("/join", content="wrong").status_code == 403
    secret = join(client, shown)
    foreign = {**secret, "Origin": "https://evil.example"}
    assert client.post("/frame", content=jpeg(), headers=foreign).status_code == 403
    assert source.read() is None
    assert client.get("/anna.toml").status_code == client.get("/../page.key").status_code == 404
    assert client.put("/frame").status_code == 501


NO_FRAMES = [
    (b"", 415, "no JPEG"),
    (b"GIF89a" + bytes(100), 415, "no JPEG"),
    (b"\xff\xd8\xff\xc0\x00\x11\x08\xff\xff\xff\xff", 415, "65535 x 65535"),
    (bytes(phone.MAX_FRAME_BYTES + 1), 413, "more than 1048576 bytes"),
]


def test_what_is_no_frame_is_refused(
    source: PhoneSource, client: httpx.Client, shown: Shown
) -> None:
    secret = join(client, shown)
    for body, status, said in NO_FRAMES:
        try:
            answer = client.post("/frame", content=body, headers=secret)
            assert answer.status_code == status and said in answer.json()["detail"]
        except httpx.WriteError:  # it hung up before all of it was sent
            assert status == 413
    chunked = client.post("/frame", content=iter([jpeg()]), headers=secret)
    assert chunked.status_code == 411
    assert client.post("/join", content="x" * 300).status_code == 413
    assert source.read() is None
    assert client.post("/frame", content=jpeg(), headers=secret).status_code == 200


def test_a_damaged_frame_is_black_and_a_turned_phone_is_told(
    source: PhoneSource, client: httpx.Client, shown: Shown
) -> None:
    secret = join(client, shown)
    whole = jpeg()
    client.post("/frame", content=whole[: len(whole) // 3] + bytes(50), headers=secret)
    frame = source.read()
    assert frame is not None and frame.image().shape == (48, 64, 3)
    turned = client.post("/frame", content=jpeg(48, 64), headers=secret)
    assert turned.status_code == 415 and "The phone was turned" in turned.json()["detail"]


def test_the_page_holds_nothing_and_speaks_to_nobody_else(
    source: PhoneSource, client: httpx.Client
) -> None:
    for path in ("/", "/phone.js", "/phone.css"):
        answer = client.get(path)
        assert answer.status_code == 200 and "connect-src 'self'" in str(answer.headers)
        assert "http://" not in answer.text and "https://" not in answer.text.replace(
            "open the address with https", ""
        )
        assert "Python" not in answer.headers["Server"]


def test_silent_connections_make_room_for_the_phone(
    source: PhoneSource, client: httpx.Client, shown: Shown
) -> None:
    secret = join(client, shown)
    silent = [socket.create_connection(("127.0.0.1", shown.port)) for _ in range(40)]
    try:
        for _ in range(3):
            assert client.get("/time", headers=secret).status_code == 200
        server = source._server
        assert server is not None
        assert eventually(lambda: len(server._held) <= phone.PER_ADDRESS)
        assert sum(known for _, known, _ in server._held.values()) == 1  # it never was cut
    finally:
        for one in silent:
            one.close()


def test_who_reads_next_gets_the_frames(
    shown: Shown, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The set-up lets go, and the camera of the site reads: the phone sends on."""
    monkeypatch.setattr(phone, "BIND_S", 0.5)
    monkeypatch.setattr(phone_probe, "COUNT_S", 1.0)
    trusts = ssl.create_default_context(cafile=str(tmp_path / "authority.pem"))
    stop, secret = threading.Event(), dict[str, str]()

    def send() -> None:
        while not stop.wait(0.02):
            try:
                with httpx.Client(base_url=shown.url.partition("/#")[0], verify=trusts) as client:
                    if not secret:
                        secret.update(join(client, shown))
                    while not stop.wait(0.05):
                        client.post("/frame", content=jpeg(), headers=secret)
            except httpx.TransportError:
                continue

    sending = threading.Thread(target=send)
    sending.start()
    try:
        for _ in range(2):
            seen = phone_probe.probe(shown.source)
            assert seen.image_size == (64, 48) and seen.fps > 0
        reader = make_source(shown.source, "anna", WallClock(), None)
        reader.open()
        with pytest.raises(InputError, match="does another program read this phone"):
            make_source(shown.source, "anna", WallClock(), None).open()
        assert eventually(lambda: reader.read() is not None)
        reader.close()
    finally:
        stop.set()
        sending.join()


def test_files_that_are_no_phone_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "anna.toml"
    with pytest.raises(InputError, match="file not found"):
        make_source(f"phone:{path}", "anna", WallClock(), None)
    path.write_text('format = "e3pose-phone"\nversion = 1\nport = 99999\n')
    with pytest.raises(InputError, match="port"):
        make_source(f"phone:{path}", "anna", WallClock(), None)
    save_phone(path, PhoneFile(free_port()))
    with pytest.raises(InputError, match="no certificate, expected what `e3pose phone` makes"):
        make_source(f"phone:{path}", "anna", WallClock(), None).open()
    with pytest.raises(InputError, match="live cameras cannot play slower"):
        make_source(f"phone:{path}", "anna", WallClock(), None, pace=0.5)
    with pytest.raises(InputError, match=r"expected NAME\.toml"):
        show_phone(tmp_path / "anna", None)
