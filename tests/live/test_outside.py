"""A site of real processes over TLS from outside: its page, an edge that dies, routers upstream."""

from __future__ import annotations

import base64
import datetime
import json
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import cv2
import httpx
import numpy as np
import pytest
import zenoh
from tests.live.processes import CAMERAS, LiveSite
from tests.site.web.browser import Page, in_browser
from tests.waiting import eventually

from e3pose.settings.resolved import resolve_site
from e3pose.site.web.program import open_view
from e3pose.wire.access import Link, zenoh_config
from e3pose.wire.codec import encode
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in
from e3pose.wire.network import NetworkTransport, open_network
from e3pose.wire.site_messages import OutboxQuestion
from e3pose.wire.topics import of_outbox

REQUESTS = 40
GONE_S = 20.0  # three seconds of silence, on a machine that does other things


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[LiveSite]:
    folder = tmp_path_factory.mktemp("site")
    (folder / "recording").symlink_to(recording)
    made = LiveSite(folder, tables=("[store]", 'path = "poses.db"'), camera_options=["--pictures"])
    with made.at_work():
        now, keys = datetime.datetime.now(datetime.timezone.utc), folder / "keys"
        add_keys(keys, "house", now, kind="hub")
        add_keys(keys, "hall", now, kind="router")
        yield made


@pytest.fixture(scope="module")
def url(site: LiveSite) -> str:
    return site.start_view()


def figures(found: dict[str, Any]) -> np.ndarray:
    """Return where a picture has something drawn in it, `(height, width)`."""
    jpeg = np.frombuffer(base64.b64decode(found["jpeg"]), np.uint8)
    image: Any = cv2.imdecode(jpeg, cv2.IMREAD_GRAYSCALE)
    return np.asarray(image < 190)


def covered(found: dict[str, Any]) -> list[bool]:
    """Return for each joint in the picture whether something is drawn near it."""
    drawn = figures(found)
    scale = drawn.shape[1] / found["size"][0]
    near = []
    for person in found["people"]:
        for joint, measured in zip(person["joints_px"], person["measured"], strict=True):
            if joint[0] is None or not measured:
                continue
            column, row = (round(scale * value) for value in joint)
            if 8 <= column < drawn.shape[1] - 8 and 8 <= row < drawn.shape[0] - 8:
                near.append(bool(drawn[row - 6 : row + 7, column - 6 : column + 7].any()))
    return near


def test_every_camera_shows_pictures_with_its_people_and_is_asked_so_often_at_most(
    site: LiveSite, url: str
) -> None:
    with httpx.Client(base_url=url, timeout=30) as client:

        def picture(camera_id: str) -> dict[str, Any]:
            return dict(client.get(f"api/pictures/{camera_id}").json())

        assert eventually(lambda: all([picture(one).get("jpeg") for one in CAMERAS])), (
            site.diagnostics()
        )
        first = {camera_id: picture(camera_id) for camera_id in CAMERAS}
        found: list[dict[str, Any]] = []
        begun_s = time.monotonic()
        for _ in range(REQUESTS // len(CAMERAS) + 1):
            found += [picture(camera_id) for camera_id in CAMERAS]
            time.sleep(0.2)
        took_s = time.monotonic() - begun_s
    assert len(found) >= REQUESTS and all(one["jpeg"] for one in found), found[-1]["why"]
    assert all(one["drawn"] and 0 <= one["age_s"] < 30 for one in found)
    for camera_id, last in zip(CAMERAS, found[-len(CAMERAS) :], strict=True):
        assert 0 < last["count"] - first[camera_id]["count"] <= 2 * took_s + 2
    # What is drawn are the keypoints of the moment, and the 3D people lie on them.
    near = [hit for one in found for hit in covered(one)]
    assert len(near) > 200 and np.mean(near) > 0.9
    apart = [one["apart_ms"] for one in found if one["slot"] is not None]
    assert len(apart) > 0.8 * len(found) and max(map(abs, apart)) <= 50.0 + 1e-6


def test_viewers_certificate_shows_no_pictures_and_says_why(site: LiveSite) -> None:
    wall = site.folder / "keys" / "viewers" / "wall"
    with (
        open_view(resolve_site(site.path), "127.0.0.1:0", wall) as view,
        httpx.Client(base_url=view.url, timeout=30) as client,
    ):
        told = client.get("api/site").json()["pictures"]
        assert not told["shown"] and "operator's certificate" in told["why"]
        assert client.get("api/pictures/cam0").status_code == 404


@in_browser
def test_page_shows_all_cameras_and_enlarges_one(site: LiveSite, url: str, page: Page) -> None:
    page.open(url)
    assert page.shows("state", "live")
    shown = "[...m.tiles.values()].filter((one) => one.image && one.found.people.length).length"
    assert eventually(lambda: page.of("pictures", shown) == len(CAMERAS)), page.text("tiles")
    page.run("document.querySelectorAll('.tile')[1].focus()")
    page.press("Enter")
    assert page.shows("large-of", "cam1") and page.run("document.getElementById('large').open")
    # The camera makes a larger one, also of the image that it has shown already.
    assert eventually(lambda: page.of("pictures", "m.tiles.get('cam1').image.width > 320"))
    assert page.shows("large-said", "poses of slot")
    page.run("document.getElementById('large-off').click()")
    assert not page.run("document.getElementById('large').open")
    assert page.messages == []


# Routers upstream hold the declarations of all sites, and liveliness grows with the square of them.
MOST_KEYS = 4
Kind = Literal["hub", "viewer", "router"]
KINDS = "subscriber", "queryable", "publisher", "querier", "token"


@contextmanager
def router(site: LiveSite, kind: Kind, name: str) -> Iterator[Any]:
    """Be a router of Zenoh's own kind, which is connected to the edge, and says what it holds."""
    files = certificates_in(site.folder / "keys" / f"{kind}s" / name, kind)
    config = zenoh_config(Link("viewer", site.name, read_endpoint(site.endpoint), files))
    config["mode"] = "router"
    config["adminspace"] = {"enabled": True, "permissions": {"read": True, "write": False}}
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        assert eventually(lambda: list(session.info.routers_zid()))
        yield session


@contextmanager
def hub(site: LiveSite) -> Iterator[NetworkTransport]:
    """Join as a hub does, for one question."""
    files = certificates_in(site.folder / "keys" / "hubs" / "house", "hub")
    transport = open_network(Link("viewer", site.name, read_endpoint(site.endpoint), files))
    try:
        yield transport
    finally:
        transport.close()


def held(session: Any, what: str) -> set[str]:
    """Return the keys that a router holds of a kind of declaration."""
    prefix = f"@/{session.zid()}/router/{what}/"
    found = [r.ok for r in session.get(f"{prefix}**") if r.ok is not None]
    return {str(sample.key_expr).removeprefix(prefix) for sample in found}


def all_held(session: Any) -> set[str]:
    return {key for what in KINDS for key in held(session, what) if not key.startswith("@")}


def test_hub_s_router_holds_no_key_and_no_token(site: LiveSite) -> None:
    with router(site, "hub", "house") as session:
        with hub(site) as transport:  # which this certificate is for
            topic = of_outbox(site.name, "house")
            assert eventually(lambda: transport.ask(topic, encode(OutboxQuestion()), 5.0))
            site.flows(40)  # cameras, viewer and edge say what they have to say
        assert all_held(session) == set()


def test_viewer_s_router_holds_four_fixed_keys_at_most(site: LiveSite) -> None:
    own = {f"e3pose/{site.name}/{what}" for what in ("poses", "poses-delayed", "status", "alive")}
    with router(site, "viewer", "wall") as session:
        assert eventually(lambda: held(session, "token"))
        site.flows(40)
        found = all_held(session)
        assert found <= own and len(found) <= MOST_KEYS
        assert held(session, "token") == {f"e3pose/{site.name}/alive"}


def test_router_of_the_site_itself_holds_more(site: LiveSite) -> None:
    """What the others do not hold is there to be held, and would be seen."""
    with router(site, "router", "hall") as session:
        assert eventually(lambda: any("*" in key for key in held(session, "subscriber")))
        assert eventually(lambda: len(held(session, "token")) > 1)
        assert len(all_held(session)) > MOST_KEYS


@in_browser
def test_dead_edge_is_told_within_seconds_and_the_notice_goes_when_it_is_back(
    site: LiveSite, url: str, page: Page
) -> None:
    page.open(url)
    assert page.shows("state", "live")
    assert page.run("document.getElementById('notice').hidden")
    site.send("edge", signal.SIGKILL)
    site.wait("edge")
    begun_s = time.monotonic()
    assert page.shows("notice", "Edge gone since ") and page.text("state") == "edge gone"
    assert time.monotonic() - begun_s < GONE_S
    assert page.run("getComputedStyle(document.getElementById('scene')).opacity < 0.6")
    assert eventually(lambda: "edge gone" in page.text("tiles") and " ago" in page.text("tiles"))
    with httpx.Client(base_url=url, timeout=30) as client:
        assert client.get("api/status").json()["silent_s"] > 2
    page.open(url)  # a browser that comes later is told as well
    assert page.shows("notice", "Edge gone since ")
    site.start_edge()
    assert eventually(lambda: page.run("document.getElementById('notice').hidden"), 240)
    assert page.shows("state", "live")
    assert not page.run("document.body.classList.contains('stale')")
    assert page.messages == []
