"""What a real router upstream of a site holds of it: few fixed keys, and no wildcard.

Routers upstream hold the declarations of all sites, and liveliness grows with the square of them.
"""

from __future__ import annotations

import datetime
import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import pytest
import zenoh
from tests.live.processes import LiveSite
from tests.waiting import eventually

from e3pose.wire.access import Link, zenoh_config
from e3pose.wire.codec import encode
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in
from e3pose.wire.network import NetworkTransport, open_network
from e3pose.wire.site_messages import OutboxQuestion
from e3pose.wire.topics import of_outbox

pytestmark = pytest.mark.live

MOST_KEYS = 4
Kind = Literal["hub", "viewer", "router"]
KINDS = "subscriber", "queryable", "publisher", "querier", "token"


@pytest.fixture(scope="module")
def upstream_site(site: LiveSite) -> LiveSite:
    """Return a site of real processes with a certificate of each kind that is used upstream."""
    now, keys = datetime.datetime.now(datetime.timezone.utc), site.folder / "keys"
    add_keys(keys, "house", now, kind="hub")
    add_keys(keys, "hall", now, kind="router")
    return site


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


def test_hub_s_router_holds_no_key_and_no_token(upstream_site: LiveSite) -> None:
    with router(upstream_site, "hub", "house") as session:
        with hub(upstream_site) as transport:  # which this certificate is for
            topic = of_outbox(upstream_site.name, "house")
            assert eventually(lambda: transport.ask(topic, encode(OutboxQuestion()), 5.0))
            upstream_site.flows(40)  # cameras, viewer and edge say what they have to say
        assert all_held(session) == set()


def test_viewer_s_router_holds_four_fixed_keys_at_most(upstream_site: LiveSite) -> None:
    own = {
        f"e3pose/{upstream_site.name}/{what}"
        for what in ("poses", "poses-delayed", "status", "alive")
    }
    with router(upstream_site, "viewer", "wall") as session:
        assert eventually(lambda: held(session, "token"))
        upstream_site.flows(40)
        found = all_held(session)
        assert found <= own and len(found) <= MOST_KEYS
        assert held(session, "token") == {f"e3pose/{upstream_site.name}/alive"}


def test_router_of_the_site_itself_holds_more(upstream_site: LiveSite) -> None:
    """What the others do not hold is there to be held, and would be seen."""
    with router(upstream_site, "router", "hall") as session:
        assert eventually(lambda: any("*" in key for key in held(session, "subscriber")))
        assert eventually(lambda: len(held(session, "token")) > 1)
        assert len(all_held(session)) > MOST_KEYS
