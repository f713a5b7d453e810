"""A site behind a link that loses 1 % and takes 300 ms: its day is complete at the hub."""

from __future__ import annotations

import datetime
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.hub.site import fill
from tests.hub.test_hub import E3POSE, numbers, program, serve
from tests.live.bad_link import BadLink, bad_link
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.wire.keys.folder import add_keys, init_keys
from e3pose_hub.database import read_rows

DAY = 1440


@pytest.fixture
def link() -> Iterator[BadLink]:
    with bad_link() as made:
        yield made


def test_day_of_a_far_site_is_complete(tmp_path: Path, link: BadLink) -> None:
    now, port = datetime.datetime.now(datetime.timezone.utc), free_port()
    init_keys(tmp_path / "keys", "lab", [link.host], now)
    add_keys(tmp_path / "keys", "house", now, kind="hub")
    (tmp_path / "lab").symlink_to(tmp_path / "keys" / "hubs" / "house")
    fill(tmp_path / "lab.db", "lab", 0, DAY)
    (tmp_path / "hub.toml").write_text(
        'format = "e3pose-hub"\nversion = 1\nevery_s = 1\n[[site]]\nname = "lab"\n'
        f'endpoint = "tls/{link.host}:{link.port_for(port)}"\n'
    )
    database = tmp_path / "hub.db"
    link.far()
    keys = str(tmp_path / "keys")
    with (
        serve("lab", port, tmp_path / "lab.db", keys, link.host),
        program(*link.inside, *E3POSE, "hub", "run", str(tmp_path)),
    ):
        begun_s = time.monotonic()
        assert eventually(lambda: len(numbers(database, "lab")) == DAY, 120)
        print(f"a day came in {time.monotonic() - begun_s:.0f} s over {type(link).__name__}")
        fill(tmp_path / "lab.db", "lab", DAY, 2)
        assert eventually(lambda: len(numbers(database, "lab")) == DAY + 2, 60)
    assert numbers(database, "lab") == [*range(DAY + 2)]
    assert [tuple(row[2:4]) for row in read_rows(str(database), "sites")[1]] == [(DAY + 2, 0)]
