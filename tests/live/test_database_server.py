"""What an edge says that it stored in a database server is there after `kill -9`."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.live.processes import LiveSite
from tests.postgres import Server
from tests.waiting import eventually

from e3pose.store import Store


@pytest.fixture(scope="module")
def url(postgres: Server) -> str:
    return postgres.new_store()


@pytest.fixture(scope="module")
def site(url: str, tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[LiveSite]:
    folder = tmp_path_factory.mktemp("site")
    (folder / "recording").symlink_to(recording)
    tables, more = ("[store]", f'path = "{url}"'), ('state = "state.npz"',)
    with LiveSite(folder, more=more, tables=tables, together=True).at_work() as made:
        yield made


def stored(url: str) -> list[int]:
    return [row["slot"] for row in Store(url).rows("slots")]


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
