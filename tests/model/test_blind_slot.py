"""Why a slot is blind, and how blind slots count."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from tests.cases import each_case

from e3pose.edge.counters import Counts
from e3pose.model.blind_slot import (
    CAUSES,
    WORDS,
    blind_cause,
    blind_words,
    count_blind,
    duty,
    no_choice,
)
from e3pose.model.people import People
from e3pose.model.slot_record import SlotRecord

NONE, FIRST, ALL = (np.array(flags) for flags in ([False] * 3, [True, False, False], [True] * 3))


def record(slot: int, selected: Sequence[bool] = (False,) * 3, blind: str = "") -> SlotRecord:
    flags, nothing = np.array(selected), np.zeros(3)
    people = People.empty(17)
    return SlotRecord(slot, slot / 25, flags, flags, people, nothing, nothing, flags, blind=blind)


@each_case(
    ("cause", "decided", "online", "other"),
    [
        ("", NONE, ALL, {}),  # the policy chose nobody
        ("orders-late", FIRST, ALL, {"in_time": False}),
        ("", NONE, ALL, {"in_time": False}),  # late orders to rest
        ("views-missing", FIRST, ALL, {}),
        ("views-late", FIRST, ALL, {"views_late": FIRST}),
        ("views-missing", FIRST, ALL, {"views_late": ~FIRST}),  # another camera's are late
        ("orders-late", FIRST, ALL, {"orders_late": FIRST}),
        ("views-late", ALL, ALL, {"orders_late": FIRST, "views_late": ~FIRST}),
        ("cameras-offline", FIRST, ~FIRST, {}),
        ("cameras-offline", ALL, NONE, {}),
        ("cameras-offline", NONE, NONE, {}),
        ("cameras-offline", ALL, NONE, {"in_time": False}),
        ("cameras-offline", NONE, ALL, {"no_choice": "cameras-offline"}),  # back since then
        ("views-late", NONE, ALL, {"no_choice": "views-late"}),  # all were given up
    ],
)
def test_slot_without_a_view_has_its_cause(
    cause: str, decided: Any, online: Any, other: dict[str, Any]
) -> None:
    assert blind_cause(decided, online, False, **other) == cause
    assert blind_cause(decided, online, True, **other) == ""


def test_policy_without_a_choice_makes_blind_slots_later() -> None:
    assert no_choice(ALL, FIRST, ALL) == ""
    assert no_choice(NONE, ALL, NONE) == "cameras-offline"
    assert no_choice(FIRST, ~FIRST, FIRST) == "views-late"
    assert no_choice(FIRST, ~FIRST, ~FIRST) == "views-missing"


def test_duty_leaves_blind_slots_out() -> None:
    seen = record(0, selected=[True, True, False])
    blind = [record(1, blind="orders-late"), record(2, blind="orders-late")]
    rest = record(3)
    assert duty([seen, *blind, rest], 3).tolist() == [0.5, 0.5, 0.0]
    assert duty(blind, 3).tolist() == [0.0, 0.0, 0.0]
    assert duty([], 3).tolist() == [0.0, 0.0, 0.0]


def test_counters_of_an_edge_leave_blind_slots_out_of_the_duty() -> None:
    counts, nobody = Counts(3, 1.0), np.zeros(3, dtype=bool)
    blind = record(1, blind="orders-late")
    for each in (record(0, [True, True, False]), blind, blind, record(3)):
        counts.count_slot(0, nobody, each, 1, 1)
    assert counts.duty().tolist() == [0.5, 0.5, 0.0]
    assert counts.blind == {"orders-late": 2} and counts.blind_share() == 0.5
    for slot in range(4, 64):  # they leave the last minute, not the count
        counts.count_slot(0, nobody, record(slot, [False, False, True]), 1, 1)
    assert counts.duty().tolist() == [0.0, 0.0, 1.0]
    assert counts.blind == {"orders-late": 2} and counts.blind_share() == 0.0


def test_blind_slots_are_counted_by_cause_and_told_in_words() -> None:
    records = [record(n, blind=b) for n, b in enumerate(["views-late", "", "orders-late"] * 2)]
    counts = count_blind(records)
    assert counts == {"orders-late": 2, "views-late": 2}
    assert blind_words(counts) == "2 orders late, 2 views late"
    assert blind_words({"of-a-newer-edge": 1}) == "1 of-a-newer-edge"
    assert set(WORDS) == set(CAUSES)
