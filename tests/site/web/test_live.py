"""Following a site over HTTP: server-sent events and WebSockets, and who gets nothing."""

from __future__ import annotations

import asyncio
import json
import threading
from contextlib import AsyncExitStack
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from tests.cases import each_case
from tests.memory_transport import Hub, MemoryTransport
from tests.site.web.watched import FPS, STARTED_NS, Watched, poses, status
from tests.waiting import eventually
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as connect_socket

from e3pose.events.watch import begin_watch
from e3pose.model.skeleton import COCO17
from e3pose.settings.events_table import EventsTable
from e3pose.settings.site_file import ZoneTable
from e3pose.site.web.feed import (
    MAX_FOLLOWERS,
    MAX_OF_ADDRESS,
    MAX_WAITING,
    QUIET_S,
    Feed,
    TooMany,
)
from e3pose.site.web.schemas import Encoded
from e3pose.site.zones import Zones
from e3pose.store.names import StoredNames
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import Status


def socket(watched: Watched, form: str = "json", **more: Any) -> ClientConnection:
    url = watched.view.url.replace("http", "ws", 1)
    made: ClientConnection = connect_socket(f"{url}api/live?format={form}", **more)
    return made


@pytest.mark.parametrize(
    ("form", "read"), [("json", json.loads), ("msgpack", msgspec.msgpack.decode)]
)
def test_socket_says_what_the_edge_published(watched: Watched, form: str, read: Any) -> None:
    watched.publish(3)
    with socket(watched, form) as following:
        edge, first, second = (read(following.recv(10)) for _ in range(3))
        assert edge["type"] == "edge" and edge["there"] and edge["heard_ns"] > 0
        assert (first["type"], second["type"], second["slot"]) == ("status", "slot", 3)
        watched.publish(4)
        status, slot = read(following.recv(10)), read(following.recv(10))
    assert status["slot"] == 4 and status["cameras"][0]["camera_id"] == "c0"
    assert slot["selected"] == ["c0", "c1"] and slot["arrived"] == ["c0"]
    assert slot["people"][1]["track"] == 11
    assert slot["people"][1]["joints_m"][0] == [1.0, pytest.approx(0.04), 0.0]
    missing = slot["people"][1]["joints_m"][3]
    assert missing == [None] * 3 if form == "json" else np.isnan(missing).all()
    assert eventually(lambda: watched.view.feed.followers == 0)


def test_smoothed_slots_are_followed_in_place_of_those_at_once(watched: Watched) -> None:
    watched.publish(10)
    with watched.client() as client:
        assert client.get("/api/status").json()["smoothed_ms"] is None
    watched.publish(15)
    watched.publish_smoothed(10)
    url = watched.view.url.replace("http", "ws", 1)
    with connect_socket(f"{url}api/live?delayed=true") as late, socket(watched) as now:
        first = [json.loads(late.recv(10)) for _ in range(3)]
        at_once = [json.loads(now.recv(10)) for _ in range(3)]
        assert [each["type"] for each in first] == ["edge", "status", "slot"]
        assert first[1]["smoothed_ms"] == 200.0
        slot = first[2]
        assert (slot["slot"], slot["delay_ms"]) == (10, 200.0)
        assert slot["people"][1]["joints_m"][0][0] == 4.0
        assert slot["selected"] == ["c0", "c1"] and slot["arrived"] == ["c0"]
        assert slot["published_ns"] - slot["time_ns"] == 231_000_000
        assert (at_once[2]["slot"], at_once[2]["delay_ms"]) == (15, 0.0)
        watched.publish(16)
        watched.publish_smoothed(11)
        assert json.loads(late.recv(10))["type"] == json.loads(now.recv(10))["type"] == "status"
        assert json.loads(late.recv(10))["slot"] == 11
        assert json.loads(now.recv(10))["slot"] == 16
    with watched.client() as client, client.stream("GET", "/api/live?delayed=true") as answer:
        found = [line for line, _ in zip(answer.iter_lines(), range(10), strict=False)]
    assert json.loads(found[9].removeprefix("data: "))["slot"] == 11
    watched.publish(15 + round((QUIET_S + 1) * FPS))  # none came lately
    with watched.client() as client:
        assert client.get("/api/status").json()["smoothed_ms"] is None
        assert client.get("/api/live?delayed=perhaps").status_code == 422


def test_events_come_one_after_the_other(watched: Watched) -> None:
    watched.publish(8)
    with watched.client() as client, client.stream("GET", "/api/live") as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        lines = answer.iter_lines()
        found = [line for line, _ in zip(lines, range(10), strict=False)]
    assert found[0].startswith("retry")
    assert found[2:9:3] == ["event: edge", "event: status", "event: slot"]
    assert json.loads(found[9].removeprefix("data: "))["slot"] == 8
    assert eventually(lambda: watched.view.feed.followers == 0)


@each_case(
    "more",
    [
        {"origin": "http://evil.example"},
        {"additional_headers": {"Host": "evil.example"}},
        {"additional_headers": {"Authorization": "Bearer wrong"}},
        {"subprotocols": ["e3pose", "e3pose.token.wrong"]},
    ],
    ids=["origin", "host", "token", "protocol"],
)
def test_foreign_pages_and_wrong_tokens_get_nothing(watched: Watched, more: Any) -> None:
    with pytest.raises((InvalidStatus, ConnectionClosed)), socket(watched, **more) as following:
        following.recv(5)
    assert watched.view.feed.followers == 0


def test_token_may_come_as_a_protocol(watched: Watched) -> None:
    watched.publish(5)
    token = f"e3pose.token.{watched.view.tokens.read}"
    with socket(watched, subprotocols=["e3pose", token]) as following:
        assert following.subprotocol == "e3pose"  # the token is not said back
        assert json.loads(following.recv(10))["type"] == "edge"


def listening(**options: Any) -> tuple[Feed, MemoryTransport]:
    """Return a feed on the running loop, and the edge that it hears."""
    feed, hub = Feed("lab", **options), Hub()
    feed.listen(hub.join())
    feed.attach(asyncio.get_running_loop())
    return feed, hub.join()


def test_who_is_slow_gets_the_newest() -> None:
    async def follow() -> list[int]:
        feed, edge = listening()
        async with feed.follow("10.0.0.1") as queue:
            for slot in range(MAX_WAITING + 10):
                edge.publish("e3pose/lab/poses", encode(poses(slot)))
            await asyncio.sleep(0)
            return [queue.get_nowait().body["slot"] for _ in range(queue.qsize())]

    assert asyncio.run(follow()) == list(range(10, MAX_WAITING + 10))


def test_followers_are_told_when_the_edge_goes_and_comes_back() -> None:
    async def follow() -> list[dict[str, Any]]:
        now_s, told = 0.0, []
        feed, edge = listening(now_s=lambda: now_s)
        watching = asyncio.create_task(feed.watch())
        async with feed.follow("a") as queue:
            told.append(await queue.get())
            assert feed.silent_s() is None and not feed.there()
            for _ in range(2):
                edge.publish("e3pose/lab/status", encode(status(3)))
                told += [await queue.get(), await queue.get()]
                now_s += QUIET_S - 0.1
                assert feed.there()
                now_s += 0.2
                told.append(await asyncio.wait_for(queue.get(), 10))
                assert feed.silent_s() == pytest.approx(QUIET_S + 0.1)
        watching.cancel()
        return [event.body | {"type": event.kind} for event in told]

    told = asyncio.run(follow())
    assert told[0] == {"type": "edge", "there": False, "heard_ns": None}
    assert [one["type"] for one in told[1:]] == ["edge", "status", "edge"] * 2
    assert [one["there"] for one in told if one["type"] == "edge"] == [False, True, False] + [
        True, False,
    ]  # fmt: skip
    assert told[3]["heard_ns"] == told[1]["heard_ns"] > 0


@pytest.mark.parametrize("slowly", ["names", "disks"])
def test_what_is_read_slowly_brings_no_older_status_after_a_newer(
    monkeypatch: pytest.MonkeyPatch, slowly: str
) -> None:
    async def follow() -> list[int]:
        feed, edge = listening()
        edge.publish("e3pose/lab/status", encode(status(3)))

        comes = threading.Thread(
            target=lambda: edge.publish("e3pose/lab/status", encode(status(4)))
        )

        def look(names: StoredNames, run_ns: int) -> bool:
            if slowly == "names":
                comes.start()
                comes.join()
            return True

        around = feed._status_event

        def event(newest: Status) -> Encoded:
            made = around(newest)
            if slowly == "disks" and comes.ident is None:
                comes.start()
                assert eventually(lambda: feed.status is not newest)
            return made

        monkeypatch.setattr(StoredNames, "look", look)
        async with feed.follow("10.0.0.1") as queue:
            monkeypatch.setattr(feed, "_status_event", event)
            feed.look_at_names()
            comes.join()
            await asyncio.sleep(0)
            told = [queue.get_nowait() for _ in range(queue.qsize())]
        return [event.body["slot"] for event in told if event.kind == "status"]

    assert asyncio.run(follow()) == ([3, 4, 4] if slowly == "names" else [3, 3, 4])


def test_who_was_there_before_the_page_is_in_view_since_the_store_says(watched: Watched) -> None:
    """The list, the line of time and the dialog of a person say one time, the store's."""
    with socket(watched) as following:
        numbers = iter(range(300, 400))

        def since() -> int:
            watched.publish(next(numbers))
            while (event := json.loads(following.recv(10)))["type"] != "slot":
                pass
            return int(event["people"][0]["since_ns"])

        assert eventually(lambda: since() == STARTED_NS), "track 10 is stored from slot 0 on"
    with watched.client() as client:
        rows = client.get("/api/tracks", params={"start": STARTED_NS, "end": 2**62}).json()["rows"]
    assert {row["first_ns"] for row in rows} == {STARTED_NS}


def test_without_a_store_somebody_is_there_since_the_first_slot_not_the_first_look() -> None:
    async def follow() -> dict[str, Any]:
        feed, hub = Feed("lab", doing=begin_watch(EventsTable(), COCO17.joints)), Hub()
        assert feed.doing is not None
        feed.doing = replace(feed.doing, rules={}, memories={})  # of a site without events
        feed.listen(hub.join())
        feed.attach(asyncio.get_running_loop())
        for slot in (3, 4):
            hub.join().publish("e3pose/lab/poses", encode(poses(slot)))
        async with feed.follow("10.0.0.1") as queue:
            for slot in (300, 301):
                hub.join().publish("e3pose/lab/poses", encode(poses(slot)))
            await asyncio.sleep(0)
            told = [queue.get_nowait() for _ in range(queue.qsize())]
        return [event.body for event in told if event.kind == "slot"][-1]

    person = asyncio.run(follow())["people"][0]
    assert person["state"] is not None and person["since_ns"] == poses(3).time_edge_ns


def test_so_many_and_no_more_follow() -> None:
    async def crowd() -> None:
        feed = Feed("lab")
        async with AsyncExitStack() as stack:
            for address in range(MAX_FOLLOWERS // MAX_OF_ADDRESS):
                for _ in range(MAX_OF_ADDRESS):
                    await stack.enter_async_context(feed.follow(f"10.0.0.{address}"))
                with pytest.raises(TooMany):  # one address leaves places for others
                    await stack.enter_async_context(feed.follow(f"10.0.0.{address}"))
            with pytest.raises(TooMany):
                await stack.enter_async_context(feed.follow("10.0.1.1"))
        assert feed.followers == 0

    asyncio.run(crowd())


def test_zone_events_and_counts_are_reported() -> None:
    async def follow() -> list[dict[str, Any]]:
        zone = ZoneTable("door", ((0.0, -1.0), (2.0, -1.0), (2.0, 5.0), (0.0, 5.0)))
        feed, edge = listening(zones=Zones((zone,)))
        async with feed.follow("10.0.0.1") as queue:
            edge.publish("e3pose/lab/poses", encode(poses(3)))
            await asyncio.sleep(0)
            return [json.loads(queue.get_nowait().json) for _ in range(queue.qsize())]

    *_, slot, event = asyncio.run(follow())
    assert slot["zones"] == {"door": 1}
    assert (event["type"], event["event"], event["zone"], event["track"]) == (
        "zone", "enter", "door", 11,
    )  # fmt: skip
