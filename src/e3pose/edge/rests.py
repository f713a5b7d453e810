"""Cameras asleep by order: until when, and how long each takes to wake.

A camera asleep says nothing, and is no dead one: it is expected back when its order for the slot
after its sleep is made. When it comes instead says how long it takes to wake, a distribution that
is learned; its next alarm is set earlier by mean and two standard deviations.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from e3pose.base.arrays import Flags, Integers
from e3pose.base.clock import SlotTimes
from e3pose.edge.roster import SILENT_S, CameraState
from e3pose.energy.rest_costs import alarm_s
from e3pose.wire.messages import RESTING, Heartbeat
from e3pose.wire.site_messages import CameraStatus

ASLEEP = "asleep"  # begins what is said of a camera that is expected back
# Of the stated time to wake, its spread before the first wake: with less a slow board is late for
# its first order, with more a quick one idles for longer before it. Twenty wakes later it is gone.
PRIOR_SHARE = 0.5
# Wakes that the mean remembers: of fewer one odd wake moves every alarm, with more a board that
# grew slow in the heat is late for as many orders.
MEMORY_WAKES = 20
LONGEST_WAKE_S = 60.0  # a camera that comes later was away for other reasons
OVERSLEPT_S = 1.0  # late by so much is told


@dataclass(frozen=True, slots=True)
class WakeTime:
    """What a camera takes from its alarm until it is heard; a value.

    Attributes:
        mean_s: mean.
        sd_s: standard deviation.
        wakes: that were measured.
    """

    mean_s: float
    sd_s: float
    wakes: int = 0

    @classmethod
    def stated(cls, wake_s: float) -> WakeTime:
        """Return what is stated of a camera that never woke."""
        return cls(wake_s, PRIOR_SHARE * wake_s)

    @property
    def early_s(self) -> float:
        """How long before it is needed an alarm is set."""
        return min(alarm_s(self.mean_s, self.sd_s), LONGEST_WAKE_S)

    def after(self, took_s: float) -> WakeTime:
        """Return it after one more wake; what was stated counts as one."""
        took_s = min(max(took_s, 0.0), LONGEST_WAKE_S)
        weight = 1 / min(self.wakes + 2, MEMORY_WAKES)
        off_s = took_s - self.mean_s
        variance = (1 - weight) * (self.sd_s**2 + weight * off_s**2)
        return WakeTime(self.mean_s + weight * off_s, variance**0.5, self.wakes + 1)


@dataclass(frozen=True, slots=True)
class Rest:
    """A sleep that a camera was told to take; a value.

    Attributes:
        until: the slot from which it is to be awake; 0 for none.
        due_ns: when it is expected to be heard, edge time.
        early_s: how much earlier its alarm was set.
        began: whether it said that it sleeps.
        session: of the program that said so.
    """

    until: int = 0
    due_ns: int = 0
    early_s: float = 0.0
    began: bool = False
    session: int = 0


class Rests:
    """The sleep of all cameras; every method may be called on any thread.

    Attributes:
        wakes: `(num_cameras,)` what each takes to wake; replaced whole.
    """

    def __init__(self, wakes_s: Sequence[float]) -> None:
        """Start with all cameras awake.

        Args:
            wakes_s: `(num_cameras,)` stated times to wake.
        """
        self._stated_s = tuple(wakes_s)
        self.wakes = tuple(WakeTime.stated(wake_s) for wake_s in wakes_s)
        self._rests = (Rest(),) * len(self.wakes)
        self._said = deque[tuple[int, str]](maxlen=100)
        self._lock = threading.Lock()

    def order(
        self, times: SlotTimes, asleep_until: Integers, slot: int, lead: int, can: Flags
    ) -> Integers:
        """Return until when cameras are told to sleep by the orders of a slot.

        Args:
            times: of the slots.
            asleep_until: `(num_cameras,)` what was decided; at most `slot` to be awake.
            slot: of the orders.
            lead: slots from the one that orders are made from to theirs.
            can: `(num_cameras,)` cameras that can sleep.
        """
        until = np.where(can & (asleep_until > slot), asleep_until, 0)
        if not until.any():
            return until
        with self._lock:
            self._rests = tuple(
                self._ordered(camera, rest, slept, times.begin_ns(slept - lead))
                for camera, (rest, slept) in enumerate(
                    zip(self._rests, until.tolist(), strict=True)
                )
            )
        return until

    def _ordered(self, camera: int, rest: Rest, until: int, due_ns: int) -> Rest:
        """Return the rest of a camera after an order; one cut short may not have been heard."""
        if not until or (until, due_ns) == (rest.until, rest.due_ns):
            return rest
        return replace(rest, until=until, due_ns=due_ns, early_s=self.wakes[camera].early_s)

    def resume(self, times: SlotTimes, asleep_until: Integers, slot: int) -> None:
        """Expect those back who were asleep when an edge before was killed; see `order`."""
        everybody = np.ones(len(self.wakes), dtype=bool)
        self.order(times, asleep_until, slot, 1, everybody)

    def early_s(self, camera: int) -> float:
        """Return how long before it is needed a camera sets its alarm."""
        rest = self._rests[camera]
        return rest.early_s if rest.until else self.wakes[camera].early_s

    def heard(self, camera: int, camera_id: str, beat: Heartbeat, now_ns: int) -> None:
        """Learn from a heartbeat: a camera falls asleep, or is back."""
        with self._lock:
            rest = self._rests[camera]
            if not rest.until:
                return
            late_s = (now_ns - rest.due_ns) / 1e9
            if beat.mode in RESTING:
                rest = replace(rest, began=True, session=beat.session)
            elif rest.began and beat.session != rest.session:
                rest = Rest()  # its program was restarted: nothing of a wake
            elif rest.began:
                self._woken(camera, camera_id, rest.early_s, late_s)
                rest = Rest()
            elif late_s > 0:  # it is over, and was never begun as far as is known
                self._forget(camera, rest.early_s)
                rest = Rest()
            self._rests = (*self._rests[:camera], rest, *self._rests[camera + 1 :])

    def _woken(self, camera: int, camera_id: str, early_s: float, late_s: float) -> None:
        if -early_s < late_s < LONGEST_WAKE_S:  # before its alarm it was called, or started again
            self._believe(camera, self.wakes[camera].after(late_s + early_s))
        if late_s > OVERSLEPT_S:
            early_s = self.wakes[camera].early_s
            line = f"{camera_id} overslept by {late_s:.1f} s, woken {early_s:.1f} s early from now"
            self._said.append((camera, line))

    def _believe(self, camera: int, wake: WakeTime) -> None:
        self.wakes = (*self.wakes[:camera], wake, *self.wakes[camera + 1 :])

    def _forget(self, camera: int, early_s: float) -> None:
        """Forget half of a long time to wake: who is woken before it sleeps shows no other."""
        stated, wake = WakeTime.stated(self._stated_s[camera]), self.wakes[camera]
        if early_s > stated.early_s:
            mean_s, sd_s = (wake.mean_s + stated.mean_s) / 2, (wake.sd_s + stated.sd_s) / 2
            self._believe(camera, replace(wake, mean_s=mean_s, sd_s=sd_s))

    def excuse(self) -> None:
        """Learn nothing of the wakes to come: the edge itself was away, or behind."""
        with self._lock:
            self._rests = tuple(replace(rest, began=False) for rest in self._rests)

    def said(self) -> list[tuple[int, str]]:
        """Return what happened since the last call: cameras, and lines for operators."""
        return [self._said.popleft() for _ in range(len(self._said))]

    def left_s(self, camera: int, state: CameraState, now_ns: int) -> float | None:
        """Return seconds until a camera is expected back; negative if it is late, None if awake.

        One that was told to sleep and still speaks is awake.
        """
        rest, heard_ns, beat = self._rests[camera], state.heard_ns, state.beat
        if not rest.until:
            return None
        silent = heard_ns is None or now_ns - heard_ns > SILENT_S * 1e9 or not state.present
        resting = beat is None or beat.mode in RESTING
        return (rest.due_ns - now_ns) / 1e9 if silent or resting else None

    def words(self, camera: int, state: CameraState, now_ns: int) -> str:
        """Return why a camera cannot be selected because of its sleep; empty if it is awake."""
        left_s, beat = self.left_s(camera, state, now_ns), state.beat
        if left_s is None or (beat is not None and beat.ends):
            return ""
        if beat is not None and beat.mode == "asleep" and not state.present:
            return ""  # its program was to stay connected
        if left_s > -SILENT_S:
            return f"{ASLEEP} for {max(left_s, 0.0):.0f} s"
        return f"overslept by {-left_s:.0f} s"


def sleeps_as_told(camera: CameraStatus) -> bool:
    """Return whether a camera of a status sleeps by order and is not late."""
    asleep = not camera.online and not camera.paused and camera.asleep_s is not None
    return asleep and (camera.asleep_s or 0.0) > -SILENT_S
