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
from tests.wire.certified_site import Site

from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in, init_keys, revoke_keys
from e3pose.wire.network import NetworkTransport, open_network

pytestmark = pytest.mark.slow

HOUSE = (Path(__file__).parents[2] / "examples" / "house.json5").read_text()
NOW = datetime.datetime.now(datetime.timezone.utc)


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


def test_operators_ask_cameras_on_either_side_of_a_router(made: Callable[[str], Site]) -> None:
    site = made("lab")
    edge, _ = site.edge(), site.router()
    edge.answer("e3pose/lab/control/desk", lambda _, payload: b"done")
    near, far = site.camera("cam1"), site.camera("cam2", site.router_port)
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
    router, camera = site.router(), site.camera("cam1", site.router_port)
    seen: list[bytes] = []
    router.subscribe("e3pose/lab/poses", lambda t, p: seen.append(p))
    for _ in range(20):
        camera.publish("e3pose/lab/camera/cam1/view", b"passed on")
        edge.publish("e3pose/lab/poses", b"people")
        time.sleep(0.05)
    assert not views and not seen


def test_page_s_router_shows_several_sites(made: Callable[[str], Site], tmp_path: Path) -> None:
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
