"""Zenoh on loopback: access rights and presence."""

from __future__ import annotations

import contextlib
import datetime
import os
import socket
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.wire.access import Certificates, Link, check_link
from e3pose.wire.keys.folder import add_keys, certificates_in, init_keys, read_roll, revoke_keys
from e3pose.wire.network import NetworkTransport, check_port, open_network

pytestmark = pytest.mark.slow

SILENCE_S = 0.4  # how long to wait for what must not come


class Site:
    """A site with certificates, whose programs are opened by name."""

    def __init__(self, folder: Path) -> None:
        now = datetime.datetime.now(datetime.timezone.utc)
        self.folder, self.port = folder, free_port()
        self.open: list[NetworkTransport] = []
        init_keys(folder, "lab", [], now)
        for camera in ("cam1", "cam2", "cam3"):
            add_keys(folder, camera, now)
        add_keys(folder, "wall", now, kind="viewer")
        add_keys(folder, "desk", now, kind="operator")
        revoke_keys(folder, "cam3")

    def edge(self) -> NetworkTransport:
        roll = read_roll(self.folder)
        link = Link(
            "edge", "lab", f"tls/127.0.0.1:{self.port}", certificates_in(self.folder, "edge")
        )
        return self.keep(open_network(link, roll.cameras, roll.viewers, operators=roll.operators))

    def camera(self, name: str) -> NetworkTransport:
        files = certificates_in(self.folder / "cameras" / name, "camera")
        return self.keep(open_network(Link("camera", "lab", f"tls/localhost:{self.port}", files)))

    def viewer(self) -> NetworkTransport:
        files = certificates_in(self.folder / "viewers" / "wall", "viewer")
        return self.keep(open_network(Link("viewer", "lab", f"tls/localhost:{self.port}", files)))

    def operator(self) -> NetworkTransport:
        files = certificates_in(self.folder / "operators" / "desk", "operator")
        return self.keep(open_network(Link("viewer", "lab", f"tls/localhost:{self.port}", files)))

    def keep(self, transport: NetworkTransport) -> NetworkTransport:
        self.open.append(transport)
        return transport


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    made = Site(tmp_path_factory.mktemp("site") / "keys")
    yield made
    for transport in made.open:
        transport.close()


def test_camera_neither_reads_nor_forges_anothers_messages(site: Site) -> None:
    edge = site.edge()
    views: list[tuple[str, bytes]] = []
    orders: list[bytes] = []
    spied: list[tuple[str, bytes]] = []
    seen: list[bytes] = []
    edge.subscribe("e3pose/lab/camera/*/view", lambda t, p: views.append((t, p)))
    edge.answer("e3pose/lab/camera/*/clock", lambda t, p: b"time of " + p)
    cam1, cam2, revoked, viewer = (
        site.camera("cam1"),
        site.camera("cam2"),
        site.camera("cam3"),
        site.viewer(),
    )
    cam1.subscribe("e3pose/lab/order/cam1", lambda t, p: orders.append(p))
    viewer.subscribe("e3pose/lab/poses", lambda t, p: seen.append(p))
    later: list[bytes] = []
    viewer.subscribe("e3pose/lab/poses-delayed", lambda t, p: later.append(p))
    for spy, name in ((cam2, "cam2"), (viewer, "viewer"), (revoked, "revoked")):
        for topic in ("e3pose/lab/order/cam1", "e3pose/lab/camera/cam1/**", "e3pose/**"):
            spy.subscribe(topic, lambda t, p, name=name: spied.append((name, p)))  # type: ignore[misc]

    def ready() -> bool:
        cam1.publish("e3pose/lab/camera/cam1/view", b"mine")
        edge.publish("e3pose/lab/order/cam1", b"to cam1")
        edge.publish("e3pose/lab/poses", b"people")
        edge.publish("e3pose/lab/poses-delayed", b"people again")
        time.sleep(0.05)
        return bool(views and orders and seen and later)

    assert eventually(ready)
    views.clear()
    for liar in (cam2, viewer, revoked):
        liar.publish("e3pose/lab/camera/cam1/view", b"forged")
        liar.publish("e3pose/lab/order/cam1", b"forged")
        liar.publish("e3pose/lab/poses", b"forged")
        liar.publish("e3pose/lab/poses-delayed", b"forged")
    revoked.publish("e3pose/lab/camera/cam3/view", b"from the revoked")
    assert revoked.ask("e3pose/lab/camera/cam3/clock", b"?", SILENCE_S) is None
    assert cam2.ask("e3pose/lab/camera/cam1/clock", b"?", SILENCE_S) is None
    assert cam1.ask("e3pose/lab/camera/cam1/clock", b"?", 10.0) == b"time of ?"
    cam2.publish("e3pose/lab/camera/cam2/view", b"honest")
    assert eventually(lambda: ("e3pose/lab/camera/cam2/view", b"honest") in views)
    time.sleep(SILENCE_S)
    assert {payload for _, payload in views} <= {b"honest", b"mine"}
    assert set(orders) == {b"to cam1"} and set(seen) == {b"people"}
    assert set(later) == {b"people again"}
    # The one thing on `e3pose/**` that a viewer may hear are the poses.
    assert {payload for _, payload in spied} <= {b"people", b"people again"}
    edge.close()


def test_operators_alone_control_the_edge_and_see_what_viewers_see(site: Site) -> None:
    edge, seen = site.edge(), list[bytes]()
    asked: list[bytes] = []

    def answer(_: str, payload: bytes) -> bytes:
        asked.append(payload)
        return b"done"

    edge.answer("e3pose/lab/control/desk", answer)
    operator, viewer, camera = site.operator(), site.viewer(), site.camera("cam1")
    operator.subscribe("e3pose/lab/poses", lambda t, p: seen.append(p))

    def ready() -> bool:
        edge.publish("e3pose/lab/poses", b"people")
        return bool(seen) and operator.ask("e3pose/lab/control/desk", b"mine", 0.5) == b"done"

    assert eventually(ready)
    asked.clear()
    for other in (viewer, camera):
        assert other.ask("e3pose/lab/control/desk", b"not allowed", SILENCE_S) is None
    operator.publish("e3pose/lab/order/cam1", b"forged")
    assert operator.ask("e3pose/lab/control/desk", b"again", 10.0) == b"done"
    assert asked == [b"again"]
    edge.close()


def test_operators_ask_cameras_through_the_edge_however_often_it_ends(site: Site) -> None:
    topic, asked = "e3pose/lab/camera/cam1/picture", list[bytes]()

    def answer(_: str, payload: bytes) -> bytes:
        asked.append(payload)
        return b"picture"

    operator, viewer = site.operator(), site.viewer()  # before there is an edge
    assert operator.ask(topic, b"nobody there", 0.1) is None and not operator.connected()
    for life in (b"first", b"second"):
        edge = site.edge()
        camera, other, third = (site.camera(name) for name in ("cam1", "cam2", "cam2"))
        camera.answer(topic, answer)
        other.answer(topic, lambda _, payload: b"forged")
        assert eventually(lambda: operator.ask(topic, b"soon", 2.0) == b"picture")
        assert operator.connected()
        asked.clear()
        for stranger in (viewer, third):
            assert stranger.ask(topic, b"not allowed", SILENCE_S) is None
        assert operator.ask(topic, life, 10.0) == b"picture" and asked == [life]
        for program in (camera, other, third, edge):
            program.close()


def test_edge_that_comes_back_is_found_again(site: Site) -> None:
    camera = site.camera("cam1")
    orders: list[bytes] = []
    camera.subscribe("e3pose/lab/order/cam1", lambda t, p: orders.append(p))
    for life in (b"first", b"second"):
        edge = site.edge()

        def heard(edge: NetworkTransport = edge, life: bytes = life) -> bool:
            edge.publish("e3pose/lab/order/cam1", life)
            time.sleep(0.05)
            return life in orders

        assert eventually(heard)
        edge.close()


def listening() -> set[str]:
    """Return the local addresses on which this process listens, as the kernel writes them."""
    inodes = set()
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # another thread closed it meanwhile
            inodes.add(os.readlink(link))
    return {
        line.split()[1]
        for table in ("tcp", "tcp6")
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]
        if line.split()[3] == "0A" and f"socket:[{line.split()[9]}]" in inodes
    }


def test_camera_listens_nowhere_and_the_edge_as_configured(site: Site) -> None:
    before = listening()
    site.camera("cam1")
    assert listening() <= before  # what an earlier test left may end meanwhile
    edge = site.edge()
    assert listening() - before == {f"0100007F:{site.port:04X}"}
    edge.close()


def test_presence_is_noticed_and_its_end(site: Site) -> None:
    edge = site.edge()
    seen: list[tuple[str, bool]] = []
    edge.watch("e3pose/lab/camera/*/alive", lambda t, there: seen.append((t, there)))
    camera = site.camera("cam2")
    camera.be_present("e3pose/lab/camera/cam2/alive")
    camera.be_present("e3pose/lab/camera/cam1/alive")  # not its own
    assert eventually(lambda: ("e3pose/lab/camera/cam2/alive", True) in seen)
    camera.close()
    assert eventually(lambda: ("e3pose/lab/camera/cam2/alive", False) in seen)
    assert not any("cam1" in topic for topic, _ in seen)
    edge.close()


def test_two_sites_share_one_router() -> None:
    port = free_port()
    router = open_network(Link("edge", "router", f"tcp/127.0.0.1:{port}"))
    got: dict[str, list[bytes]] = {"lab": [], "hall": []}
    programs = []
    for name in got:
        edge = open_network(
            Link("edge", name, "tcp/127.0.0.1:0", upstream=(f"tcp/127.0.0.1:{port}",))
        )
        edge.subscribe(f"e3pose/{name}/camera/*/view", lambda t, p, name=name: got[name].append(p))  # type: ignore[misc]
        camera = open_network(Link("camera", name, f"tcp/127.0.0.1:{port}"))
        programs += [edge, camera]

        def arrived(camera: NetworkTransport = camera, name: str = name) -> bool:
            camera.publish(f"e3pose/{name}/camera/cam1/view", name.encode())
            time.sleep(0.05)
            return bool(got[name])

        assert eventually(arrived)
    assert set(got["lab"]) == {b"lab"} and set(got["hall"]) == {b"hall"}
    for program in [*programs, router]:
        program.close()


def test_what_is_far_too_large_does_not_even_arrive(site: Site) -> None:
    edge, camera = site.edge(), site.camera("cam1")
    got: list[tuple[str, int]] = []
    for what in ("view", "heartbeat"):
        edge.subscribe(
            f"e3pose/lab/camera/*/{what}", lambda t, p: got.append((t.rsplit("/", 1)[1], len(p)))
        )

    def arrived() -> bool:
        got.clear()
        camera.publish("e3pose/lab/camera/cam1/view", b"x" * 2**18)
        camera.publish("e3pose/lab/camera/cam1/heartbeat", b"x" * 2**12)
        time.sleep(0.1)
        return {what for what, _ in got} == {"view", "heartbeat"}

    assert eventually(arrived)
    seen = {*got}
    for _ in range(3):
        camera.publish("e3pose/lab/camera/cam1/view", b"x" * 2**20)
        camera.publish("e3pose/lab/camera/cam1/heartbeat", b"x" * 2**18)
        time.sleep(SILENCE_S)
        seen |= {*got}
    assert eventually(arrived)  # the link is there still
    assert seen | {*got} == {("view", 2**18), ("heartbeat", 2**12)}
    edge.close()


@pytest.mark.parametrize("role", ["edge", "router"])
def test_question_or_hello_that_is_far_too_large_does_not_even_arrive(
    role: Literal["edge", "router"],
) -> None:
    endpoint, hellos = f"tcp/127.0.0.1:{free_port()}", list[int]()
    with (
        contextlib.closing(open_network(Link(role, "lab", endpoint))) as edge,
        contextlib.closing(open_network(Link("camera", "lab", endpoint))) as camera,
    ):
        edge.answer("e3pose/lab/camera/*/clock", lambda topic, payload: b"time")
        edge.subscribe("e3pose/lab/camera/*/hello", lambda topic, p: hellos.append(len(p)))

        def arrived() -> bool:
            hellos.clear()
            camera.publish("e3pose/lab/camera/cam1/hello", b"x" * 2**14)
            time.sleep(0.05)
            return 2**14 in hellos

        def answer(size: int) -> bytes | None:
            return camera.ask("e3pose/lab/camera/cam1/clock", b"x" * size, SILENCE_S)

        assert eventually(arrived)
        assert eventually(lambda: answer(2**14) == b"time")
        assert [answer(2**16) for _ in range(3)] == [None] * 3
        for _ in range(3):
            camera.publish("e3pose/lab/camera/cam1/hello", b"x" * 2**16)
        time.sleep(SILENCE_S)
        assert set(hellos) == {2**14}
        assert eventually(arrived) and eventually(lambda: answer(2**14) == b"time")


def test_what_is_said_at_once_arrives_whole() -> None:
    port, got = free_port(), 0
    edge = open_network(Link("edge", "lab", f"tcp/127.0.0.1:{port}"))
    viewer = open_network(Link("viewer", "lab", f"tcp/127.0.0.1:{port}"))

    def take(topic: str, payload: bytes) -> None:
        nonlocal got
        got += len(payload) > 1

    viewer.subscribe("e3pose/lab/poses", take)

    def arrived() -> bool:
        edge.publish("e3pose/lab/poses", b"xx")
        return got > 0

    assert eventually(arrived)
    time.sleep(SILENCE_S)
    got = 0
    for _ in range(100):
        for _ in range(6):  # a batch of Zenoh each: they wait for its sending thread
            edge.publish("e3pose/lab/poses", b"x" * 60_000)
        time.sleep(0.05)
    assert eventually(lambda: got == 600, 5.0), got
    viewer.close()
    edge.close()


def test_port_that_is_taken_is_reported_with_what_to_do() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError) as orders:
            open_network(Link("edge", "lab", f"tcp/127.0.0.1:{port}"))
    assert str(orders.value) == (
        f"endpoint tcp/127.0.0.1:{port}: port {port} is in use: stop the program that has it "
        f"(`ss -ltnp 'sport = :{port}'` names it), such as another run of this site, or choose "
        "another port"
    )


def test_port_is_checked_without_opening_it() -> None:
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        check_port(endpoint)  # nobody listens yet
        taken.listen()
        with pytest.raises(InputError, match="is in use: stop the program"):
            check_port(endpoint)
    check_port(endpoint)
    check_port("tls/192.0.2.1:7447")  # of another machine: said when it is opened


def test_what_is_wrong_with_an_endpoint_names_no_foreign_source(tmp_path: Path) -> None:
    for name in "abc":
        (tmp_path / name).write_text("no certificate")
    files = Certificates(tmp_path / "a", tmp_path / "b", tmp_path / "c")
    for link, reason in (
        (Link("edge", "lab", "tcp/192.0.2.1:0", insecure=True), "192.0.2.1 is no address of this"),
        (Link("edge", "lab", "tcp/host.invalid:7447", insecure=True), "cannot be used: "),
        (Link("edge", "lab", "tls/127.0.0.1:0", files), "No private key found"),
    ):
        with pytest.raises(InputError, match=reason) as orders:
            open_network(link)
        assert ".rs" not in str(orders.value) and "cargo" not in str(orders.value)


@pytest.mark.parametrize(
    ("link", "orders"),
    [
        (Link("edge", "lab", "tcp/0.0.0.0:7447"), "plain tcp beyond this machine"),
        (Link("edge", "lab", "tcp/[::]:7447"), "plain tcp beyond this machine"),
        (Link("camera", "lab", "tcp/edge.local:7447"), "plain tcp beyond this machine"),
        (Link("edge", "lab", "tls/0.0.0.0:7447"), "tls without certificates"),
        (Link("edge", "lab", "udp/127.0.0.1:7447"), "expected tls/HOST:PORT"),
        (Link("edge", "lab", "tcp/127.0.0.1:99999"), "expected tls/HOST:PORT"),
        (Link("edge", "lab", "tcp/127.0.0.1:1#x=y"), "expected tls/HOST:PORT"),
        (Link("camera", "lab", "tcp/127.0.0.1:0"), "port of the edge"),
    ],
)
def test_unsafe_or_impossible_endpoints_are_refused(link: Link, orders: str) -> None:
    with pytest.raises(InputError, match=orders):
        check_link(link)


def test_plain_tcp_beyond_this_machine_needs_to_be_asked_for() -> None:
    link = Link("edge", "lab", "tcp/0.0.0.0:7447")
    with pytest.raises(InputError, match="plain tcp beyond this machine"):
        check_link(link)
    check_link(replace(link, insecure=True))
