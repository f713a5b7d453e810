"""Guessing tokens is slow, for one address and for many, and the owner comes in meanwhile."""

from __future__ import annotations

from e3pose.site.web.guesses import (
    FIRST_WAIT_S,
    FREE,
    FREE_IN_ALL,
    LONGEST_WAIT_S,
    MANY,
    WAITING,
    Guesses,
)


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
    guesses = Guesses(Time())
    guesses.right("a", "mine")
    for _ in range(1000):
        guesses.wrong("a")
    assert guesses.wait_s("a", "mine") == 0.0 and guesses.wait_s("a", "other") > 0
    assert guesses.wait_s("b", "mine") > 0  # an accepted token is no proof for other addresses


def test_guesses_from_everywhere_make_new_tokens_wait_everywhere() -> None:
    guesses = Guesses(Time())
    for address in range(int(FREE_IN_ALL)):
        assert guesses.wait_s(f"10.0.0.{address}", "guess") == 0.0
        guesses.wrong(f"10.0.0.{address}")
    assert guesses.wait_s("192.168.0.1", "guess") == LONGEST_WAIT_S


def test_wrong_tokens_are_forgiven() -> None:
    now = Time()
    guesses = Guesses(now)
    for _ in range(1000):
        guesses.wrong("a")
    now.now_s = 60.0
    assert guesses.wait_s("a", "x") == 0.0


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
