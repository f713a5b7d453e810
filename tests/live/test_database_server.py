"""A database server that is stopped; what an edge says that it stored."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live.processes import LiveSite
from tests.postgres import Server, running_server
from tests.waiting import eventually

from e3pose.store import Store


@pytest.fixture(scope="module")
def server(postgres: Server) -> Iterator[Server]:
    """One that this test may stop."""
    with running_server(postgres.tools) as made:
        yield made


@pytest.fixture(scope="module")
def url(server: Server) -> str:
    return server.new_store()


@pytest.fixture(scope="module")
def site(url: str, tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[LiveSite]:
    folder = tmp_path_factory.mktemp("site")
    (folder / "recording").symlink_to(recording)
    zone = "[[zone]]", 'name = "all"', "corners = [[-50, -50], [50, -50], [50, 50], [-50, 50]]"
    tables = ("[store]", f'path = "{url}"', *zone)
    more = ('state = "state.npz"',)
    with LiveSite(folder, more=more, tables=tables, together=True).at_work() as made:
        yield made


def stored(url: str) -> list[int]:
    return [row["slot"] for row in Store(url).rows("slots")]


@pytest.mark.nightly  # tests/store/test_hanging_server.py has it without a site
def test_nothing_is_lost_while_the_server_is_away(server: Server, url: str, site: LiveSite) -> None:
    assert eventually(lambda: len(stored(url)) > 0), site.diagnostics()
    server.stop()
    assert eventually(lambda: site.events("store-trouble")), site.diagnostics()
    count, lost = len(site.poses), site.status().slots_lost
    site.flows(40)
    site.unbroken([poses.slot for poses in site.poses[count:]], lost)
    away = site.poses[-1].slot
    server.start()
    assert eventually(lambda: site.events("store-recovered")), site.diagnostics()
    assert eventually(lambda: max(stored(url), default=-1) > away), site.diagnostics()
    first, last = stored(url)[0], stored(url)[-1]
    missing = set(range(first, last + 1)) - set(stored(url))
    assert len(missing) <= site.status().slots_lost, "only what was never computed"
    assert len(site.events("store-trouble")) == 1, "reported once"
    assert "file" in site.events("store-trouble")[0]["event"]
    store = Store(url)

    def kinds() -> set[str]:
        return {row["kind"] for row in store.rows("events")}

    assert eventually(lambda: {"store-trouble", "store-recovered"} <= kinds()), kinds()
    zones = store.rows("zones")
    assert {row["zone"] for row in zones} == {"all"} and zones[0]["kind"] == "enter"


def test_what_a_viewer_was_told_is_stored_survives_kill_9(url: str, site: LiveSite) -> None:
    site.send("edge", signal.SIGKILL)
    site.wait("edge")
    begun = len(site.poses)
    site.start_edge()
    assert eventually(lambda: len(site.poses) > begun + 30 and site.poses[-1].stored_to > 0), (
        site.diagnostics()
    )
    site.send("edge", signal.SIGKILL)
    site.wait("edge")
    seen = site.poses[begun:]
    told = seen[-1]
    assert seen[0].stored_to == -1, "each edge speaks of its own slots"
    assert seen[0].slot <= told.stored_from <= told.stored_to < told.slot
    assert told.slot - told.stored_to < 40, "half a second, or two where it is busy"
    assert told.store_shed == 0
    promised = [p.slot for p in seen if told.stored_from <= p.slot <= told.stored_to]
    assert len(promised) > 5
    assert not set(promised) - set(stored(url))
