"""Days of made-up sites, written by the code that writes those of real ones.

Summaries come from `e3pose.store.summaries`. People come at eight and leave at six; batteries of
two of four cameras empty by day; a person falls now and then. The same seed makes the same days.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np

from e3pose.store.rows import NS
from e3pose.store.schema import SUMMARY_JSON
from e3pose.store.summaries import MINUTE_NS, Tally, summary
from e3pose_hub.records import Summary

BEGIN_NS = 1_793_491_200 * NS  # 2026-11-01, a Sunday, midnight, UTC
CAMERAS = ("cam1", "cam2", "cam3", "cam4")
ZONES = ("entrance", "desk", "kitchen")
STATES = ("standing", "sitting", "walking")
DAY = 1440  # minutes
FPS = 25
OPEN, CLOSED = 8, 18  # hours of a day
FALL_SHARE = 1 / 3000  # of a person's minutes
BLIND_SHARE, LOST_SHARE = 0.02, 0.005  # of the minutes
WATTS = 6.0


def summaries_of(seed: int, first: int, count: int) -> Iterator[dict[str, Any]]:
    """Yield summaries of so many minutes from one on, as rows of a store, oldest first.

    Args:
        seed: of the site.
        first: minute after `BEGIN_NS`.
        count: how many.
    """
    software = f"e3pose 0.{1 + seed % 3}"
    for day in range(first // DAY, (first + count - 1) // DAY + 1):
        draws = Draws(np.random.default_rng((seed, day)), 2 + seed % 3)
        for minute in range(max(first, day * DAY), min(first + count, (day + 1) * DAY)):
            begin_ns = BEGIN_NS + minute * MINUTE_NS
            tally = _minute(seed, minute % DAY, begin_ns, draws)
            yield summary(tally, begin_ns + MINUTE_NS, software)


def records_of(seed: int, first: int, count: int) -> Iterator[Summary]:
    """Yield the same as a hub reads them; numbers count minutes from 1."""
    for at, row in enumerate(summaries_of(seed, first, count), start=first + 1):
        read = {name: msgspec.json.decode(row[name]) for name in SUMMARY_JSON}
        yield Summary(**{**row, **read, "number": at, "started_ns": BEGIN_NS})


class Draws:
    """Random events in the minutes of a day."""

    def __init__(self, random: np.random.Generator, people: int) -> None:
        """Draw all of a day at once."""
        hours = np.arange(DAY) // 60
        inside = (hours >= OPEN) & (hours < CLOSED)
        here = np.where(inside, random.poisson(people, DAY), 0)
        self.here: list[int] = here.tolist()
        self.zones: list[list[int]] = random.multinomial(
            here, [1 / len(ZONES)] * len(ZONES)
        ).tolist()
        self.states: list[list[int]] = random.multinomial(here, [0.5, 0.3, 0.2]).tolist()
        self.entered: list[int] = random.poisson(0.3 * here).tolist()
        self.falls: list[int] = random.binomial(here, FALL_SHARE).tolist()
        self.spread_m: list[float] = (0.02 + 0.01 * random.random(DAY)).tolist()
        blind = random.random(DAY) < BLIND_SHARE
        self.blind: list[int] = np.where(blind, random.integers(1, 200, DAY), 0).tolist()
        self.lost: list[bool] = (random.random(DAY) < LOST_SHARE).tolist()


def _minute(seed: int, at: int, begin_ns: int, draws: Draws) -> Tally:
    here, tally = draws.here[at], Tally(begin_ns)
    tally.slots = 60 * FPS
    tally.views = 2 * tally.slots
    tally.people, tally.most_people = here * tally.slots, here
    tally.took_s = 1e-3 * tally.slots * (1 + 0.3 * here)
    if here:
        tally.joints = here * tally.slots * 17
        tally.variance_m2 = tally.joints * draws.spread_m[at] ** 2
        for names, counts, sums in (
            (ZONES, draws.zones[at], tally.zone_s),
            (STATES, draws.states[at], tally.state_s),
        ):
            for name, count in zip(names, counts, strict=True):
                sums[name] += 60.0 * count
        if draws.entered[at]:
            tally.entered[ZONES[0]] = draws.entered[at]
        if draws.falls[at]:
            tally.events["fall begun"] = draws.falls[at]
    if draws.blind[at]:
        tally.blind["views-late"] = draws.blind[at]
    if draws.lost[at]:
        tally.events["camera-lost"] = 1
        tally.faults.add(f"camera-lost {CAMERAS[at % len(CAMERAS)]}")
    tally.joules = {
        camera: {"measured" if number < 2 else "modelled": 60 * WATTS / (1 + number % 2)}
        for number, camera in enumerate(CAMERAS)
    }
    spent = at / DAY * (0.5 + 0.1 * (seed % 5))
    tally.charge = {camera: round(1 - spent, 4) for camera in CAMERAS[:2]}
    return tally
