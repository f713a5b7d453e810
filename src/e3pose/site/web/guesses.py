"""Slow down who guesses tokens.

A token that an address has shown before is accepted at once. Another one waits before it is
compared, right or wrong: the longer, the more wrong tokens came lately from the address, or from
everywhere. So guessing takes years, and an owner who comes in while somebody guesses takes seconds.
"""

from __future__ import annotations

import hmac
import secrets
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

FREE, FREE_IN_ALL = 10.0, 100.0  # wrong tokens that make nobody wait: of an address, of all
FORGIVEN_PER_S, FORGIVEN_IN_ALL_PER_S = 0.2, 1.0
FIRST_WAIT_S, LONGEST_WAIT_S = 0.25, 4.0
MOST_COUNTED = 10.0  # beyond those that are free: an address is forgiven in a minute
WAITING = 16  # requests of an address that wait; more are refused
MAX_KNOWN = 1024
MANY, REPORT_S = 20, 60.0  # wrong tokens worth an event, and seconds to the next


@dataclass(slots=True)
class _Count:
    """A count of wrong tokens that decays every second."""

    free: float
    per_s: float
    count: float = 0.0
    at_s: float = 0.0

    def add(self, number: float, now_s: float) -> float:
        """Add to the count and return it."""
        left = max(0.0, self.count - (now_s - self.at_s) * self.per_s)
        self.count, self.at_s = min(left + number, self.free + MOST_COUNTED), now_s
        return self.count


@dataclass(slots=True, eq=False)
class Guesses:
    """Counts wrong tokens.

    Attributes:
        now_s: a clock.
        report: called with a line for operators after many wrong tokens.
    """

    now_s: Callable[[], float]
    report: Callable[[str], object] = lambda line: None
    _counts: OrderedDict[str, _Count] = field(default_factory=OrderedDict)
    _all: _Count = field(default_factory=lambda: _Count(FREE_IN_ALL, FORGIVEN_IN_ALL_PER_S))
    _waiting: dict[str, int] = field(default_factory=dict)
    _known: OrderedDict[bytes, None] = field(default_factory=OrderedDict)
    _salt: bytes = field(default_factory=lambda: secrets.token_bytes(16))
    _unreported: int = 0
    _reported_s: float | None = None

    def wait_s(self, address: str, token: str) -> float:
        """Return how long a token of an address waits before it is compared."""
        if self._digest(address, token) in self._known:
            return 0.0
        now_s = self.now_s()
        if self._all.add(0.0, now_s) >= FREE_IN_ALL:
            return LONGEST_WAIT_S
        count = self._counts.get(address)
        over = -1.0 if count is None else count.add(0.0, now_s) - FREE
        return 0.0 if over < 0 else min(LONGEST_WAIT_S, FIRST_WAIT_S * 2.0**over)

    def enter(self, address: str) -> bool:
        """Return whether one more request of an address may wait; if so, call `leave` after it."""
        waiting = self._waiting.get(address, 0)
        if waiting >= WAITING:
            return False
        self._waiting[address] = waiting + 1
        return True

    def leave(self, address: str) -> None:
        """End the wait of a request."""
        self._waiting[address] -= 1
        if not self._waiting[address]:
            del self._waiting[address]

    def right(self, address: str, token: str) -> None:
        """Remember that an address has shown a right token."""
        digest = self._digest(address, token)
        self._known.pop(digest, None)
        self._known[digest] = None
        while len(self._known) > MAX_KNOWN:
            self._known.popitem(last=False)

    def wrong(self, address: str) -> None:
        """Count a wrong token of an address."""
        now_s = self.now_s()
        self._all.add(1.0, now_s)
        count = self._counts.pop(address, None) or _Count(FREE, FORGIVEN_PER_S)
        count.add(1.0, now_s)
        self._counts[address] = count
        while len(self._counts) > MAX_KNOWN:
            self._counts.popitem(last=False)
        self._unreported += 1
        due = self._reported_s is None or now_s >= self._reported_s + REPORT_S
        if self._unreported >= MANY and due:
            self.report(
                f"{self._unreported} wrong tokens, the last from {address}: somebody guesses; "
                f"a new token waits up to {LONGEST_WAIT_S:g} s, one already accepted does not"
            )
            self._unreported, self._reported_s = 0, now_s

    def _digest(self, address: str, token: str) -> bytes:
        said = f"{address} {token}".encode(errors="replace")
        return hmac.digest(self._salt, said, "sha256")
