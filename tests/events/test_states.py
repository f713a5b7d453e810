"""States: right for simulated bodies of all statures, unknown where a pose tells too little."""

from __future__ import annotations

import numpy as np
from tests.cases import each_case
from tests.events.bodies import FPS, START_S, doing, seen
from tests.events.test_rules import BED

from e3pose.base.arrays import Floats
from e3pose.events.states import STATES, UNKNOWN
from e3pose.events.watch import advance, begin_watch
from e3pose.model.skeleton import COCO17
from e3pose.settings.events_table import EventsTable


def states(joints_m: Floats, sigma_m: float = 0.02) -> Floats:
    """Return `(num_slots, num_states)`."""
    watch, found = begin_watch(EventsTable(), COCO17.joints), []
    for slot in seen(joints_m, sigma_m):
        watch, _ = advance(watch, slot)
        found.append(watch.shown[1].states)
    return np.array(found)


@each_case(
    ("kind", "state"),
    [
        ("fall-forward", "lying"), ("fall-backward", "lying"), ("fall-left", "lying"),
        ("sit-hard", "sitting"), ("sit-on-floor", "sitting"), ("kneel", "crouching"),
        ("squat", "crouching"), ("pick-up", "bending"), ("lie-on-floor", "lying"),
    ],
)  # fmt: skip
def test_what_a_body_does_is_told(kind: str, state: str) -> None:
    # Three seconds before it gets up: the last posture has been held for as long.
    joints_m = doing(kind, 0)
    moved = np.linalg.norm(np.diff(joints_m[:, 11], axis=0), axis=-1)
    still = [
        n for n in range(int(START_S * FPS), len(joints_m) - 25) if (moved[n : n + 25] < 0.01).all()
    ]
    assert still
    told = states(joints_m)
    assert STATES[int(told[5].argmax())] == "standing"
    assert STATES[int(told[still[0] + 24].argmax())] == state
    assert STATES[int(told[-1].argmax())] == "standing"


def test_somebody_on_a_bed_lies_and_is_not_on_the_floor() -> None:
    joints_m = doing("lie-on-bed", 1)
    watch = begin_watch(EventsTable(), COCO17.joints, (BED,))
    lay, floor = 0.0, 0.0
    for slot in seen(joints_m):
        watch, _ = advance(watch, slot)
        person = watch.shown[1]
        lay, floor = max(lay, person.lies), max(floor, person.on_floor)
    assert lay > 0.9 and floor < 0.5


def test_few_or_uncertain_joints_make_a_state_unknown_not_wrong() -> None:
    joints_m = doing("fall-forward", 0)
    hidden = joints_m.copy()
    hidden[:, 5:] = np.nan  # the head alone
    assert (states(hidden).argmax(axis=1) == UNKNOWN).mean() > 0.9
    # A metre of error: nothing is certain.
    told = states(joints_m, 1.0)
    assert (told.argmax(axis=1) == UNKNOWN).mean() > 0.9


PARTS = {
    "hips": ("hip",),
    "legs": ("knee", "ankle"),
    "all below the shoulders": ("hip", "knee", "ankle", "elbow", "wrist"),
    "all above the hips": ("nose", "eye", "ear", "shoulder", "elbow", "wrist"),
    "hips and shoulders": ("hip", "shoulder"),
    "the left": ("left",),
}
SURE = 0.8


@each_case("kind", ["squat", "fall-backward"])
def test_missing_joints_make_a_state_uncertain_never_wrong(kind: str) -> None:
    joints_m = doing(kind, 0, seconds=14.0)
    whole = states(joints_m)
    same = whole.argmax(axis=1)
    lasts = np.array([(same[max(n - 12, 0) : n + 13] == same[n]).all() for n in range(len(same))])
    lasts &= whole.max(axis=1) > SURE
    assert lasts.sum() > 60
    for hidden, words in PARTS.items():
        part_m = joints_m.copy()
        part_m[:, [any(word in joint for word in words) for joint in COCO17.joints]] = np.nan
        part = states(part_m)
        told = part.argmax(axis=1)
        wrong = lasts & (part.max(axis=1) > SURE) & (told != same) & (told != UNKNOWN)
        assert not wrong.any(), (hidden, STATES[int(told[wrong][0])])


def test_children_and_giants_stand() -> None:
    joints_m = doing("kneel", 2)
    for factor in (0.6, 1.15):
        told = states(factor * joints_m)
        assert STATES[int(told[30].argmax())] == "standing"
