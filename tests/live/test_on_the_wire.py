"""A site of small cameras, one of them a phone: what it sends to its edge, and who attacks it."""

from __future__ import annotations

import socket
import ssl
import struct
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx
import psutil
import pytest
from tests.camera.mjpeg import jpeg, network_camera
from tests.live.processes import COMPILE_S, e3pose, small_cameras
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.camera.phone import MAX_FRAME_BYTES, PER_ADDRESS
from e3pose.camera.phone_file import PhoneFile, save_phone
from e3pose.model.camera import Rig
from e3pose.settings.site_file import load_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.phones import show_phone
from e3pose.wire.codec import encode
from e3pose.wire.network import NetworkTransport, open_network
from e3pose.wire.site_messages import PictureQuestion
from e3pose.wire.topics import of_camera

GROWTH_MB = 100.0
FRAMES = 10  # of the phone, that must come through under each attack


SITE = """
format = "e3pose-site"
version = 1
name = "lab"
calibration = "calib.toml"
skeleton = "coco17"
fps = 12.5
[link]
endpoint = "tcp/127.0.0.1:{port}"
[loop]
cameras = 2
predictor = "zero-velocity"
"""
JPEG = b"\xff\xd8\xff"


class Tap:
    """Carries connections to a port, and keeps what clients send."""

    def __init__(self, port: int) -> None:
        self.taken, self._port = bytearray(), port
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port, self._open = self._listening.getsockname()[1], [self._listening]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listening.accept()
                self._open.append(client)
                try:
                    edge = socket.create_connection(("127.0.0.1", self._port))
                except OSError:  # it does not listen yet
                    client.close()
                    continue
                self._open.append(edge)
                for ends in ((client, edge, True), (edge, client, False)):
                    threading.Thread(target=self._carry, args=ends, daemon=True).start()

    def _carry(self, source: socket.socket, to: socket.socket, kept: bool) -> None:
        with suppress(OSError):
            while part := source.recv(65536):
                if kept:
                    self.taken += part
                to.sendall(part)
            to.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        for each in self._open:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()


class Phone:
    """The page of a phone, which sends until it is told to stop; and what it needs to attack.

    Attributes:
        taken: frames that were accepted.
        code: that it has used.
        head: of a request with its secret.
    """

    def __init__(self, url: str, trusts: ssl.SSLContext) -> None:
        self.base, _, self.code = url.partition("/#")
        self.port, self.trusts, self.taken = int(self.base.rpartition(":")[2]), trusts, 0
        with self.client() as client:
            assert eventually(lambda: self._joins(client))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def client(self) -> httpx.Client:
        return httpx.Client(base_url=self.base, verify=self.trusts, timeout=10.0)

    def _joins(self, client: httpx.Client) -> bool:
        with suppress(httpx.TransportError):
            secret = client.post("/join", content=self.code).json()["secret"]
            self.head = {"Authorization": f"Bearer {secret}"}
            return True
        return False

    def _run(self) -> None:
        while not self._stop.is_set():
            with suppress(httpx.TransportError), self.client() as client:  # as its page tries again
                while not self._stop.wait(0.05):
                    image = jpeg(100 + self.taken % 2)
                    self.taken += client.post("/frame", content=image, headers=self.head).is_success

    def close(self) -> None:
        self._stop.set()
        self._thread.join()


def too_large(phone: Phone) -> None:
    with phone.client() as client, suppress(httpx.WriteError):  # it hangs up on who goes on
        big = client.post("/frame", content=bytes(2 * MAX_FRAME_BYTES), headers=phone.head)
        assert big.status_code == 413


def too_many(phone: Phone) -> None:
    frame = jpeg(90)
    with phone.client() as client:
        for _ in range(200):
            assert client.post("/frame", content=frame, headers=phone.head).is_success


def wrong_token(phone: Phone) -> None:
    with phone.client() as client:
        for number in range(30):
            for headers in ({"Authorization": f"Bearer guess{number}"}, {}):
                answer = client.post("/frame", content=jpeg(90), headers=headers)
                assert answer.status_code == 401


def second_phone(phone: Phone) -> None:
    with phone.client() as client:
        for code in (phone.code, "", "x" * 200):
            assert client.post("/join", content=code).status_code == 403


def hostile_pictures(phone: Phone) -> None:
    header = b"\xff\xd8\xff\xc0" + struct.pack(">HBHHB", 11, 8, 60_000, 60_000, 1) + b"\1\x11\0"
    scans = jpeg(90)[:-2] + b"\xff\xda\0\x08\1\1\0\0\x3f\0" * 2000
    with phone.client() as client:
        for content in (header, scans, b"GIF89a", b"", jpeg(90)[:200]):
            client.post("/frame", content=content, headers=phone.head)
        assert client.post("/frame", content=header, headers=phone.head).status_code == 415


@contextmanager
def raw(phone: Phone) -> Iterator[socket.socket]:
    plain = socket.create_connection(("127.0.0.1", phone.port), 10.0)
    with phone.trusts.wrap_socket(plain, server_hostname="127.0.0.1") as secure:
        yield secure


def half(phone: Phone, length: int = 100_000) -> bytes:
    """Return the begin of a frame of the phone."""
    head = f"POST /frame HTTP/1.1\r\nHost: x\r\nAuthorization: {phone.head['Authorization']}"
    return f"{head}\r\nContent-Length: {length}\r\n\r\n".encode() + jpeg(90)[:100]


def slow_uploads(phone: Phone) -> None:
    """More of them than an address may have; each says a byte now and then."""
    with ExitStack() as stack:
        opened = []
        for _ in range(2 * PER_ADDRESS):
            with suppress(OSError):
                opened.append(stack.enter_context(raw(phone)))
                opened[-1].sendall(half(phone)[:-50])
        for _ in range(5):
            for one in opened:
                with suppress(OSError):  # cut, to make room
                    one.sendall(b"\0")
            threading.Event().wait(0.2)


def closed_in_mid_frame(phone: Phone) -> None:
    for _ in range(20):
        with suppress(OSError), raw(phone) as one:
            one.sendall(half(phone))


def no_tls(phone: Phone) -> None:
    for said in (b"GET / HTTP/1.1\r\n\r\n", bytes(100_000), b"\x16\x03\x01\x40\x00" + bytes(999)):
        with suppress(OSError), socket.create_connection(("127.0.0.1", phone.port), 5.0) as one:
            one.sendall(said)


ATTACKS: tuple[Callable[[Phone], None], ...] = (
    too_large, too_many, wrong_token, second_phone, hostile_pictures, slow_uploads,
    closed_in_mid_frame, no_tls,
)  # fmt: skip


@dataclass
class Small:
    """Three cameras, the last of them a phone, behind a tap.

    Attributes:
        rig: cameras of 64 x 48 pixels.
        tap: between cameras and edge.
        phone: what sends pictures to the last camera.
        camera: the program of the last camera.
        follower: of the site.
        transport: with the rights of an operator.
        log: of all programs.
    """

    rig: Rig
    tap: Tap
    phone: Phone
    camera: subprocess.Popen[bytes]
    follower: Follower
    transport: NetworkTransport
    log: Path

    def slots(self) -> tuple[int, int]:
        """Return the newest slot, and how many were given up."""
        status = self.follower.status
        return (-1, 0) if status is None else (status.slot, status.slots_lost)

    def online(self) -> bool:
        status = self.follower.status
        return status is not None and all(one.online for one in status.cameras)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Small]:
    folder = tmp_path_factory.mktemp("small")
    rig = small_cameras(folder, (4, 0), (0, 4), (-4, 0))
    port, log = free_port(), folder / "log"
    (folder / "site.toml").write_text(SITE.format(port=port))
    file, follower = folder / "anna.toml", Follower("lab")
    save_phone(file, PhoneFile(free_port()))
    shown = show_phone(file, None, "127.0.0.1")
    with ExitStack() as stack:
        tap = stack.enter_context(closing(Tap(port)))

        def start(*words: str) -> subprocess.Popen[bytes]:
            output = stack.enter_context(log.open("ab"))
            program = subprocess.Popen(e3pose(*words), cwd=folder, stdout=output, stderr=output)
            stack.callback(program.wait)
            stack.callback(program.kill)
            return program

        start("edge", "site.toml")
        url = stack.enter_context(network_camera(12.5))
        for camera_id, source in zip(rig.camera_ids, (url, url, shown.source), strict=True):
            camera = start(
                "camera", "--site", "lab", "--name", camera_id, "--source", source, "--endpoint",
                f"tcp/127.0.0.1:{tap.port}", "--detector", "eyes.py:Eyes", "--meter", "model",
                "--pictures",
            )  # fmt: skip
        trusts = ssl.create_default_context(cafile=str(folder / "authority.pem"))
        phone = stack.enter_context(closing(Phone(shown.url, trusts)))
        link = viewer_link(load_site(folder), None, operates=True)
        transport = stack.enter_context(closing(open_network(link)))
        follower.listen(transport)
        made = Small(rig, tap, phone, camera, follower, transport, log)
        assert eventually(made.online, COMPILE_S), log.read_text()[-2000:]
        yield made


def test_cameras_send_no_image_unless_somebody_asks(small: Small) -> None:
    assert eventually(lambda: small.slots()[0] > 40, COMPILE_S), small.log.read_text()[-2000:]
    sent = bytes(small.tap.taken)
    assert small.rig.camera_ids[0].encode() in sent, "the tap hears them"
    assert JPEG not in sent
    assert not any(jpeg(level)[-100:] in sent for level in (100, 101, 140, 180))
    assert len(sent) < 40 * 3 * 64 * 48, "less than the images have pixels"
    topic = of_camera("lab", small.rig.camera_ids[0], "picture")
    asked = encode(PictureQuestion())
    assert eventually(lambda: small.transport.ask(topic, asked, 3.0))
    assert JPEG in small.tap.taken, "a picture that was asked for goes through the tap"


def test_the_phone_sends_on_and_the_site_goes_on(small: Small) -> None:
    phone, held = small.phone, psutil.Process(small.camera.pid).memory_info().rss
    for attack in ATTACKS:
        count, (slot, lost) = phone.taken, small.slots()
        attack(phone)

        def goes_on(count: int = count, slot: int = slot) -> bool:
            flows = small.slots()[0] > slot + 10 and small.online()
            return flows and phone.taken >= count + FRAMES

        assert eventually(goes_on), (attack.__name__, small.follower.status)
        assert small.slots()[1] == lost, attack.__name__
        assert small.camera.poll() is None, attack.__name__
    assert psutil.Process(small.camera.pid).memory_info().rss - held < GROWTH_MB * 1e6
    assert "Traceback" not in small.log.read_text()
