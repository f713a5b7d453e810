"""Rate limit by token buckets, one per client."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field

MAX_CLIENTS = 4096  # of whom the rate is kept; whoever asked longest ago is forgotten


@dataclass(slots=True, eq=False)
class Rate:
    """Limits what each of many clients asks for.

    Attributes:
        per_s: how many a second each may ask for, as a mean.
        burst: how many at once.
        now_s: a clock.
    """

    per_s: float
    burst: float
    now_s: Callable[[], float]
    _left: OrderedDict[str, tuple[float, float]] = field(default_factory=OrderedDict)

    def wait_s(self, client: str, count: float = 1.0) -> float:
        """Take from a client's bucket; return 0, or after how many seconds to ask again.

        Args:
            client: who asks.
            count: how much that costs; nothing is taken where too little is left.
        """
        now_s = self.now_s()
        left, before_s = self._left.pop(client, (self.burst, now_s))
        left = min(self.burst, left + (now_s - before_s) * self.per_s)
        wait_s = 0.0 if left >= count else (count - left) / self.per_s
        self._left[client] = (left if wait_s else left - count), now_s
        while len(self._left) > MAX_CLIENTS:
            self._left.popitem(last=False)
        return wait_s
