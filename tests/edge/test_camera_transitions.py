"""Cameras go through their states as the table says, whatever happens to them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from e3pose.base.arrays import Integers
from e3pose.edge import camera_state as cameras
from e3pose.edge.camera_state import LEAST_RELIABLE, TRANSITIONS, Answers, CameraState, State
from e3pose.edge.checkpoint import flatten, rebuild
from e3pose.select.failure_detector import RETRY_LIMIT_S, Silence, acknowledge_late, listen
from e3pose.wire.messages import Activity, Heartbeat, Hello

PAGE = Path(__file__).parents[2] / "docs/explanation/live.md"
NUM, INTERVAL_S, S = 4, 0.04, 10**9
LAST, JOINTS = NUM - 1, ("nose", "hip")
CAMERAS = st.integers(0, LAST)
ANSWERS, LATE, LOST, LATE_ORDER = OUTCOMES = ("answers", "late", "lost", "late order")


class Walk(RuleBasedStateMachine):
    """Four cameras of an edge, and all that may happen to them."""

    def __init__(self) -> None:
        super().__init__()
        self.cameras = [CameraState.unheard(f"c{index}", 0.5) for index in range(NUM)]
        self.answers, self.silence = Answers.none(NUM), Silence.none(NUM)
        self.slot, self.now_ns = 0, S
        self.paused, self.happened = set[int](), set[str]()

    def standings(self) -> Integers:
        """Return the states by messages alone."""
        found = [
            cameras.standing(camera, JOINTS, (640, 480), self.now_ns)[0] for camera in self.cameras
        ]
        return np.array([State.BARRED if i in self.paused else s for i, s in enumerate(found)])

    def states(self) -> Integers:
        return cameras.states_of(self.standings(), self.answers, self.silence.answering(self.slot))

    def enough(self) -> bool:
        """Return whether so many cameras answer enough orders that others need not be used."""
        there = self.standings() == State.READY
        return int((self.answers.reliable & there).sum()) >= LEAST_RELIABLE

    def follow(self, change: Callable[[], object], event: str = "") -> None:
        """Let something happen; each camera's change of state must stand in the table."""
        before, enough = self.states(), self.enough()
        change()
        states, standings = self.states(), self.standings()
        for camera, (was, now) in enumerate(zip(before, states, strict=True)):
            names = {State.LEFT: "left", State.ASLEEP: "asleep"}
            by_message = "barred" if was > State.BARRED else "seen"
            name = event or names.get(State(standings[camera]), by_message)
            there = min(was, now) > State.BARRED
            if there and enough != self.enough() and not self.answers.reliable[camera]:
                name = "spared" if self.enough() else "needed"
            elif event == "slot":
                name = self.events[camera] if now >= was else "ordered"
            possible, into, _ = TRANSITIONS[name]
            if was != now:
                assert was in possible and now in into, (name, State(was), State(now))
                self.happened.add(name)

    def change(self, camera: int, change: Callable[..., CameraState], *more: object) -> None:
        def apply() -> None:
            self.cameras[camera] = change(self.cameras[camera], *more)

        self.follow(apply)

    @initialize()
    def begin(self) -> None:
        for camera in range(NUM):
            self.hello(camera)
        self.all_speak()

    @rule(camera=CAMERAS, there=st.booleans())
    def connect(self, camera: int, there: bool) -> None:
        self.change(camera, cameras.with_presence, there, self.now_ns)

    @rule(camera=CAMERAS, session=st.integers(1, 3), fits=st.booleans())
    def hello(self, camera: int, session: int = 1, fits: bool = True) -> None:
        joints = JOINTS if fits else JOINTS[:1]
        hello = Hello(f"c{camera}", session, joints, (640, 480), 25.0, rests=("asleep",))
        self.change(camera, cameras.with_hello, hello, self.now_ns)

    @rule(
        camera=CAMERAS,
        mode=st.sampled_from(["active", "power-saving", "asleep", "suspended"]),
        problem=st.sampled_from(["", "", "no frames from the source"]),
        ends=st.sampled_from([False, False, True]),
    )
    def beat(self, camera: int, mode: Activity, problem: str = "", ends: bool = False) -> None:
        hello, now_ns = self.cameras[camera].hello, self.now_ns
        beat = Heartbeat(
            f"c{camera}", hello.session if hello else 1, now_ns, mode,
            captured=now_ns, problem=problem, ends=ends,
        )  # fmt: skip
        self.change(camera, cameras.with_heartbeat, beat, now_ns)

    @rule()
    def all_speak(self) -> None:
        for camera in range(NUM):
            self.beat(camera, "active")

    @rule(camera=CAMERAS)
    def nonsense(self, camera: int) -> None:
        for _ in range(cameras.WRONG_LIMIT):
            self.change(camera, cameras.with_invalid_message, "found 18 joints", self.now_ns)

    @rule(camera=CAMERAS, seconds=st.integers(1, 60))
    def order_to_sleep(self, camera: int, seconds: int) -> None:
        due_ns = self.now_ns + seconds * S
        self.change(camera, cameras.with_order_to_sleep, due_ns // S, due_ns)

    @rule(seconds=st.sampled_from([0.1, 1.0, 2.0, 6.0, 30.0]))
    def wait(self, seconds: float) -> None:
        self.follow(lambda: setattr(self, "now_ns", self.now_ns + round(seconds * S)))

    @rule(camera=CAMERAS, paused=st.booleans())
    def pause(self, camera: int, paused: bool) -> None:
        change = self.paused.add if paused else self.paused.discard
        self.follow(lambda: change(camera))

    @rule()
    def forgive(self) -> None:
        def apply() -> None:
            self.silence, self.answers = Silence.none(NUM), self.answers.forgiven()

        self.follow(apply, "forgiven")

    @rule(
        outcomes=st.tuples(*[st.sampled_from(OUTCOMES)] * NUM),
        slots=st.sampled_from([1, 10, 100, 300]),
    )
    def slots(self, outcomes: tuple[str, ...], slots: int) -> None:
        for _ in range(slots):
            self.follow(lambda: self.close_slot(np.array(outcomes)), "slot")

    def close_slot(self, said: np.ndarray) -> None:
        """Compute a slot as the edge does, in which all cameras that count were selected."""
        states = self.states()
        there = states >= State.ON_TRIAL
        trial = cameras.tried(self.answers, states, self.slot, INTERVAL_S)
        ordered = (states == State.READY) | trial
        arrived, late = ordered & (said == ANSWERS), there & (said == LATE)
        turn = cameras.Turn(
            states=states,
            ordered=ordered,
            ages_s=np.where(arrived, 0.02, np.nan),
            views=self.answers.views + arrived + late,
            late=self.answers.late + late,
            views_late=late,
            orders_late=cameras.excused(self.answers, there & (said == LATE_ORDER)),
        )
        assert (turn.usable <= (arrived | (states >= State.SUSPECTED))).all()
        assert not (ordered & ~there).any(), "a camera that left or sleeps is never ordered"
        assert trial.sum() <= 1
        silence = acknowledge_late(self.silence, late, turn.orders_late, INTERVAL_S)
        self.silence = listen(silence, self.slot, ordered & turn.usable, arrived, INTERVAL_S)
        self.answers = cameras.after_slot(self.answers, turn, self.silence.failures > 0, INTERVAL_S)
        self.slot += 1
        assert not self.silence.failures[arrived].any(), "an answer clears suspicion"
        lives = late | turn.orders_late
        self.events = np.where(arrived, "answered", np.where(lives, "late", "tried"))

    @invariant()
    def one_state_each_and_never_all_left_out(self) -> None:
        states, standings, silence = self.states(), self.standings(), self.silence
        assert {*states.tolist()} <= {*State} and len(states) == NUM
        assert ((states > State.BARRED) == (standings == State.READY)).all()
        there = [one.present or index in self.paused for index, one in enumerate(self.cameras)]
        assert (standings[~np.array(there)] <= State.ASLEEP).all()
        on_trial = (states == State.ON_TRIAL).any()
        assert not on_trial or (states > State.ON_TRIAL).sum() >= LEAST_RELIABLE
        later = self.slot + round(RETRY_LIMIT_S / INTERVAL_S) + 1
        assert silence.answering(later).all(), "suspicion ends by itself"
        saved = rebuild(Silence.none(NUM), flatten(silence), "file")
        assert (saved.answering(self.slot) == silence.answering(self.slot)).all()


TestWalk = Walk.TestCase
TestWalk.settings = settings(max_examples=20, stateful_step_count=25, deadline=None)


def test_every_event_of_the_table_happens() -> None:
    site = Walk()
    site.begin()

    def slots(count: int, outcome: str) -> State:
        site.slots((*[ANSWERS] * LAST, outcome), count)
        return State(site.states()[LAST])

    def lose_most() -> None:
        for _ in range(60):
            slots(3, LOST)
            slots(1, ANSWERS)
        assert site.states()[LAST] == State.ON_TRIAL

    assert slots(12, LOST) == State.SUSPECTED and slots(1, LATE) == State.READY
    assert slots(12, LOST) == State.SUSPECTED and slots(40, ANSWERS) == State.READY
    lose_most()
    for paused, state in ((True, State.READY), (False, State.ON_TRIAL)):
        for camera in range(LAST - 1):
            site.pause(camera, paused)
        assert site.states()[LAST] == state
    assert slots(round(50 / INTERVAL_S), ANSWERS) == State.READY
    lose_most()
    site.forgive()
    site.order_to_sleep(LAST, 30)
    site.beat(LAST, "asleep")
    assert site.states()[LAST] == State.ASLEEP
    site.wait(60.0)
    assert (site.states() == State.LEFT).all() and site.happened == {*TRANSITIONS}


def test_page_has_the_table() -> None:
    """`python -m tests.edge.test_camera_transitions` prints it."""
    assert table() in PAGE.read_text()


def table() -> str:
    """Return the states and what happens between them, for the page."""

    def names(states: tuple[State, ...]) -> str:
        return ", ".join(f"`{state.name.lower().replace('_', '-')}`" for state in states)

    rows = ["| state | a camera that |", "|---|---|"]
    rows += [f"| {names((state,))} | {cameras.MEANINGS[state]} |" for state in State]
    rows += ["", "| event | from | to | when |", "|---|---|---|---|"]
    rows += [
        f"| *{event}* | {names(before)} | {names(after)} | {when} |"
        for event, (before, after, when) in TRANSITIONS.items()
    ]
    return "\n".join(rows)


if __name__ == "__main__":
    print(table())
