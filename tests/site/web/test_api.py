"""What the API answers from the store of a site, and what it refuses."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import httpx
import jsonschema_rs
import pytest
from hypothesis import HealthCheck, given, settings
from tests.cases import each_case
from tests.site.web.watched import SLOTS, STARTED_NS, Watched
from tests.waiting import eventually

from e3pose.model.skeleton import COCO17
from e3pose.site.web.app import PageContent, make_app
from e3pose.site.web.feed import Feed
from e3pose.store import Store


@pytest.fixture(scope="module")
def client(watched: Watched) -> Iterator[httpx.Client]:
    with watched.client() as made:
        yield made


def get(client: httpx.Client, path: str, **asked: Any) -> dict[str, Any]:
    answer = client.get(path, params=asked)
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def test_site_says_what_the_page_draws(client: httpx.Client) -> None:
    site = get(client, "/api/site")
    assert (site["site"], site["scope"], site["stored"]) == ("lab", "read", True)
    assert site["cameras"] == ["c0", "c1", "c2"] and len(site["frustums"][0]) == 15
    assert site["joints"] == list(COCO17.joints)


def test_poses_come_by_time_track_joint_and_region(client: httpx.Client) -> None:
    page = get(client, "/api/poses", start="0.4", end="0.6")
    assert [slot["slot"] for slot in page["slots"]] == list(range(10, 16))
    assert page["cursor"] is None and page["joints"] == list(COCO17.joints)
    first = page["slots"][0]
    assert first["time_ns"] == STARTED_NS + 400_000_000 and first["run"] == 1
    assert [person["track"] for person in first["people"]] == [10, 11]
    assert first["people"][1]["joints_m"][0] == [1.0, 0.1, 0.0]
    assert first["people"][1]["joints_m"][3] == [None, None, None]
    assert first["people"][1]["measured"][3] is False
    since = str(STARTED_NS + 600_000_000)
    assert len(get(client, "/api/poses", start=since)["slots"]) == SLOTS - 15
    track = get(client, "/api/poses", track=11)["slots"]
    assert {p["track"] for slot in track for p in slot["people"]} == {11}
    joint = get(client, "/api/poses", joint="nose")
    assert joint["joints"] == ["nose"] and len(joint["slots"][0]["people"][0]["joints_m"]) == 1
    region = get(client, "/api/poses", region="0,0.195,2,0.305")["slots"]
    assert [slot["slot"] for slot in region] == list(range(20, 31))
    assert {p["track"] for slot in region for p in slot["people"]} == {11}


def test_pages_follow_each_other_without_a_gap(client: httpx.Client) -> None:
    seen, cursor = [], None
    while True:
        page = get(client, "/api/poses", limit=7, **({"cursor": cursor} if cursor else {}))
        assert len(page["slots"]) <= 7
        seen += [(slot["slot"], len(slot["people"])) for slot in page["slots"]]
        if (cursor := page["cursor"]) is None:
            break
    assert seen == [(slot, 2) for slot in range(SLOTS)]


def test_rows_of_the_store_come_in_pages(client: httpx.Client) -> None:
    first = get(client, "/api/slots", limit=25)
    rest = get(client, "/api/slots", limit=25, cursor=first["cursor"])
    assert [row["slot"] for row in first["rows"] + rest["rows"]] == list(range(SLOTS))
    assert rest["cursor"] is None and rest["rows"][0]["selected"] == "100"
    assert [row["track_id"] for row in get(client, "/api/tracks")["rows"]] == [10, 11]
    (run, *_) = client.get("/api/runs").json()
    assert run["cameras"] == ["c0", "c1", "c2"] and run["limbs"] == [*map(list, COCO17.limbs)]


@each_case(
    ("path", "message"),
    [
        ("/api/poses?start=yesterday", "time: found 'yesterday'"),
        ("/api/poses?joint=tail", "joint: found 'tail'"),
        ("/api/poses?region=1,2", "region: expected x0,y0,x1,y1"),
        ("/api/poses?run=9", "run: found 9"),
        ("/api/poses?start=2&end=1", "the earlier one first"),
    ],
)
def test_what_cannot_be_answered_says_why(client: httpx.Client, path: str, message: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 422 and message in answer.json()["detail"]
    assert "lab.db" not in answer.text


def test_status_is_that_of_the_edge(watched: Watched, client: httpx.Client) -> None:
    watched.publish(7)
    status = get(client, "/api/status")
    assert status["slot"] == 7 and status["cameras"][2]["camera_id"] == "c2"
    said = get(client, "/api/openapi.json")["paths"]["/api/status"]["get"]["responses"]["200"]
    jsonschema_rs.validate(said["content"]["application/json"]["schema"], status)


def test_too_many_requests_are_refused(watched: Watched) -> None:
    with watched.client() as busy:
        assert busy.get("/favicon.ico").status_code == 204

        def refused() -> bool:  # a busy machine may be too slow to ask too often
            return 429 in [busy.get("/favicon.ico").status_code for _ in range(250)]

        assert eventually(refused, 120.0)
        assert eventually(lambda: busy.get("/favicon.ico").status_code == 204)


def test_site_without_a_store_says_so() -> None:
    app = make_app(PageContent(Feed("lab"), None, dict))
    transport = httpx.ASGITransport(app=app)

    async def ask(path: str) -> httpx.Response:
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as made:
            return await made.get(path)

    assert asyncio.run(ask("/api/poses")).status_code == 404
    assert asyncio.run(ask("/api/status")).status_code == 404


def _schema(store: Store | None) -> Any:
    import schemathesis

    app = make_app(PageContent(Feed("lab"), store, lambda: {"site": "lab"}))
    return schemathesis.openapi.from_asgi("/api/openapi.json", app)


def test_no_request_that_can_be_written_breaks_the_api(watched: Watched) -> None:
    from schemathesis.specs.openapi.checks import positive_data_acceptance

    schema = _schema(Store(watched.folder / "lab.db"))
    operations = [result.ok() for result in schema.get_all_operations()]
    assert {operation.path for operation in operations} >= {
        "/api/poses",
        "/api/site",
        "/api/{table}",
    }
    for operation in operations:
        if operation.path == "/api/live":  # never ends; tests/site/web/test_live.py reads it
            continue

        @settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
        @given(case=operation.as_strategy())
        def attack(case: Any) -> None:
            answer = case.call()
            assert answer.status_code < 500, answer.text
            # A schema cannot say which words are times, or which runs there are.
            case.validate_response(answer, excluded_checks=[positive_data_acceptance])

        attack()
