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

pytestmark = pytest.mark.live


@pytest.fixture(scope="module")
def server(postgres: Server) -> Iterator[Server]:
    """One that this test may stop."""
    with running_server(postgres.tools) as made:
        yield made


def test_nothing_is_lost_while_the_server_is_away(
    server: Server, tmp_path: Path, recording: Path
) -> None:
    (tmp_path / "recording").symlink_to(recording)
    url = server.new_store()
    zone = (
        "[[zone]]",
        'name = "all"',
        "corners = [[-50, -50], [50, -50], [50, 50], [-50, 50]]",
    )
    site = LiveSite(tmp_path, tables=("[store]", f'path = "{url}"', *zone))

    def stored() -> list[int]:
        return [row["slot"] for row in Store(url).rows("slots")]

    with site.at_work():
        assert eventually(lambda: len(stored()) > 0), site.diagnostics()
        server.stop()
        assert eventually(lambda: site.events("store-trouble")), site.diagnostics()
        count, lost = len(site.poses), site.status().slots_lost
        site.flows(40)
        site.unbroken([poses.slot for poses in site.poses[count:]], lost)
        away = site.poses[-1].slot
        server.start()
        assert eventually(lambda: site.events("store-recovered")), site.diagnostics()
        assert eventually(lambda: max(stored(), default=-1) > away), site.diagnostics()
        first, last = stored()[0], stored()[-1]
        missing = set(range(first, last + 1)) - set(stored())
        assert len(missing) <= site.status().slots_lost, "only what was never computed"
        assert len(site.events("store-trouble")) == 1, "reported once"
        assert "file" in site.events("store-trouble")[0]["event"]

        def kinds() -> set[str]:
            return {row["kind"] for row in Store(url).rows("events")}

        assert eventually(lambda: {"store-trouble", "store-recovered"} <= kinds()), kinds()
        zones = Store(url).rows("zones")
        assert {row["zone"] for row in zones} == {"all"} and zones[0]["kind"] == "enter"


def test_what_a_viewer_was_told_is_stored_survives_kill_9(
    server: Server, tmp_path: Path, recording: Path
) -> None:
    url = server.new_store()
    (tmp_path / "recording").symlink_to(recording)
    tables = ("[store]", f'path = "{url}"')
    site = LiveSite(tmp_path, more=('state = "state.npz"',), tables=tables)
    with site.at_work():
        for life in range(3):
            begun = len(site.poses) if life else 0
            assert eventually(
                lambda: len(site.poses) > begun + 30 and site.poses[-1].stored_to > 0  # noqa: B023
            ), site.diagnostics()
            site.send("edge", signal.SIGKILL)
            site.wait("edge")
            seen = site.poses[begun:]
            told = seen[-1]
            assert seen[0].stored_to == -1, "each edge speaks of its own slots"
            assert seen[0].slot <= told.stored_from <= told.stored_to < told.slot
            assert told.slot - told.stored_to < 40, "half a second, or two where it is busy"
            assert told.store_shed == 0
            found = [row["slot"] for row in Store(url).rows("slots")]
            promised = [p.slot for p in seen if told.stored_from <= p.slot <= told.stored_to]
            assert len(promised) > 5
            assert not set(promised) - set(found), f"of life {life}"
            site.start_edge()
        site.flows(5)
