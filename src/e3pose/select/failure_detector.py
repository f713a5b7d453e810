"""Failure detector: a camera that does not answer repeated orders is presumed dead.

After k orders in a row without an answer, a camera is either well and unlucky k times, or it died
in one of these slots. It is given up as soon as the second is the likelier:

    loss^k <= k * interval / MEAN_LIFE_S

A view that comes too late for its slot is a sign of life too (`acknowledge_late`), but useless: a
camera whose views are all late for `USELESS_S` is given up like a dead one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers

# tuned: s | by reasoning: once a day is often | by the truth of simulated links half: 4 more alarms
#   an hour of living cameras, dead ones noticed 0.1 s sooner; twice: 1.5 fewer, 0.04 s later
MEAN_LIFE_S = 86400.0  # between two deaths of a camera: once a day is often
# What a link may lose at any time, however good it was: that of the Wi-Fi a site must live with.
# And the most: where more is lost than comes, a camera is no great loss itself.
# tuned: share | by reasoning: the Wi-Fi that a site must live with | by the truth of simulated
#   links least halved and doubled: 4 more alarms an hour of living cameras, and 4 fewer, dead ones
#   noticed 0.1 s later; most halved: 44 more at a loss of 60 %; 0.9: the same
LOSS_RANGE = (0.05, 0.5)
# tuned: orders | by reasoning: a loss of 30 % is known to 3 points | by the truth of simulated
#   links half: 3 fewer alarms an hour of living cameras, dead ones noticed 0.1 s later; twice: 6
#   more, 0.1 s sooner
MEMORY_ORDERS = 200
USELESS_S = 1.5  # timeout: of orders without a view in time: with a deadline, noticed within 2 s
RETRY_S = 1.0  # timeout: a camera given up may be ordered again; doubled at each failure
RETRY_LIMIT_S = 8.0  # timeout: at most
_ROWS = np.arange(1, 65)  # capacity: the most misses that are waited for


@dataclass(frozen=True, slots=True, eq=False)
class Silence:
    """Silence of each camera: orders without an answer.

    Attributes:
        missed: `(num_cameras,)` orders in a row without a sign of life.
        useless: `(num_cameras,)` orders in a row that no view came for in time.
        loss: `(num_cameras,)` share of the orders that went without an answer while it lived.
        failures: `(num_cameras,)` how often in a row it was given up.
        retry_slot: `(num_cameras,)` the first slot for which a camera may be ordered again.
    """

    missed: Integers
    useless: Integers
    loss: Floats
    failures: Integers
    retry_slot: Integers

    @classmethod
    def none(cls, num_cameras: int) -> Silence:
        """Return the state before the first slot: all cameras are presumed alive."""
        zeros = np.zeros(num_cameras, dtype=np.int64)
        return cls(zeros, zeros, np.full(num_cameras, LOSS_RANGE[0]), zeros, zeros)

    def answering(self, slot: int | Integers) -> Flags:
        """Return `(num_cameras,)`: selectable cameras in `slot`; a row for each `(*slots, 1)`."""
        return np.asarray(self.retry_slot <= slot)

    def in_flight(self, orders: Flags, slot: int) -> Flags:
        """Return `(num_slots, num_cameras)`: orders for `slot` and the slots after it that hold.

        Cameras that were ordered and have since been given up will not look.

        Args:
            orders: `(num_slots, num_cameras)` to cameras that are online.
            slot: of the first row.
        """
        slots = np.arange(slot, slot + len(orders))
        return np.asarray(orders & self.answering(slots[:, None]))


def patience(loss: Floats, interval_s: float) -> Integers:
    """Return `(num_cameras,)`: after how many misses in a row death is likelier than bad luck.

    Args:
        loss: `(num_cameras,)` share of the orders that go without an answer, [0, 1].
        interval_s: seconds per slot.
    """
    unlucky = np.clip(loss, *LOSS_RANGE)[:, None] ** _ROWS
    died = _ROWS * min(interval_s / MEAN_LIFE_S, 1.0)
    return np.asarray(_ROWS[(unlucky <= died).argmax(axis=1)])


def listen(
    silence: Silence, slot: int, ordered: Flags, arrived: Flags, interval_s: float
) -> Silence:
    """Return the state after `slot`, in which cameras `ordered` to detect did or did not answer.

    Args:
        silence: what was known before.
        slot: the slot that was closed.
        ordered: `(num_cameras,)` who was to send a view.
        arrived: `(num_cameras,)` whose view came in time.
        interval_s: seconds per slot.
    """
    missed = np.where(arrived, 0, silence.missed + ordered)
    useless = np.where(arrived, 0, silence.useless + ordered)
    after = _answered(silence, arrived, interval_s, missed, useless)
    if not after.missed.any() and not after.useless.any():
        return after
    given_up = after.missed >= patience(after.loss, interval_s)
    given_up |= _is_useless(after, interval_s)
    # Orders that were on their way when it was given up are no further attempts.
    given_up &= ordered & (silence.retry_slot <= slot)
    wait_s = np.minimum(RETRY_S * 2.0 ** np.minimum(after.failures, 10), RETRY_LIMIT_S)
    again = slot + np.ceil(wait_s / interval_s).astype(np.int64)
    return replace(
        after,
        failures=after.failures + given_up,
        retry_slot=np.where(given_up, again, after.retry_slot),
    )


def acknowledge_late(
    silence: Silence, views_late: Flags, orders_late: Flags, interval_s: float
) -> Silence:
    """Return the state after signs of life other than a view in time.

    Args:
        silence: what was known before.
        views_late: `(num_cameras,)` whose view came after its slot was closed: it lives, but if no
            view was in time for `USELESS_S` it stays given up for its time.
        orders_late: `(num_cameras,)` who had an order too late: no fault of its own.
        interval_s: seconds per slot.
    """
    if not (views_late | orders_late).any():
        return silence
    alive = orders_late | (views_late & ~_is_useless(silence, interval_s))
    missed = np.where(views_late | orders_late, 0, silence.missed)
    useless = np.where(orders_late, 0, silence.useless)
    return _answered(silence, alive, interval_s, missed, useless)


def _is_useless(silence: Silence, interval_s: float) -> Flags:
    """Return `(num_cameras,)`: cameras without a view in time for too long, alive or not."""
    limit = np.maximum(np.ceil(USELESS_S / interval_s), patience(silence.loss, interval_s))
    return np.asarray(silence.useless >= limit)


def _answered(
    silence: Silence, who: Flags, interval_s: float, missed: Integers, useless: Integers
) -> Silence:
    """Return the state after an answer: the few misses before it were lost views.

    Args:
        silence: what was known before.
        who: `(num_cameras,)` whoever answered.
        interval_s: seconds per slot.
        missed: `(num_cameras,)` of now.
        useless: `(num_cameras,)` of now.
    """
    kept = 1 - 1 / MEMORY_ORDERS
    loss = silence.loss
    if silence.missed.any():
        unlucky = np.minimum(silence.missed, patience(loss, interval_s))
        loss = 1 - (1 - loss) * kept**unlucky
    return Silence(
        missed=missed,
        useless=useless,
        loss=np.where(who, kept * loss, silence.loss),
        failures=np.where(who, 0, silence.failures),
        retry_slot=np.where(who, 0, silence.retry_slot),
    )
