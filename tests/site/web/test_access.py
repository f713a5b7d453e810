"""What may ask a page for what, and how slow guessing tokens is."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.base.rate_limit import MAX_CLIENTS, Rate
from e3pose.site.web.access import (
    FIRST_WAIT_S,
    FREE,
    FREE_IN_ALL,
    LONGEST_WAIT_S,
    MANY,
    WAITING,
    Client,
    Guesses,
    Rules,
)
from e3pose.site.web.tokens import Tokens, make_tokens, open_tokens

TOKENS = Tokens("e3pose-view-tokens", 1, "r" * 20, "w" * 20)
HOST = "localhost:8470"


def rules(open_reading: bool = True, secure: bool = False) -> Rules[Tokens]:
    return Rules(TOKENS, frozenset({"localhost", "edge.local"}), open_reading, secure)


def refused(made: Rules[Tokens], path: str = "/api/status", **headers: str) -> int:
    """Return the status with which a request is refused; 0 for one that comes in."""
    named = {name.replace("_", "-"): value for name, value in ({"host": HOST} | headers).items()}
    _, refusal = made.judge(path, named, Client("10.0.0.1", made.secure))
    return 0 if refusal is None else refusal.status


def bearer(token: str) -> str:
    return f"Bearer {token}"


@each_case(
    ("host", "status"),
    [
        ("localhost:8470", 0),
        ("LOCALHOST", 0),
        ("edge.local:8470", 0),
        ("127.0.0.1:8470", 0),
        ("[::1]:8470", 0),
        ("192.168.1.7:8470", 0),  # no foreign name can stand for an address
        ("evil.example:8470", 421),
        ("localhost.evil.example", 421),
        ("", 421),
    ],
)
def test_only_our_own_names_and_addresses_are_hosts(host: str, status: int) -> None:
    assert refused(rules(), host=host) == status
    assert refused(rules(), "/", host=host) == status


@each_case(
    ("origin", "status"),
    [
        ("http://localhost:8470", 0),
        ("http://localhost:9999", 403),
        ("http://evil.example", 403),
        ("https://localhost:8470", 403),
        ("null", 403),
    ],
)
def test_only_our_own_page_may_ask(origin: str, status: int) -> None:
    assert refused(rules(), origin=origin) == status
    assert refused(rules(), origin=origin, authorization=bearer(TOKENS.write)) == status
    if "localhost:8470" in origin:
        assert refused(rules(secure=True), origin=origin) == 403 - status, "a page over https"


def test_a_link_to_the_page_works_and_a_foreign_request_to_the_api_does_not() -> None:
    assert refused(rules(), "/", sec_fetch_site="cross-site") == 0
    assert refused(rules(), sec_fetch_site="cross-site") == 403
    assert refused(rules(), sec_fetch_site="same-origin") == 0


def test_reading_beyond_loopback_needs_a_token_and_the_page_itself_does_not() -> None:
    assert refused(rules(), authorization=bearer("x" * 20)) == 401, "on loopback either"
    closed = rules(open_reading=False)
    assert refused(closed) == 401 and refused(closed, "/") == 0
    assert refused(closed, authorization=bearer(TOKENS.read)) == 0
    assert refused(closed, authorization=bearer("x" * 20)) == 401
    assert refused(closed, sec_websocket_protocol=f"e3pose, e3pose.token.{TOKENS.read}") == 0
    assert refused(closed, sec_websocket_protocol="e3pose, e3pose.token.wrong") == 401


def test_control_needs_the_token_for_writing_everywhere() -> None:
    made = rules()
    assert refused(made, "/api/control/loop") == 401
    assert refused(made, "/api/control/loop", authorization=bearer(TOKENS.read)) == 403
    assert refused(made, "/api/control/loop", authorization=bearer(TOKENS.write)) == 0


@each_case(
    ("headers", "status"),
    [
        ({"content_length": "100"}, 0),
        ({"content_length": "5000"}, 413),
        ({"content_length": "9" * 40}, 413),
        ({"content_length": "-1"}, 413),
        ({"transfer_encoding": "chunked"}, 411),
    ],
)
def test_body_has_a_length_and_it_is_small(headers: dict[str, str], status: int) -> None:
    authorization = bearer(TOKENS.write)
    assert refused(rules(), "/api/control/loop", authorization=authorization, **headers) == status


@each_case(
    ("address", "said", "client"),
    [
        ("127.0.0.1", "10.1.2.3", "10.1.2.3"),
        ("127.0.0.1", "1.1.1.1, 10.1.2.3", "10.1.2.3"),  # what the client itself said is hearsay
        ("127.0.0.1", "10.1.2.3, 127.0.0.1", "10.1.2.3"),
        ("127.0.0.1", "", "127.0.0.1"),
        ("10.9.9.9", "10.1.2.3", "10.9.9.9"),  # anybody can say so
    ],
)
def test_only_proxies_say_for_whom_they_ask(address: str, said: str, client: str) -> None:
    made = Rules(TOKENS, frozenset(), False, proxies=frozenset({"127.0.0.1"}))
    named = {"x-forwarded-for": said, "x-forwarded-proto": "https"}
    found = made.client_of(address, named)
    assert (found.address, found.secure) == (client, address == "127.0.0.1")
    # A proxy that is not named passes no page without tokens on.
    assert refused(rules(), x_forwarded_for="10.1.2.3") == 403
    assert refused(rules(open_reading=False), x_forwarded_for="10.1.2.3") == 401


def test_who_has_a_token_has_a_rate_apart_from_others_at_the_address() -> None:
    made = rules()
    made.reads = Rate(0.001, 3.0, time.monotonic)
    assert [refused(made) for _ in range(4)] == [0, 0, 0, 429]
    assert refused(made, authorization=bearer(TOKENS.read)) == 0


def test_rate_is_a_mean_with_a_burst_for_each_client() -> None:
    time_s = [0.0]
    rate = Rate(2.0, 3.0, lambda: time_s[0])
    assert [rate.wait_s("a") for _ in range(3)] == [0, 0, 0]
    assert rate.wait_s("a") == pytest.approx(0.5)
    assert rate.wait_s("b") == 0
    time_s[0] = 0.5
    assert rate.wait_s("a") == 0 and rate.wait_s("a") > 0


def test_as_many_clients_as_may_come_are_remembered() -> None:
    rate = Rate(1.0, 1.0, lambda: 0.0)
    for client in range(MAX_CLIENTS + 10):
        assert rate.wait_s(str(client)) == 0
    assert len(rate._left) == MAX_CLIENTS


def test_tokens_are_made_once_and_private(tmp_path: Path) -> None:
    path = tmp_path / "view-tokens.toml"
    made = open_tokens(path)
    assert open_tokens(path) == made and path.stat().st_mode & 0o777 == 0o600
    assert made != make_tokens() and made.read != made.write
    assert made.scope(made.read) == "read" and made.scope(made.write) == "write"
    assert made.scope("") is None and made.scope(made.read[:-1]) is None
    assert made.scope("\udcff") is None


@each_case(
    ("read", "write", "message"),
    [("short", "w" * 20, "read: found no token"), ("w" * 20, "w" * 20, "write: found the token")],
)
def test_file_of_tokens_is_checked(tmp_path: Path, read: str, write: str, message: str) -> None:
    path = tmp_path / "tokens.toml"
    lines = [
        'format = "e3pose-view-tokens"',
        "version = 1",
        f'read = "{read}"',
        f'write = "{write}"',
    ]
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=message) as error:
        open_tokens(path)
    assert str(path) in str(error.value) and "w" * 20 not in str(error.value)


class Time:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_address_with_wrong_tokens_waits_longer_each_time_and_others_do_not() -> None:
    guesses = Guesses(Time())
    waits = []
    for number in range(20):
        waits.append(guesses.wait_s("a", f"guess{number}"))
        guesses.wrong("a")
    assert waits[: int(FREE)] == [0.0] * int(FREE)
    assert waits[int(FREE)] == FIRST_WAIT_S and waits[-1] == LONGEST_WAIT_S
    assert waits == sorted(waits)
    assert guesses.wait_s("a", "the right one") == LONGEST_WAIT_S
    assert guesses.wait_s("b", "the right one") == 0.0


def test_token_that_was_accepted_before_does_not_wait_there() -> None:
    now = Time()
    guesses = Guesses(now)
    guesses.right("a", "mine")
    for _ in range(1000):
        guesses.wrong("a")
    assert guesses.wait_s("a", "mine") == 0.0 and guesses.wait_s("a", "other") > 0
    assert guesses.wait_s("b", "mine") > 0  # an accepted token is no proof for other addresses
    now.now_s = 60.0
    assert guesses.wait_s("a", "other") == 0.0, "wrong ones are forgiven"


def test_guesses_from_everywhere_make_new_tokens_wait_everywhere() -> None:
    guesses = Guesses(Time())
    for address in range(int(FREE_IN_ALL)):
        assert guesses.wait_s(f"10.0.0.{address}", "guess") == 0.0
        guesses.wrong(f"10.0.0.{address}")
    assert guesses.wait_s("192.168.0.1", "guess") == LONGEST_WAIT_S


def test_so_many_of_an_address_wait_and_no_more() -> None:
    guesses = Guesses(Time())
    assert [guesses.enter("a") for _ in range(WAITING + 1)] == [True] * WAITING + [False]
    assert guesses.enter("b")
    guesses.leave("a")
    assert guesses.enter("a")


def test_many_wrong_tokens_are_reported_in_one_line() -> None:
    said: list[str] = []
    now = Time()
    guesses = Guesses(now, said.append)
    for _ in range(MANY * 5):
        guesses.wrong("10.0.0.7")
    assert len(said) == 1 and said[0].startswith(f"{MANY} wrong tokens, the last from 10.0.0.7")
    now.now_s = 61.0
    guesses.wrong("10.0.0.7")
    assert said[1:] and said[1].startswith(f"{MANY * 4 + 1} wrong tokens")
