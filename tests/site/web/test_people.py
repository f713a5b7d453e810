"""Names and colours by the API: who may change them, what followers are told, what is logged."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.cases import each_case
from tests.site.web.watched import STARTED_NS, Watched, watched_site
from tests.waiting import eventually

from e3pose.store import Store
from e3pose.store.people import people_of, set_name


@pytest.fixture
def watched(tmp_path: Path) -> Iterator[Watched]:
    with watched_site(tmp_path) as made:
        yield made


@pytest.fixture
def operator(watched: Watched) -> Iterator[httpx.Client]:
    with watched.client(watched.view.tokens.write) as made:
        yield made


def change(client: httpx.Client, **body: Any) -> httpx.Response:
    return client.post("/api/control/people", json=body)


def test_operators_name_people_and_all_are_told(watched: Watched, operator: httpx.Client) -> None:
    answer = change(operator, run=1, track=10, name=" Ada ", colour="gold")
    assert answer.json() == {"said": "Named 1 track. Colour: gold"}
    assert change(operator, run=1, track=11, name="Ada").status_code == 200
    (person,) = operator.get("/api/people").json()
    tracks = [{"run": 1, "track": 10}, {"run": 1, "track": 11}]
    assert (person["name"], person["colour"], person["tracks"]) == ("Ada", "gold", tracks)
    assert person["first_ns"] == STARTED_NS
    rows = operator.get("/api/tracks").json()["rows"]
    assert [(row["name"], row["colour"]) for row in rows] == [("Ada", "gold")] * 2
    watched.publish(7)
    watched.view.feed.look_at_names()
    status = operator.get("/api/status").json()
    assert status["run"] == 1
    assert {one["track"]: one["name"] for one in status["names"]} == {10: "Ada", 11: "Ada"}


def test_a_new_name_is_that_of_all_tracks_unless_only_one_is_meant(
    watched: Watched, operator: httpx.Client
) -> None:
    store = watched.folder / "lab.db"
    set_name(store, ((1, 10), (1, 11)), "Ada")
    change(operator, run=1, track=10, name="Ada Lovelace")
    assert [one.name for one in people_of(store)] == ["Ada Lovelace"]
    change(operator, run=1, track=11, name="Bob", only=True)
    assert {one.name for one in people_of(store)} == {"Ada Lovelace", "Bob"}
    change(operator, run=1, track=11, name="")
    assert {one.name for one in people_of(store)} == {"Ada Lovelace", None}


def test_followers_hear_of_a_name_that_somebody_else_gave(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watched.view.feed.names, "kept_s", 0.0)
    watched.publish(7)
    with watched.client() as client, client.stream("GET", "/api/live") as stream:
        lines = stream.iter_lines()

        def told() -> bool:
            line = next(lines)
            return line.startswith("data:") and any(
                one["name"] == "Cy" for one in json.loads(line[5:]).get("names", ())
            )

        set_name(watched.folder / "lab.db", ((1, 10),), "Cy")
        assert eventually(told)


def test_viewers_see_names_and_change_none(watched: Watched) -> None:
    set_name(watched.folder / "lab.db", ((1, 10),), "Ada")
    for token, status in (("", 401), (watched.view.tokens.read, 403), ("x" * 32, 401)):
        with watched.client(token) as client:
            assert change(client, run=1, track=10, name="Eve").status_code == status
    with watched.client(watched.view.tokens.read) as client:
        assert [one["name"] for one in client.get("/api/people").json()] == ["Ada"]


@each_case(
    ("body", "words"),
    [
        ({"run": 1, "track": 10, "name": "7"}, "not only digits"),
        ({"run": 1, "track": 10, "name": "A\x1b[2J"}, "name"),
        ({"run": 1, "track": 10, "name": "x" * 101}, "name"),
        ({"run": 1, "track": 10, "colour": "#ff0000"}, "one of blue"),
        ({"run": 1, "track": 99, "name": "Ada"}, "track 99 of run 1"),
        ({"run": 2, "track": 10, "name": "Ada"}, "track 10 of run 2"),
        ({"run": 2**70, "track": 10, "name": "Ada"}, "run"),
        ({"run": -1, "track": 10, "name": "Ada"}, "run"),
        ({"track": 10, "name": "Ada"}, "run"),
        ({"run": 1, "track": 10, "name": {"a": 1}}, "name"),
        ({"run": 1, "track": 10, "path": "/etc/passwd"}, "path"),
    ],
)
def test_what_is_no_name_changes_nothing(
    watched: Watched, operator: httpx.Client, body: dict[str, Any], words: str
) -> None:
    answer = change(operator, **body)
    assert answer.status_code == 422 and words in answer.json()["detail"]
    assert "lab.db" not in answer.text and str(watched.folder) not in answer.text
    rows = Store(watched.folder / "lab.db").rows("tracks")
    assert {(row["name"], row["colour"]) for row in rows} == {(None, None)}


def test_a_change_is_logged_without_the_name(tmp_path: Path) -> None:
    said: list[str] = []
    with (
        watched_site(tmp_path, report=said.append) as made,
        made.client(made.view.tokens.write) as client,
    ):
        change(client, run=1, track=10, name="Ada Lovelace")
        change(client, run=1, track=10)
    assert said == ["page: 127.0.0.1 changed name or colour of track 10 of run 1"]
