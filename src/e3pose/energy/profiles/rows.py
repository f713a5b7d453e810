"""Rows of looks and rests in a power profile, checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from e3pose.energy.modes import LOOKS, RESTS, Look, Rest
from e3pose.energy.profiles.fields import check_keys, error, number, text

MAX_WATTS = 10_000.0
MAX_JOULES = 10_000.0
MAX_S = 3600.0
TIMES = ("enter_s", "wake_s", "wake_sd_s")
HAIR_W = 1e-6  # what sums of components differ by


def read_rests(table: Any, where: str, idle_w: float, off_w: float) -> tuple[Rest, ...]:
    """Return the rows of `[rests]`.

    Args:
        table: of the file; None where it has none.
        where: the file, for errors.
        idle_w: what its components draw in power-saving.
        off_w: likewise, in aggressive power-saving.

    Raises:
        InputError: naming the field that is wrong, or a deeper rest that draws more.
    """
    rests = []
    for name, row in _rows(table, "rests", RESTS, ("watts", *TIMES, "source"), where):
        rest_w = number(row["watts"], MAX_WATTS, where, f"rests.{name}.watts")
        enter_s, wake_s, sd_s = (number(row[k], MAX_S, where, f"rests.{name}.{k}") for k in TIMES)
        source = text(row["source"], where, f"rests.{name}.source")
        rests.append(Rest(name, rest_w, enter_s, wake_s, sd_s, source))
    watts = {"idle": idle_w, "not-capturing": off_w, **{rest.name: rest.watts for rest in rests}}
    above_w = idle_w
    for name in (name for name in RESTS if name in watts):
        if watts[name] > above_w + HAIR_W:
            found, most = f"{watts[name]:g} W", f"at most {above_w:g} W, of the lighter rests"
            raise error(where, f"rests.{name}.watts", found, most)
        above_w = watts[name]
    return tuple(rests)


def read_looks(table: Any, where: str) -> tuple[Look, ...]:
    """Return the rows of `[looks]`, none where the file has no such table; see `read_rests`."""
    return tuple(
        Look(
            name,
            number(row["joules"], MAX_JOULES, where, f"looks.{name}.joules"),
            number(row["latency_s"], MAX_S, where, f"looks.{name}.latency_s"),
            text(row["source"], where, f"looks.{name}.source"),
        )
        for name, row in _rows(table, "looks", LOOKS[:-1], ("joules", "latency_s", "source"), where)
    )


def _rows(
    table: Any, kind: str, names: tuple[str, ...], keys: tuple[str, ...], where: str
) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the rows of a table in the order of `names`, each with all keys and no other."""
    if table is None:
        return []
    if not isinstance(table, dict):
        raise error(where, kind, table, "a table")
    for name, row in table.items():
        field = f"{kind}.{str(name)[:40]}"
        if name not in names:
            raise error(where, field, "an unknown row", f"one of {', '.join(names)}")
        if not isinstance(row, dict):
            raise error(where, field, row, "a table")
        check_keys(row, keys, where, f"{field}.")
    return [(name, table[name]) for name in names if name in table]
