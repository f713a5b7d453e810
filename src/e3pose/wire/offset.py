"""Clock offset of a camera: NTP-like exchanges of four time stamps, and a line through many.

An exchange has the times t1 (asked) and t4 (answered) of the camera and t2 (received) and t3 (sent)
of the edge. As in NTP (RFC 5905, section 8) the offset is ((t2 - t1) + (t3 - t4)) / 2, off by at
most half the delay (t4 - t1) - (t3 - t2). Exchanges that a network delayed say little, so only the
quickest of the recent ones are believed; a line through them gives offset and drift.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

MAX_EXCHANGES = 128  # a bounded memory: two minutes at one a second
BELIEVED_SHARE = 0.1  # the quickest of the exchanges kept
MIN_SPAN_S = 20.0  # over less time a drift drowns in the delays
LINE_PPM = 30.0  # a drift is fitted where delays spoil it by no more than this
LIKELY_DRIFT_PPM = 50.0  # of a clock that nothing is known of
MAX_DRIFT_PPM = 500.0  # quartz does 100; more is a clock that was set
STEP_COUNT = 3  # exchanges in a row that contradict the line: the clock was set


@dataclass(frozen=True, slots=True)
class Exchange:
    """One question to the edge and its answer.

    Attributes:
        at_ns: the camera's time in the middle of it.
        offset_ns: edge time minus camera time.
        delay_ns: time on the network, both ways.
    """

    at_ns: int
    offset_ns: int
    delay_ns: int

    @classmethod
    def of_stamps(cls, asked_ns: int, received_ns: int, sent_ns: int, answered_ns: int) -> Exchange:
        """Return an exchange from its four time stamps, nanoseconds, as in NTP (RFC 5905).

        Args:
            asked_ns: when the question left, by the camera's clock (t1).
            received_ns: when it arrived, by the edge's clock (t2).
            sent_ns: when the answer left, by the edge's clock (t3).
            answered_ns: when it arrived, by the camera's clock (t4).
        """
        delay = (answered_ns - asked_ns) - (sent_ns - received_ns)
        offset = ((received_ns - asked_ns) + (sent_ns - answered_ns)) // 2
        return cls((asked_ns + answered_ns) // 2, offset, max(delay, 0))


@dataclass(frozen=True, slots=True)
class Offset:
    """Edge time minus camera time, as a line in camera time.

    Attributes:
        at_ns: camera time at which `offset_ns` holds.
        offset_ns: there.
        drift_ppm: millionths by which it grows.
        error_ns: how far it may be off, half the shortest delay; None before the first exchange.
    """

    at_ns: int = 0
    offset_ns: int = 0
    drift_ppm: float = 0.0
    error_ns: int | None = None

    def edge_ns(self, camera_ns: int) -> int:
        """Return the edge's time at a time of the camera."""
        return camera_ns + self.offset_ns + round((camera_ns - self.at_ns) * self.drift_ppm * 1e-6)


@dataclass(frozen=True, slots=True)
class OffsetEstimate:
    """The clock exchanges of a camera; a value.

    Attributes:
        exchanges: the newest ones, oldest first.
        outliers: how many of the newest in a row contradict the others.
        offset: the estimate they give.
    """

    exchanges: tuple[Exchange, ...] = ()
    outliers: int = 0
    offset: Offset = field(default_factory=Offset)


def take_in(estimate: OffsetEstimate, exchange: Exchange) -> OffsetEstimate:
    """Return the estimate after one more exchange.

    A clock that was set is believed after three exchanges that say so: all before are forgotten.
    """
    known = estimate.offset.error_ns is not None
    predicted = estimate.offset.edge_ns(exchange.at_ns) - exchange.at_ns
    doubt = exchange.delay_ns // 2 + (estimate.offset.error_ns or 0) + 1_000_000
    strange = known and abs(exchange.offset_ns - predicted) > doubt
    outliers = estimate.outliers + 1 if strange else 0
    exchanges = (*estimate.exchanges, exchange)[-MAX_EXCHANGES:]
    if outliers >= STEP_COUNT:
        exchanges, outliers = exchanges[-STEP_COUNT:], 0
    elif outliers:  # a stranger is not believed before its time
        return OffsetEstimate(exchanges, outliers, estimate.offset)
    return OffsetEstimate(exchanges, outliers, _fit(exchanges))


def _fit(exchanges: tuple[Exchange, ...]) -> Offset:
    newest = exchanges[-1].at_ns
    at_s = np.array([(e.at_ns - newest) / 1e9 for e in exchanges])
    base = exchanges[-1].offset_ns
    offset_ns = np.array([float(e.offset_ns - base) for e in exchanges])
    delay_ns = np.array([float(e.delay_ns) for e in exchanges])
    count = max(min(3, len(delay_ns)), round(len(delay_ns) * BELIEVED_SHARE))
    believed = np.argsort(delay_ns, kind="stable")[:count]
    at, offsets = at_s[believed], offset_ns[believed]
    error = delay_ns.min() / 2
    spread = (delay_ns[believed].max() - delay_ns.min()) / 2
    if np.ptp(at) < MIN_SPAN_S or spread > np.ptp(at) * LINE_PPM * 1e3:
        quickest = believed[0]  # which may be old, and clocks drift
        error += -at_s[quickest] * LIKELY_DRIFT_PPM * 1e3
        return Offset(newest, base + round(offset_ns[quickest]), 0.0, int(error) + 1)
    slope, level = np.polyfit(at, offsets, 1)
    drift_ppm = float(np.clip(slope / 1e3, -MAX_DRIFT_PPM, MAX_DRIFT_PPM))  # ns a second
    return Offset(newest, base + round(float(level)), drift_ppm, int(error + spread) + 1)
