"""The Foxglove server: the protocol of Foxglove's own, for those who may, with bounds."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import foxglove
import pytest
from tests.cases import each_case
from tests.ports import free_port
from tests.site.streams.test_streams import EVENT, FELL, SOURCE, TIME_NS, slot, tell
from websockets.exceptions import InvalidStatus, WebSocketException
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as connect_socket
from websockets.typing import Origin, Subprotocol

from e3pose.base.errors import InputError
from e3pose.base.listener import Bounds, open_socket
from e3pose.site.serving import Serving
from e3pose.site.streams import Source, open_stream
from e3pose.site.streams.as_json import event_words
from e3pose.site.streams.base import Stream
from e3pose.site.streams.foxglove import CHANNELS
from e3pose.site.streams.foxglove_server import CLIENTS, CLIENTS_OF_ADDRESS, WAITING, FoxgloveServer

PROTOCOL = [Subprotocol("foxglove.sdk.v1")]


@contextmanager
def served(query: str = "", source: Source = SOURCE) -> Iterator[tuple[Stream, str]]:
    port = free_port()
    stream = open_stream(f"foxglove://127.0.0.1:{port}{query}", source)
    try:
        yield stream, f"ws://127.0.0.1:{port}"
    finally:
        stream.close()


def joined(url: str, **more: Any) -> ClientConnection:
    made: ClientConnection = connect_socket(url, subprotocols=PROTOCOL, ping_interval=None, **more)
    return made


def advertised(client: ClientConnection) -> list[dict[str, Any]]:
    """Return server information and channels, without what differs each time."""
    said: list[dict[str, Any]] = []
    while not said or said[-1]["op"] != "advertise":
        said.append(json.loads(client.recv(20)))
    said[0].pop("sessionId")
    said[0].pop("metadata")
    for one in said[-1]["channels"]:
        one.pop("id")
        if one["encoding"] == "json":
            one.pop("schemaName")
    said[-1]["channels"].sort(key=lambda one: str(one["topic"]))
    return said


def test_it_says_what_foxgloves_own_server_says() -> None:
    context = foxglove.Context()
    own = foxglove.start_server(name="e3pose lab", port=0, context=context)
    schema = foxglove.Schema(
        name=CHANNELS[0].schema_name, encoding="protobuf", data=CHANNELS[0].schema
    )
    kept = [
        foxglove.Channel("/scene", message_encoding="protobuf", schema=schema, context=context),
        foxglove.Channel("/poses", message_encoding="json", context=context),
        foxglove.Channel("/zones", message_encoding="json", context=context),
        foxglove.Channel("/events", message_encoding="json", context=context),
    ]
    with served() as (_, url), joined(f"ws://127.0.0.1:{own.port}") as theirs, joined(url) as ours:
        assert theirs.subprotocol == ours.subprotocol == "foxglove.sdk.v1"
        assert advertised(ours) == advertised(theirs)
    own.stop()
    assert len(kept) == len(CHANNELS)


def test_subscribers_alone_get_messages_until_they_leave() -> None:
    with served() as (stream, url), joined(url) as client:
        ids = {c["topic"]: c["id"] for c in _channels(client)}
        both = [{"id": 7, "channelId": ids["/zones"]}, {"id": 8, "channelId": ids["/zones"]}]
        client.send(json.dumps({"op": "subscribe", "subscriptions": both}))
        found: str | bytes = b""
        while not found:
            stream.slot(slot(7))  # nobody asked for poses
            stream.zone(EVENT)
            with suppress(TimeoutError):
                found = client.recv(0.2)
        assert isinstance(found, bytes) and found[0] == 1
        assert int.from_bytes(found[1:5], "little") == 7
        assert int.from_bytes(found[5:13], "little") == TIME_NS
        assert json.loads(found[13:])["zone"] == "door"
        told = [{"id": 9, "channelId": ids["/events"]}]
        client.send(json.dumps({"op": "subscribe", "subscriptions": told}))
        while not (isinstance(found, bytes) and found[1] == 9):
            tell(stream)
            with suppress(TimeoutError):
                found = client.recv(0.2)
        assert json.loads(found[13:]) == event_words(FELL)
        client.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [7, 8, 9]}))
        client.send("garbage")  # answered after what came before it
        while not (isinstance(found, str) and json.loads(found)["op"] == "status"):
            found = client.recv(20)
        stream.zone(EVENT)
        with pytest.raises(TimeoutError):
            client.recv(0.3)


def _channels(client: ClientConnection) -> list[dict[str, Any]]:
    client.recv(20)
    return list(json.loads(client.recv(20))["channels"])


@each_case(
    "said",
    [
        "garbage",
        "[]",
        "{}",
        '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 99}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": 1e999, "channelId": 1}]}',
        '{"op": "unsubscribe", "subscriptionIds": [[]]}',
        "[" * 4000,
        b"\x00\x01",
    ],
    ids=lambda said: str(said)[:30],
)
def test_odd_request_is_answered_and_the_client_stays(said: str | bytes) -> None:
    with served() as (_, url), joined(url) as client:
        _channels(client)
        client.send(said)
        answer = json.loads(client.recv(20))
        assert answer["op"] == "status" and answer["level"] == 2


@each_case(
    ("origin", "comes_in"),
    [
        (None, True),  # no browser
        ("http://localhost:3000", True),
        ("http://127.0.0.1:8080", True),
        ("https://app.foxglove.dev", True),  # as the target names it
        ("https://evil.example", False),
        ("http://localhost.evil.example", False),
        ("null", False),
        ("https://app.foxglove.dev.evil.example", False),
        ("http://[", False),
    ],
)
def test_only_own_pages_and_named_ones_connect(origin: str | None, comes_in: bool) -> None:
    said: list[str] = []
    source = Source(SOURCE.site, SOURCE.skeleton, SOURCE.fps, said.append)
    with served("?origin=https://app.foxglove.dev", source) as (_, url):
        if comes_in:
            with joined(url, origin=None if origin is None else Origin(origin)) as client:
                assert len(_channels(client)) == len(CHANNELS)
            assert said == []
            return
        for _ in range(3):
            with pytest.raises(InvalidStatus, match="403"):
                joined(url, origin=Origin(str(origin)))
        assert len(said) == 1 and f"refused a page of {origin!r}" in said[0]


@each_case("query", ["?origin=evil", "?origins=https://a", "?origin=https://a/"])
def test_origin_that_is_none_is_refused(query: str) -> None:
    with pytest.raises(InputError, match="origin=https://HOST"), served(query):
        pass


def test_address_has_its_number_of_clients_and_no_more() -> None:
    with served() as (_, url), ExitStack() as stack:
        with pytest.raises(InvalidStatus, match="403"):
            connect_socket(url)  # of another protocol
        for _ in range(CLIENTS_OF_ADDRESS):
            assert len(_channels(stack.enter_context(joined(url)))) == len(CHANNELS)
        with pytest.raises((OSError, WebSocketException)):
            joined(url, open_timeout=5)


class _Counted(bytes):
    """A message that says how many like it are still held."""

    held = 0

    def __new__(cls, *of: Any) -> _Counted:
        cls.held += 1
        return super().__new__(cls, *of)

    def __del__(self) -> None:
        type(self).held -= 1


def _number(message: str | bytes) -> int:
    assert isinstance(message, bytes)
    return int.from_bytes(message[13:17], "little")


def test_crowd_of_deaf_clients_is_bounded_and_gets_the_newest() -> None:
    published, last, message_bytes = 300, 1500, 16_384
    loops: list[asyncio.AbstractEventLoop] = []
    busy = threading.Event()
    asked = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1}]}
    server = FoxgloveServer("lab", CHANNELS, frozenset(), print)
    listening = open_socket("127.0.0.1", 0)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 65536)  # the system holds little, too
    place = listening.getsockname()

    async def app(scope: Any, receive: Any, send: Any) -> None:
        loops.append(asyncio.get_running_loop())
        await server(scope, receive, send)

    serving = Serving(app, listening, Bounds(CLIENTS, CLIENTS_OF_ADDRESS), None)
    with ExitStack() as stack:
        stack.callback(serving.close)
        stack.callback(busy.set)
        clients = []
        for _ in range(CLIENTS_OF_ADDRESS):
            narrow = socket.socket()
            narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            narrow.connect(place)
            url = f"ws://{place[0]}:{place[1]}"
            plain = joined(url, sock=narrow, compression=None, close_timeout=0)
            clients.append(stack.enter_context(plain))
            _channels(clients[-1])
            clients[-1].send(json.dumps(asked))
            clients[-1].send("garbage")  # answered after the request before it
            assert json.loads(clients[-1].recv(20))["op"] == "status"
        deaf, lively = clients[1:], clients[0]

        # The deaf take nothing, and one beside them everything, one message after the other.
        for number in range(published):
            server.log("/scene", _Counted(number.to_bytes(message_bytes, "little")), number)
            assert _number(lively.recv(20)) == number
        assert _Counted.held <= WAITING + len(deaf)  # the one that each is being sent

        # A burst comes while the server is busy: no more than before waits for each of them.
        loops[0].call_soon_threadsafe(busy.wait)
        for number in range(published, last):
            server.log("/scene", _Counted(number.to_bytes(message_bytes, "little")), number)
        assert _Counted.held <= (WAITING + 1) * len(clients)
        busy.set()

        # One that listens at last hears what was under way, half a megabyte, and then the newest.
        heard = [_number(deaf[0].recv(20))]
        while heard[-1] != last - 1:
            heard.append(_number(deaf[0].recv(20)))
        assert heard[-WAITING:] == list(range(last - WAITING, last))
        assert heard == sorted(heard) and len(heard) < 100
