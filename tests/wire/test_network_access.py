"""Zenoh on loopback: who may read and write what, by certificates."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from tests.cases import each_case
from tests.ports import free_port
from tests.waiting import eventually
from tests.wire.certified_site import Site

from e3pose.base.errors import InputError
from e3pose.wire.access import CLIENT_MS, Certificates, Link, Roll, check_link, zenoh_config
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.network import NetworkTransport, open_network

pytestmark = pytest.mark.slow

SILENCE_S = 0.4  # how long to wait for what must not come


@pytest.mark.parametrize("routed", [False, True])
def test_camera_neither_reads_nor_forges_anothers_messages(site: Site, routed: bool) -> None:
    """Through a router as well, which all but the edge reach in place of the edge."""
    edge, port = site.edge(), site.router_port if routed else site.port
    routers = [site.router()] if routed else []
    views: list[tuple[str, bytes]] = []
    orders: list[bytes] = []
    spied: list[tuple[str, bytes]] = []
    seen: list[bytes] = []
    there: list[tuple[str, bool]] = []
    edge.subscribe("e3pose/lab/camera/*/view", lambda t, p: views.append((t, p)))
    edge.answer("e3pose/lab/camera/*/clock", lambda t, p: b"time of " + p)
    edge.watch("e3pose/lab/camera/*/alive", lambda t, on: there.append((t, on)))
    cam1, cam2, revoked = (site.camera(name, port) for name in ("cam1", "cam2", "cam3"))
    viewer = site.viewer(port)
    for name in ("cam1", "cam2"):
        cam1.be_present(f"e3pose/lab/camera/{name}/alive")  # the second is not its own
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
        return bool(views and orders and seen and later and there)

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
    cam1.close()
    gone = [("e3pose/lab/camera/cam1/alive", on) for on in (True, False)]
    assert eventually(lambda: there == gone), there
    for program in (cam2, revoked, viewer, *routers, edge):
        program.close()


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


def test_hub_asks_for_summaries_under_its_own_name_and_hears_no_pose(site: Site) -> None:
    edge, asked, heard, seen = site.edge(), list[str](), list[bytes](), list[bytes]()

    def answer(topic: str, payload: bytes) -> bytes:
        asked.append(topic)
        return b"summaries"

    edge.answer("e3pose/lab/outbox/*", answer)
    edge.answer("e3pose/lab/control/desk", answer)
    hub, other, viewer = site.hub(), site.hub("garden"), site.viewer()
    operator, camera = site.operator(), site.camera("cam1")
    for topic in ("poses", "poses-delayed", "status", "camera/*/view", "order/*", "**"):
        hub.subscribe(f"e3pose/lab/{topic}", lambda t, p: heard.append(p))
    viewer.subscribe("e3pose/lab/poses", lambda t, p: seen.append(p))
    mine = "e3pose/lab/outbox/house"
    assert eventually(lambda: hub.ask(mine, b"", 0.5) == b"summaries")

    def told() -> bool:
        for topic in ("poses", "poses-delayed", "status"):
            edge.publish(f"e3pose/lab/{topic}", b"people")
        return bool(seen)

    assert eventually(told)
    asked.clear()
    assert hub.ask("e3pose/lab/outbox/garden", b"", SILENCE_S) is None
    assert hub.ask("e3pose/lab/control/desk", b"", SILENCE_S) is None
    for one in (other, viewer, operator, camera):
        assert one.ask(mine, b"", SILENCE_S) is None
    assert hub.ask(mine, b"", 10.0) == b"summaries"
    assert asked == [mine] and heard == []
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


def test_two_sites_share_one_router() -> None:
    port = free_port()
    router = open_network(Link("edge", "router", read_endpoint(f"tcp/127.0.0.1:{port}")))
    got: dict[str, list[bytes]] = {"lab": [], "hall": []}
    programs = []
    for name in got:
        here, house = (read_endpoint(f"tcp/127.0.0.1:{at}") for at in (0, port))
        edge = open_network(Link("edge", name, here, upstream=(house,)))
        edge.subscribe(f"e3pose/{name}/camera/*/view", lambda t, p, name=name: got[name].append(p))  # type: ignore[misc]
        camera = open_network(Link("camera", name, house))
        programs += [edge, camera]

        def arrived(camera: NetworkTransport = camera, name: str = name) -> bool:
            camera.publish(f"e3pose/{name}/camera/cam1/view", name.encode())
            time.sleep(0.05)
            return bool(got[name])

        assert eventually(arrived)
    assert set(got["lab"]) == {b"lab"} and set(got["hall"]) == {b"hall"}
    for program in [*programs, router]:
        program.close()


@each_case("kind", ["hubs", "viewers"])
def test_few_fixed_keys_are_let_upstream(kind: str) -> None:
    files = Certificates(Path("authority.pem"), Path("edge.pem"), Path("edge.key"))
    link = Link("edge", "lab", read_endpoint("tls/127.0.0.1:7447"), files)
    roll = Roll("lab", **{kind: {"house": "house#1"}})  # type: ignore[arg-type]
    access: Any = zenoh_config(link, roll)["access_control"]
    assert access["enabled"] and access["default_permission"] == "deny"
    keys = {key for rule in access["rules"] for key in rule["key_exprs"]}
    assert 0 < len(keys) <= 4 and not any("*" in key for key in keys)
    if kind == "hubs":
        assert keys == {"e3pose/lab/outbox/house"}
        said = {message for rule in access["rules"] for message in rule["messages"]}
        assert said == {"query", "reply"}  # it declares nothing, and is told of nobody


@each_case(
    ("role", "endpoint", "orders"),
    [
        ("edge", "tcp/0.0.0.0:7447", "plain tcp beyond this machine"),
        ("edge", "tcp/[::]:7447", "plain tcp beyond this machine"),
        ("camera", "tcp/edge.local:7447", "plain tcp beyond this machine"),
        ("edge", "tls/0.0.0.0:7447", "tls without certificates"),
        ("edge", "udp/127.0.0.1:7447", "expected tls/HOST:PORT"),
        ("edge", "tcp/127.0.0.1:99999", "expected tls/HOST:PORT"),
        ("edge", "tcp/127.0.0.1:007447", "expected tls/HOST:PORT"),
        ("edge", "tcp/127.0.0.1:1#x=y", "expected tls/HOST:PORT"),
        ("camera", "tcp/127.0.0.1:0", "port of the edge"),
    ],
)
def test_unsafe_or_impossible_endpoints_are_refused(role: Any, endpoint: str, orders: str) -> None:
    with pytest.raises(InputError, match=orders):
        check_link(Link(role, "lab", read_endpoint(endpoint)))
    check_link(Link("edge", "lab", read_endpoint("tcp/0.0.0.0:7447"), insecure=True))


@each_case(("role", "timeout_ms"), [("viewer", CLIENT_MS), ("camera", -1)])
def test_viewer_gives_up_an_attempt_and_a_camera_never(role: Any, timeout_ms: int) -> None:
    config = zenoh_config(Link(role, "lab", read_endpoint("tcp/127.0.0.1:7447")))
    assert config["connect"]["timeout_ms"] == timeout_ms
