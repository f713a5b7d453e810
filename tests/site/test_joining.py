"""A camera joins by a code: whoever lacks it, or comes twice, late or in between, gets nothing."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.ports import free_port
from tests.waiting import eventually
from zeroconf import ServiceInfo

from e3pose.base.errors import InputError
from e3pose.base.rate_limit import Rate
from e3pose.settings.camera_file import load_node
from e3pose.settings.site_file import load_site
from e3pose.site.camera_program import join_site
from e3pose.site.check.link import _certificates
from e3pose.site.joining import Joining
from e3pose.wire.keys import joining as protocol
from e3pose.wire.keys.authority import expires, make_key, problem_with, public_of
from e3pose.wire.keys.folder import add_keys, init_keys, read_roll
from e3pose.wire.keys.joining import (
    CODE_S,
    MAX_LINE,
    SERVICE,
    TO_EDGE,
    JoinLine,
    OpenSite,
    _key,
    answer,
    ask_to_join,
    find_sites,
    join_port,
    line_of,
    read_code,
    read_line,
)
from e3pose.wire.keys.renewal import renew_keys

pytestmark = pytest.mark.slow
NOW = datetime.datetime.now(datetime.timezone.utc)


class Door:
    """A site with cameras cam1, which has a certificate, cam2 and cam4, on a loop of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.edge = folder, free_port()
        self.keys, self.lines = folder / "keys", list[str]()
        self.name = f"lab-{self.edge}"  # others in the network may be tests as well
        init_keys(self.keys, self.name, ["edge.local"], NOW)
        add_keys(self.keys, "cam1", NOW)
        (folder / "site.toml").write_text(
            f'format = "e3pose-site"\nversion = 1\nname = "{self.name}"\nfps = 20\n'
            f'calibration = "rig.toml"\n[link]\nkeys = "keys"\n'
            f'endpoint = "tls/127.0.0.1:{self.edge}"\n'
        )
        self.site, self.before = load_site(folder / "site.toml"), read_roll(self.keys)
        self.joining = Joining(self.site, ("cam1", "cam2", "cam4"), self.lines.append)
        self.address = "127.0.0.1", join_port(self.edge)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def call(self, function: Callable[[], Any]) -> Any:
        async def call() -> Any:
            return function()

        return asyncio.run_coroutine_threadsafe(call(), self._loop).result(20)

    def code(self) -> str:
        """Open the door; return the code."""
        self.call(self.joining.open)
        return self.joining.code

    def shut(self) -> None:
        """Wait until nobody listens."""
        assert eventually(lambda: not self.joining.body()["left_s"])

    def end(self) -> None:
        if self.joining._door is not None and self.joining.code:
            self.call(self.joining._door.cancel)
        self.shut()
        asyncio.run_coroutine_threadsafe(asyncio.sleep(0.1), self._loop).result(5)  # what closes
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10)
        self._loop.close()

    def talk(self, *lines: bytes) -> list[bytes]:
        """Send lines one after the other; return what comes for each."""
        with socket.create_connection(self.address, 5) as made, made.makefile("rwb") as stream:
            made.settimeout(5)
            came = []
            with contextlib.suppress(ConnectionError):
                for line in lines:
                    stream.write(line)
                    stream.flush()
                    came.append(stream.readline())
            return came


@pytest.fixture
def door(tmp_path: Path) -> Iterator[Door]:
    made = Door(tmp_path)
    yield made
    made.end()


def other(code: str) -> str:
    return f"{(int(code) + 1) % 10**6:06d}"


def hello(code: str, name: str = "cam2") -> bytes:
    from spake2 import SPAKE2_A

    return line_of(name=name, pake=SPAKE2_A(code.encode()).start())


def test_camera_gets_its_certificate_and_its_key_never_leaves_it(door: Door) -> None:
    assert door.joining.body()["waiting"] == ["cam2", "cam4"]
    private, public = make_key()
    made = ask_to_join(door.address, door.code(), "cam2", public, str)
    assert (made.site, made.port, made.hosts[-1]) == (door.name, door.edge, "edge.local")
    certificate, authority = made.certificate.encode(), made.authority.encode()
    assert problem_with(certificate, private, authority, NOW) is None
    door.shut()
    assert (door.joining.joined, door.joining.said) == ("cam2", "cam2 joined.")
    assert door.joining.body()["waiting"] == ["cam4"]
    roll, place = read_roll(door.keys), door.keys / "cameras" / "cam2"
    assert roll.cameras["cam2"] == "cam2#2"
    assert sorted(path.name for path in place.iterdir()) == ["authority.pem", "camera.pem"]
    assert list(_certificates(door.keys, roll, door.name)) == []  # nothing for `check` to say
    later = NOW + datetime.timedelta(days=100)
    renew_keys(door.keys, "cam2", later)
    renewed = (place / "camera.pem").read_bytes()
    assert expires(renewed) > expires(certificate) and not (place / "camera.key").exists()
    assert public_of(renewed) == public_of(certificate)


def wrong_code(door: Door) -> None:
    code = door.code()
    with pytest.raises(InputError, match="wrong code, or somebody between"):
        ask_to_join(door.address, other(code), "cam2", make_key()[1], str)
    with pytest.raises(InputError, match=r"it was tried|no code any more|press"):  # a second try
        ask_to_join(door.address, code, "cam2", make_key()[1], str)
    door.shut()
    assert "The code is used up, by 127.0.0.1: wrong code" in door.joining.said
    assert door.lines[-1] == f"join: {door.joining.said}"


def second_try_beside_the_first(door: Door) -> None:
    code = door.code()
    with socket.create_connection(door.address) as first, first.makefile("rwb") as stream:
        stream.write(hello(code))
        stream.flush()
        assert read_line(stream.readline()).pake
        with pytest.raises(InputError, match="it was tried"):
            ask_to_join(door.address, code, "cam2", make_key()[1], str)
    door.shut()
    assert "the other side ended the connection" in door.joining.said


def code_after_two_minutes(door: Door) -> None:
    assert CODE_S == 120
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(protocol, "CODE_S", 0.2)
        code = door.code()
        door.shut()
    assert door.joining.said == "No camera typed the code in time."
    with pytest.raises(InputError, match="press 'Let a camera join'"):
        ask_to_join(door.address, code, "cam2", make_key()[1], str)


def many_tries(door: Door) -> None:
    codes = set()
    for _ in range(5):
        codes.add(code := door.code())
        with pytest.raises(InputError, match="code is shown already"):
            door.code()
        with pytest.raises(InputError, match="wrong code"):
            ask_to_join(door.address, other(code), "cam2", make_key()[1], str)
        door.shut()
    with pytest.raises(InputError, match=r"too many codes: the next one in \d+ s"):
        door.code()
    assert len(codes) > 1


@contextlib.contextmanager
def between(relay: Callable[[Any], None]) -> Iterator[tuple[str, int]]:
    """Take one connection of a camera, as somebody between it and its edge; yield the place."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def take() -> None:
            accepted, _ = listening.accept()
            with accepted, accepted.makefile("rwb") as camera:
                relay(camera)

        thread = threading.Thread(target=take)
        thread.start()
        yield listening.getsockname()
        thread.join(10)


def man_in_the_middle(door: Door) -> None:
    """Somebody relays, and seals another public key with the key of a code that he guessed."""
    from spake2 import SPAKE2_A

    code, names = door.code(), (b"camera cam2", b"edge")

    def relay(camera: Any) -> None:
        asked = read_line(camera.readline())
        theirs, _ = answer(other(code), asked.name, asked.pake)
        camera.write(line_of(pake=theirs))
        camera.flush()
        camera.readline()
        side = SPAKE2_A(other(code).encode(), *names)
        (came,) = door.talk(line_of(name="cam2", pake=side.start()))[:1]
        key = _key(side, read_line(came).pake)
        camera.write(line_of(sealed=key.encrypt(TO_EDGE, make_key()[1], None)))

    with between(relay) as place, pytest.raises(InputError, match="wrong code, or somebody betw"):
        ask_to_join(place, code, "cam2", make_key()[1], str)


def relay_that_changes_a_byte(door: Door) -> None:
    """Somebody passes all on and changes the name, the exchange, the sealed key or certificate."""
    for line, part in enumerate((b'"cam', b'"pake":"QRST', b'"sealed":"', b'"sealed":"')):
        code = door.code()

        def relay(a: Any, line: int = line, part: bytes = part) -> None:
            onward = socket.create_connection(door.address)
            with onward, onward.makefile("rwb") as b:
                for number, (come, go) in enumerate(((a, b), (b, a), (a, b), (b, a))):
                    if not (said := come.readline()):
                        return
                    if number == line:
                        at = said.index(part[:8]) + len(part)
                        other_byte = b"4" if said[at] != b"4"[0] else b"5"
                        said = said[:at] + other_byte + said[at + 1 :]
                    with contextlib.suppress(OSError):
                        go.write(said)
                        go.flush()

        with between(relay) as place, pytest.raises(InputError):
            ask_to_join(place, code, "cam2", make_key()[1], str)
        door.shut()
        assert (read_roll(door.keys) == door.before) == (line < 3), line
    # The edge had signed: as the camera refused what came, that is worthless and its name free.
    assert read_roll(door.keys).revoked == ("cam2#2",) and not door.joining.joined
    ask_to_join(door.address, door.code(), "cam2", make_key()[1], str)


def camera_that_does_not_keep_its_certificate(door: Door) -> None:
    """Its disk is full, it dies, or says nothing: nothing holds its name."""

    def full(_: JoinLine) -> None:
        raise OSError("No space left on device")

    with pytest.raises(OSError, match="No space left"):
        ask_to_join(door.address, door.code(), "cam2", make_key()[1], full)
    door.shut()
    assert "the other side ended the connection" in door.joining.said
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("e3pose.site.joining.TRY_S", 3.0)  # a try, on a busy machine too
        code = door.code()
        with pytest.raises(InputError, match="did not hear that the keys were kept"):
            ask_to_join(door.address, code, "cam2", make_key()[1], lambda _: door.shut())
    roll = read_roll(door.keys)
    assert (roll.cameras, roll.revoked) == (door.before.cameras, ("cam2#2", "cam2#3"))
    assert door.joining.body()["waiting"] == ["cam2", "cam4"] and not door.joining.joined
    add_keys(door.keys, "cam4", NOW, kind="viewer")
    with pytest.raises(OSError, match="No space left"):
        ask_to_join(door.address, door.code(), "cam4", make_key()[1], full)
    door.shut()
    roll = read_roll(door.keys)
    assert "cam4" in roll.viewers and "cam4" not in roll.cameras and len(roll.revoked) == 3
    ask_to_join(door.address, door.code(), "cam2", make_key()[1], str)
    door.shut()
    assert read_roll(door.keys).cameras["cam2"] == "cam2#6"


def certificate_that_comes_too_late(door: Door) -> None:
    """The try ends while the edge signs: nothing holds the name."""
    admit = Joining._admit

    def slowly(joining: Joining, name: str, public: bytes) -> dict[str, Any]:
        time.sleep(1.0)
        return admit(joining, name, public)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("e3pose.site.joining.TRY_S", 0.5)
        patch.setattr(Joining, "_admit", slowly)
        with pytest.raises(InputError):
            ask_to_join(door.address, door.code(), "cam2", make_key()[1], str)
        door.shut()
    assert eventually(lambda: read_roll(door.keys).revoked == ("cam2#2",))
    assert read_roll(door.keys).cameras == door.before.cameras
    ask_to_join(door.address, door.code(), "cam2", make_key()[1], str)
    door.shut()


def lines_of_other_things(door: Door) -> None:
    """What is no whole line of a camera does not use the code up."""
    code = door.code()
    whole = hello(code)
    for line in (
        b"\n", b"GET / HTTP/1.1\r\n", b"{}\n", b"[" * 5000 + b"\n", b"\xff\xfe\n", b"null\n",
        whole.replace(b'"version":2', b'"version":1'), whole.replace(b"}", b',"more":1}'),
        whole.replace(b"cam2", b"../../cam2"), whole.replace(b"cam2", b"a/b"),
        whole.replace(b"cam2", b"-x"), whole.replace(b'"cam2"', b'""'),
        whole.replace(b'"cam2"', b"2"), whole.replace(b'"pake":"', b'"pake":"AAAA'),
        whole.replace(b"cam2", b"c" * 65),
    ):  # fmt: skip
        came = door.talk(line)
        assert came == [b""] or read_line(came[0]).problem, line
    for large in (b"x" * (MAX_LINE + 10), b"x" * 2_000_000):
        assert door.talk(large + b"\n")[:1] in ([], [b""])
    assert door.joining.code == code
    assert [*door.keys.parent.glob("*cam2*")] == []
    ask_to_join(door.address, code, "cam2", make_key()[1], str)  # who has the code still gets in
    door.shut()
    assert door.joining.joined == "cam2"


def points_of_no_group(door: Door) -> None:
    """Messages of SPAKE2 that are no point, of small order, or from the wrong side."""
    zero, minus = (1).to_bytes(32, "little"), (2**255 - 20).to_bytes(32, "little")
    sides = (b"A" + zero, b"A" + minus, b"A" + b"\xff" * 32, b"B" + b"\x02" * 32)
    door.joining._rate = Rate(9, 9, time.monotonic)
    for pake in (*sides, b"A", b""):
        door.code()
        came = door.talk(line_of(name="cam2", pake=pake), line_of(sealed=b"x" * 50))
        assert read_line(came[-1] or came[0]).problem, pake
        door.shut()


def keys_that_are_none(door: Door) -> None:
    """Who has the code, but sends no public key, gets none made."""
    for public in (b"", b"x" * 65, b"\x04" + bytes(64)):
        with pytest.raises(InputError, match=r"public key: found .* bytes, expected a point on P"):
            ask_to_join(door.address, door.code(), "cam2", public, str)
        door.shut()


def name_that_is_taken(door: Door) -> None:
    for name in ("cam1", "cam9"):
        with pytest.raises(InputError, match=rf"{name}, expected one without a certificate: cam2"):
            ask_to_join(door.address, door.code(), name, make_key()[1], str)
        door.shut()
        assert f"{name} got no certificate: camera: found {name}" in door.joining.said


def idle_connections(door: Door) -> None:
    """Connections that say nothing keep nobody out."""
    code = door.code()
    with contextlib.ExitStack() as stack:
        for _ in range(40):
            stack.enter_context(socket.create_connection(door.address))
        ask_to_join(door.address, code, "cam2", make_key()[1], str)
    door.shut()
    assert door.joining.joined == "cam2"


ATTACKS = (
    wrong_code, second_try_beside_the_first, code_after_two_minutes, many_tries, man_in_the_middle,
    relay_that_changes_a_byte, lines_of_other_things, points_of_no_group, keys_that_are_none,
    name_that_is_taken, idle_connections, camera_that_does_not_keep_its_certificate,
    certificate_that_comes_too_late,
)  # fmt: skip


@pytest.mark.parametrize("attack", ATTACKS)
def test_who_has_not_the_code_gets_nothing(door: Door, attack: Callable[[Door], None]) -> None:
    attack(door)
    door.shut()
    if door.joining.joined:
        assert read_roll(door.keys).cameras.keys() == {"cam1", "cam2"}
        return
    assert read_roll(door.keys) == door.before
    assert [path.name for path in (door.keys / "cameras").iterdir()] == ["cam1"]


def typing(door: Door, change: Callable[[str], str] = str) -> Callable[[str], str]:
    """Return a person who reads the code on the page when the camera asks for it."""

    def ask(question: str) -> str:
        assert "Code that site" in question
        return change(f"{door.joining.code[:3]} {door.joining.code[3:]}")

    return ask


def test_new_camera_gets_keys_and_a_file_that_it_starts_with(door: Door, tmp_path: Path) -> None:
    place = tmp_path / "pi" / "cam2.toml"
    place.parent.mkdir()
    given = {"camera": "cam2", "source": "usb:0", "endpoint": f"tls/localhost:{door.edge}"}
    door.code()
    assert f"cam2 joined site {door.name}" in join_site(place, given, typing(door))
    node = load_node(place)
    assert (node.site, node.camera, str(node.endpoint)) == (door.name, "cam2", given["endpoint"])
    assert node.keys == place.with_name("cam2") and place.stat().st_mode & 0o77 == 0
    assert (node.keys / "camera.key").stat().st_mode & 0o777 == 0o600
    assert node.keys.stat().st_mode & 0o777 == 0o700
    files = sorted(path.name for path in node.keys.iterdir())
    assert files == ["authority.pem", "camera.key", "camera.pem"]


def test_edge_is_found_in_the_network(door: Door, tmp_path: Path) -> None:
    def found() -> bool:
        return OpenSite(door.name, door.address) in find_sites(1.0)

    assert not found()
    door.code()
    assert eventually(found, 20)
    given = {"camera": "cam2", "source": "usb:0", "site": door.name}
    join_site(tmp_path / "cam2.toml", given, typing(door))
    node = load_node(tmp_path / "cam2.toml")
    assert str(node.endpoint) == f"tls/localhost:{door.edge}"


def test_announcement_that_makes_no_sense_is_left_out() -> None:
    here, site = [b"\x7f\0\0\1"], b"lab"
    for properties, addresses, port in (
        ({}, here, 1), ({"site": None}, here, 1), ({"site": b"../lab"}, here, 1),
        ({"site": b"\xff"}, here, 1), ({"site": site}, [], 1), ({"site": site}, here, None),
        ({"site": site}, here, 0), ({"site": site}, here, 65_535),
    ):  # fmt: skip
        said: dict[str, Any] = {"properties": properties, "addresses": addresses, "port": port}
        assert protocol.open_site(ServiceInfo(SERVICE, f"x.{SERVICE}", **said)) is None


def test_what_cannot_be_is_said_before_the_code_is_used(door: Door, tmp_path: Path) -> None:
    given = {"camera": "cam2", "source": "usb:0", "endpoint": f"tls/localhost:{door.edge}"}
    with pytest.raises(InputError, match="nobody listens at localhost"):
        join_site(tmp_path / "cam2.toml", given, typing(door))
    code = door.code()
    taken = tmp_path / "cam2"
    taken.mkdir()
    (taken / "camera.key").write_text("of before")
    (tmp_path / "old.toml").write_text(
        'format = "e3pose-camera"\nversion = 1\nsite = "lab"\ncamera = "cam2"\nsource = "usb:0"\n'
        'endpoint = "tls/localhost:1"\n'
    )
    for name, changed, what in (
        ("cam2.toml", {}, "folder exists and is not empty"),
        ("cam2.toml", {"keys": "new", "rotation": 45}, "rotation"),
        ("cam2.toml", {"keys": "new", "fps": -1.0}, "fps"),
        ("cam2.toml", {"keys": "new", "camera": "../x"}, "camera"),
        ("cam2.toml", {"keys": "new", "endpoint": "tcp/127.0.0.1:1"}, "expected tls/HOST:PORT"),
        ("old.toml", {}, 'old.toml: keys: missing: keys = "cam2"'),
    ):
        asked = given | changed if name == "cam2.toml" else {}
        with pytest.raises(InputError, match=what):
            join_site(tmp_path / name, asked, typing(door))
    for words in ("", "12345", "1234567", "abcdef", "１２３４５６"):
        with pytest.raises(InputError, match="expected the six digits"):
            join_site(tmp_path / "cam2.toml", given | {"keys": "new"}, lambda _, w=words: w)  # type: ignore[misc]
    assert (door.joining.code, (taken / "camera.key").read_text()) == (code, "of before")
    with pytest.raises(InputError, match="wrong code"):
        join_site(tmp_path / "cam2.toml", given | {"keys": "new"}, typing(door, other_of))
    left = sorted(path.name for path in tmp_path.iterdir() if not path.name.startswith("."))
    assert left == ["cam2", "keys", "old.toml", "site.toml"]


def test_camera_of_another_site_gets_no_keys_and_keeps_no_name(door: Door, tmp_path: Path) -> None:
    path = tmp_path / "cam2.toml"
    path.write_text(
        'format = "e3pose-camera"\nversion = 1\nsite = "home"\ncamera = "cam2"\nsource = "usb:0"\n'
        f'keys = "new"\nendpoint = "tls/localhost:{door.edge}"\n'
    )
    before = path.read_bytes()
    door.code()
    with pytest.raises(InputError, match=rf'site: found home, expected "{door.name}"'):
        join_site(path, {}, typing(door))
    door.shut()
    assert not (tmp_path / "new").exists() and path.read_bytes() == before
    assert read_roll(door.keys).cameras == door.before.cameras
    path.write_text(before.decode().replace("home", door.name))
    door.code()
    assert "cam2 joined" in join_site(path, {}, typing(door))


def other_of(shown: str) -> str:
    return other(read_code(shown))
