"""Energy budgets: a share of slots, joules, watts, or a time to last until.

All of them become joules that a camera may spend in a slot on average, and from there the share of
slots that the deficit queues of `energy` keep: `max(q - E, 0) + s` with a price in joules.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.base.quantities import DURATIONS_S, ENERGIES_J, POWERS_W, SHARES, quantity

Kind = Literal["duty", "joules", "watts", "until", "together"]

FORM = "0.6 (share of slots), 60%, 0.3J (per slot), 4W, until 18:00, for 8h, or together"
UNTIL = re.compile(r"until\s+(\d{1,2}):(\d{2})")
LEAST_SHARE = 1e-3  # of slots: the queues of a camera that may spend nothing must still end
BISECTIONS = 60
FOREVER_S = 1e10  # three centuries


@dataclass(frozen=True, slots=True)
class Budget:
    """The energy that a camera may spend.

    Attributes:
        kind: what `value` means.
        value: share of slots; joules per slot; watts; seconds since 1970 to last until. Nothing for
            `together`: all batteries are to last equally long, and as long as possible.
    """

    kind: Kind
    value: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Supply:
    """The source of a camera's energy.

    Attributes:
        battery_j: what is left; infinite on mains.
        charging_w: power that goes in, such as from the sun, as it is expected to go on.
    """

    battery_j: float = np.inf
    charging_w: float = 0.0


def parse_budget(words: str, now: datetime) -> Budget:
    """Read a budget as people write it.

    Args:
        words: `0.6` or `60%` of the slots, `0.3J` or `300mJ` a slot, `4W`, `until 18:00` (the next
            one), `until 2026-11-21T18:00`, `for 8h`, `together`.
        now: the present, with its time zone.

    Raises:
        InputError: showing what was found and what can be written.
    """
    text = words.strip()
    if text.lower() == "together":
        return Budget("together")
    if text.lower().startswith("for "):
        return Budget("until", now.timestamp() + _read(words, text[4:], DURATIONS_S))
    if until := UNTIL.fullmatch(text.lower()):
        hour, minute = int(until[1]), int(until[2])
        if hour < 24 and minute < 60:
            moment = now.replace(hour=hour, minute=minute, second=0, microsecond=0)
            if moment <= now:
                moment += timedelta(days=1)
            return Budget("until", moment.timestamp())
    elif text.lower().startswith("until "):
        try:
            moment = datetime.fromisoformat(re.sub(r"[zZ]$", "+00:00", text[6:].strip()))
        except ValueError:
            raise _error(words) from None
        moment = moment if moment.tzinfo else moment.replace(tzinfo=now.tzinfo)
        if moment > now:
            return Budget("until", moment.timestamp())
        raise InputError("budget", f"{words[:60]!r}, which has passed", "a time to come")
    if text.endswith("J"):
        return Budget("joules", _read(words, text, ENERGIES_J))
    if text.endswith("W"):
        return Budget("watts", _read(words, text, POWERS_W))
    share = _read(words, text.replace("%", "percent"), SHARES)
    if share > 1:
        raise _error(words)
    return Budget("duty", share)


def _read(words: str, text: str, units: Mapping[str, float]) -> float:
    if "M" in text:  # a million of them is nothing a camera spends
        raise _error(words)
    try:
        return quantity(text, units, "")
    except InputError:
        raise _error(words) from None


def allowance_j(
    budgets: Sequence[Budget],
    supplies: Sequence[Supply],
    active_j: ArrayLike,
    idle_j: ArrayLike,
    interval_s: float,
    now_s: float,
    num_selected: float,
) -> Floats:
    """Return the mean energy that each camera may spend in a slot, idle slots included.

    Batteries run down and suns come out: ask again every minute.

    Args:
        budgets: `(num_cameras,)` what was asked for.
        supplies: `(num_cameras,)` what there is.
        active_j: `(num_cameras,)` cost of an active slot.
        idle_j: `(num_cameras,)` cost of an idle slot.
        interval_s: seconds per slot.
        now_s: seconds since 1970.
        num_selected: cameras that are to be active in a slot, which those that are to last
            `together` share among them; others count with the share that they are given.

    Returns:
        `(num_cameras,)` joules, from that of an idle slot to that of an active one.
    """
    active, idle = np.asarray(active_j, dtype=float), np.asarray(idle_j, dtype=float)
    wanted = np.array(
        [
            _wanted_j(budget, supply, float(a), float(i), interval_s, now_s)
            for budget, supply, a, i in zip(budgets, supplies, active, idle, strict=True)
        ]
    )
    together = np.array([budget.kind == "together" for budget in budgets])
    if together.any():
        rest = num_selected - _share(wanted, active, idle)[~together].sum()
        mine = [supply for supply, joins in zip(supplies, together, strict=True) if joins]
        shares, _ = common_lifetime(
            mine, active[together] / interval_s, idle[together] / interval_s, max(rest, 0.0)
        )
        wanted[together] = idle[together] + shares * (active - idle)[together]
    return np.asarray(np.clip(wanted, idle, np.maximum(active, idle)))


def slot_shares(allowance: Floats, active_j: ArrayLike, idle_j: ArrayLike) -> Floats:
    """Return the share of slots that an allowance pays for: the paper's E_n of the queues.

    Args:
        allowance: `(num_cameras,)` joules that a slot may cost on average.
        active_j: `(num_cameras,)` cost of an active slot.
        idle_j: `(num_cameras,)` cost of an idle slot.

    Returns:
        `(num_cameras,)` in (0, 1]: cameras that cannot afford any slot keep a thousandth.
    """
    active, idle = np.asarray(active_j, dtype=float), np.asarray(idle_j, dtype=float)
    return np.maximum(_share(allowance, active, idle), LEAST_SHARE)


def common_lifetime(
    supplies: Sequence[Supply], active_w: Floats, idle_w: Floats, num_selected: float
) -> tuple[Floats, float]:
    """Return the shares of slots with which batteries last longest, and how long that is.

    With `share_n(T)` the share that lets battery n last `T` seconds, more time means smaller
    shares: the longest common lifetime is the one whose shares add up to `num_selected`.

    Args:
        supplies: `(num_cameras,)` batteries.
        active_w: `(num_cameras,)` power when active.
        idle_w: `(num_cameras,)` power when idle.
        num_selected: cameras that are to be active in a slot, as a mean.

    Returns:
        `(num_cameras,)` shares in [0, 1], and seconds: `FOREVER_S` if the suns suffice.
    """
    battery_j = np.array([supply.battery_j for supply in supplies])
    charging_w = np.array([supply.charging_w for supply in supplies])
    extra_w = np.maximum(active_w - idle_w, 1e-9)

    def shares(seconds: float) -> Floats:
        affordable_w = battery_j / seconds + charging_w
        return np.asarray(np.clip((affordable_w - idle_w) / extra_w, 0.0, 1.0))

    wanted = min(num_selected, float(len(supplies)))
    low, high = 1.0, FOREVER_S
    if (total := shares(high).sum()) >= wanted:
        return shares(high) * (wanted / total if total > 0 else 1.0), high
    for _ in range(BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if shares(middle).sum() >= wanted else (low, middle)
    return shares(low), low


def _wanted_j(
    budget: Budget, supply: Supply, active: float, idle: float, interval_s: float, now_s: float
) -> float:
    """Return joules per slot that one camera's budget names, not yet limited to what slots cost."""
    if budget.kind == "duty":
        return idle + budget.value * (active - idle)
    if budget.kind == "joules":
        return budget.value
    if budget.kind == "watts":
        return budget.value * interval_s
    if budget.kind == "until":
        left_s = budget.value - now_s
        # Nothing is left to save for once the time has come.
        watts = supply.battery_j / left_s + supply.charging_w if left_s > 0 else np.inf
        return min(watts * interval_s, active)
    return idle  # `together` is for all at once


def _share(allowance: Floats, active: Floats, idle: Floats) -> Floats:
    extra = active - idle
    # A camera whose active slots cost nothing extra has nothing to save.
    share = np.where(extra > 0, (allowance - idle) / np.where(extra > 0, extra, 1.0), 1.0)
    return np.asarray(np.clip(share, 0.0, 1.0))


def _error(words: str) -> InputError:
    return InputError("budget", repr(words[:60]), FORM)
