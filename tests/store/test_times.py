"""Points in time as people write them."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from zoneinfo import ZoneInfo

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.store.times import as_when, iso_text, parse_when

BERLIN = timezone(timedelta(hours=1))
NOW = datetime(2026, 11, 21, 14, 30, 0, tzinfo=BERLIN)


def utc_ns(*parts: int) -> int:
    return round(datetime(*parts, tzinfo=timezone.utc).timestamp()) * 10**9  # type: ignore[arg-type,misc]


@each_case(
    ("words", "expected"),
    [
        ("2026-11-21T14:00", utc_ns(2026, 11, 21, 13)),
        ("2026-11-21 14:00:05", utc_ns(2026, 11, 21, 13, 0, 5)),
        ("2026-11-21T13:00Z", utc_ns(2026, 11, 21, 13)),
        ("2026-11-21T13:00:00.25Z", utc_ns(2026, 11, 21, 13) + 250_000_000),
        ("2026-11-21T13:00:00-05:00", utc_ns(2026, 11, 21, 18)),
        ("2026-11-21", utc_ns(2026, 11, 20, 23)),
        ("14:00", utc_ns(2026, 11, 21, 13)),
        ("9:05:01", utc_ns(2026, 11, 21, 8, 5, 1)),
        ("now", utc_ns(2026, 11, 21, 13, 30)),
        ("-10min", utc_ns(2026, 11, 21, 13, 20)),
        ("-1.5h", utc_ns(2026, 11, 21, 12)),
        ("-2d", utc_ns(2026, 11, 19, 13, 30)),
        ("-30", utc_ns(2026, 11, 21, 13, 29, 30)),
    ],
)
def test_absolute_times(words: str, expected: int) -> None:
    when = parse_when(words, NOW, BERLIN)
    assert (when.origin, when.ns) == ("1970", expected)


@each_case(
    ("words", "seconds"), [("12.5", 12.5), ("90s", 90), ("5min", 300), ("0", 0), ("+2h", 7200)]
)
def test_seconds_of_a_run(words: str, seconds: float) -> None:
    when = parse_when(words, NOW, BERLIN)
    assert (when.origin, when.ns) == ("run", round(seconds * 10**9))
    assert when.absolute(1000) == 1000 + round(seconds * 10**9)


def test_summer_time_counts_on_the_day_asked_for() -> None:
    when = parse_when("2026-07-01T14:00", NOW, ZoneInfo("Europe/Berlin"))
    assert when.ns == utc_ns(2026, 7, 1, 12)


@each_case(
    "words", ["", "yesterday", "12 parsecs", "2026-13-01", "25:00", "9" * 40, "0001-01-01", "--5"]
)
def test_anything_else_is_refused(words: str) -> None:
    with pytest.raises(InputError, match="expected 2026-11-21T14:00"):
        parse_when(words, NOW, BERLIN)


def test_text_and_back_is_the_same_to_the_microsecond() -> None:
    ns = 1_795_000_000_123_456_789
    assert iso_text(ns) == "2026-11-18T11:06:40.123456Z"
    assert as_when(iso_text(ns), NOW).ns == ns // 1000 * 1000
