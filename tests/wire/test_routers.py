"""Routers over TLS: one before the edge of a site, and one of a house that shows several sites."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in, init_keys, read_roll, revoke_keys
from e3pose.wire.network import NetworkTransport, open_network

pytestmark = pytest.mark.slow

HOUSE = (Path(__file__).parents[2] / "examples" / "house.json5").read_text()
NOW = datetime.datetime.now(datetime.timezone.utc)
SILENCE_S = 0.4


class Site:
    """The edge of a site and a router before it; cameras reach the router alone."""

    def __init__(self, folder: Path, name: str = "lab") -> None:
        self.name, self.folder = name, folder
        self.port, self.router_port = free_port(), free_port()
        init_keys(folder, name, [], NOW)
        for camera in ("cam1", "cam2", "cam3"):
            add_keys(folder, camera, NOW)
        for viewer in ("wall", "house"):
            add_keys(folder, viewer, NOW, kind="viewer")
        add_keys(folder, "desk", NOW, kind="operator")
        add_keys(folder, "hall", NOW, kind="router")
        revoke_keys(folder, "cam3")
        self.open: list[NetworkTransport] = []

    def edge(self) -> NetworkTransport:
        roll, files = read_roll(self.folder), certificates_in(self.folder, "edge")
        link = Link("edge", self.name, read_endpoint(f"tls/127.0.0.1:{self.port}"), files)
        return self.keep(open_network(link, roll))

    def router(self) -> NetworkTransport:
        place = self.folder / "routers" / "hall"  # all that is carried there
        roll, upstream = read_roll(place), (read_endpoint(f"tls/localhost:{self.port}"),)
        link = Link(
            "router",
            self.name,
            read_endpoint(f"tls/127.0.0.1:{self.router_port}"),
            certificates_in(place, "router"),
            upstream,
        )
        return self.keep(open_network(link, roll))

    def camera(self, name: str, port: int | None = None) -> NetworkTransport:
        files = certificates_in(self.folder / "cameras" / name, "camera")
        endpoint = f"tls/localhost:{port or self.router_port}"
        return self.keep(open_network(Link("camera", self.name, read_endpoint(endpoint), files)))

    def operator(self, port: int) -> NetworkTransport:
        files = certificates_in(self.folder / "operators" / "desk", "operator")
        return self.keep(
            open_network(Link("viewer", self.name, read_endpoint(f"tls/localhost:{port}"), files))
        )

    def viewer(self) -> NetworkTransport:
        files = certificates_in(self.folder / "viewers" / "wall", "viewer")
        endpoint = f"tls/localhost:{self.router_port}"
        return self.keep(open_network(Link("viewer", self.name, read_endpoint(endpoint), files)))

    def keep(self, transport: NetworkTransport) -> NetworkTransport:
        self.open.append(transport)
        return transport


@pytest.fixture
def made(tmp_path: Path) -> Iterator[Callable[[str], Site]]:
    sites: list[Site] = []

    def make(name: str) -> Site:
        sites.append(Site(tmp_path / name, name))
        return sites[-1]

    yield make
    for site in sites:
        for transport in reversed(site.open):
            transport.close()


def test_camera_reaches_its_edge_through_a_router_and_nobody_else_speaks_for_it(
    made: Callable[[str], Site],
) -> None:
    site = made("lab")
    edge = site.edge()
    views: list[tuple[str, bytes]] = []
    orders: list[bytes] = []
    seen: list[bytes] = []
    spied: list[tuple[str, bytes]] = []
    there: list[tuple[str, bool]] = []
    edge.subscribe("e3pose/lab/camera/*/view", lambda t, p: views.append((t, p)))
    edge.answer("e3pose/lab/camera/*/clock", lambda t, p: b"time of " + p)
    edge.watch("e3pose/lab/camera/*/alive", lambda t, on: there.append((t, on)))
    site.router()
    cam1, cam2, revoked = (site.camera(name) for name in ("cam1", "cam2", "cam3"))
    viewer = site.viewer()
    cam1.be_present("e3pose/lab/camera/cam1/alive")
    cam1.subscribe("e3pose/lab/order/cam1", lambda t, p: orders.append(p))
    viewer.subscribe("e3pose/lab/poses", lambda t, p: seen.append(p))
    for spy, name in ((cam2, "cam2"), (viewer, "viewer"), (revoked, "revoked")):
        for topic in ("e3pose/lab/order/cam1", "e3pose/lab/camera/cam1/view", "e3pose/**"):
            spy.subscribe(topic, lambda t, p, name=name: spied.append((name, p)))  # type: ignore[misc]

    def ready() -> bool:
        cam1.publish("e3pose/lab/camera/cam1/view", b"mine")
        edge.publish("e3pose/lab/order/cam1", b"to cam1")
        edge.publish("e3pose/lab/poses", b"people")
        time.sleep(0.05)
        return bool(views and orders and seen and there)

    assert eventually(ready)
    assert cam1.ask("e3pose/lab/camera/cam1/clock", b"?", 2.0) == b"time of ?"
    views.clear()
    for liar in (cam2, viewer, revoked):
        liar.publish("e3pose/lab/camera/cam1/view", b"forged")
        liar.publish("e3pose/lab/order/cam1", b"forged")
        liar.publish("e3pose/lab/poses", b"forged")
    revoked.publish("e3pose/lab/camera/cam3/view", b"from the revoked")
    assert cam2.ask("e3pose/lab/camera/cam1/clock", b"?", SILENCE_S) is None
    cam2.publish("e3pose/lab/camera/cam2/view", b"honest")
    assert eventually(lambda: ("e3pose/lab/camera/cam2/view", b"honest") in views)
    time.sleep(SILENCE_S)
    assert {payload for _, payload in views} <= {b"honest", b"mine"}
    assert set(orders) == {b"to cam1"} and set(seen) == {b"people"}
    assert {payload for _, payload in spied} <= {b"people"}  # which the viewer may hear
    cam1.close()
    assert eventually(lambda: ("e3pose/lab/camera/cam1/alive", False) in there)


def test_operators_ask_cameras_on_either_side_of_a_router(made: Callable[[str], Site]) -> None:
    site = made("lab")
    edge, _ = site.edge(), site.router()
    edge.answer("e3pose/lab/control/desk", lambda _, payload: b"done")
    near, far = site.camera("cam1", site.port), site.camera("cam2")
    for name, camera in (("cam1", near), ("cam2", far)):
        camera.answer(f"e3pose/lab/camera/{name}/picture", lambda t, _: t.encode())
    for operator in (site.operator(site.port), site.operator(site.router_port)):
        for name in ("cam1", "cam2"):
            topic = f"e3pose/lab/camera/{name}/picture"

            def pictured(operator: NetworkTransport = operator, topic: str = topic) -> bool:
                return operator.ask(topic, b"", 2.0) == topic.encode()

            assert eventually(pictured)
        assert operator.ask("e3pose/lab/control/desk", b"", 2.0) == b"done"


def test_router_that_was_revoked_hears_and_passes_nothing(made: Callable[[str], Site]) -> None:
    site = made("lab")
    revoke_keys(site.folder, "hall")
    edge = site.edge()
    views: list[bytes] = []
    edge.subscribe("e3pose/lab/camera/*/view", lambda t, p: views.append(p))
    router, camera = site.router(), site.camera("cam1")
    seen: list[bytes] = []
    router.subscribe("e3pose/lab/poses", lambda t, p: seen.append(p))
    for _ in range(20):
        camera.publish("e3pose/lab/camera/cam1/view", b"passed on")
        edge.publish("e3pose/lab/poses", b"people")
        time.sleep(0.05)
    assert not views and not seen


def test_router_of_the_page_shows_the_poses_of_several_sites(
    made: Callable[[str], Site], tmp_path: Path
) -> None:
    sites, port = {name: made(name) for name in ("lab", "hall")}, free_port()
    house = tmp_path / "house"
    init_keys(house, "house", [], NOW)
    add_keys(house, "desk", NOW, kind="viewer")
    text = HOUSE.replace("tls/0.0.0.0:7447", f"tls/127.0.0.1:{port}")
    text = text.replace("/etc/house", str(house))
    for name, site in sites.items():
        text = text.replace(f"tls/{name}.local:7447", f"tls/localhost:{site.port}")
        text = text.replace(f"/etc/{name}", str(site.folder / "viewers" / "house"))
    assert "/etc" not in text and ".local" not in text
    edges = {name: site.edge() for name, site in sites.items()}
    forged: list[bytes] = []
    got: dict[str, set[bytes]] = {name: set() for name in sites}
    for name, edge in edges.items():
        edge.subscribe(f"e3pose/{name}/**", lambda t, p: forged.append(p))
    files = certificates_in(house / "viewers" / "desk", "viewer")
    with zenoh.open(zenoh.Config.from_json5(text)):
        desk = sites["lab"].keep(
            open_network(Link("viewer", "house", read_endpoint(f"tls/localhost:{port}"), files))
        )
        for name, payloads in got.items():
            desk.subscribe(f"e3pose/{name}/poses", lambda t, p, to=payloads: to.add(p))  # type: ignore[misc]

        def both() -> bool:
            for name, edge in edges.items():
                edge.publish(f"e3pose/{name}/poses", name.encode())
                desk.publish(f"e3pose/{name}/poses", b"forged")
                desk.publish(f"e3pose/{name}/camera/cam1/view", b"forged")
            time.sleep(0.05)
            return all(got.values())

        assert eventually(both)
        desk.close()
    assert got == {name: {name.encode()} for name in sites} and not forged
