"""The energy ledger of an edge: heartbeats in on one thread, budgets out on another."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from e3pose.base.quantities import plural
from e3pose.energy.budgets import Budget
from e3pose.energy.modes import CameraModes, RestName
from e3pose.energy.profiles import DeviceProfile, Mode, modes_of
from e3pose.energy.saving import Saving, saving
from e3pose.energy.site_energy import (
    CameraEnergy,
    EnergyEstimate,
    estimate_energy,
    new_camera,
    observe,
)
from e3pose.store.rows import RECORDING, EnergyReading

if TYPE_CHECKING:
    from e3pose.wire.messages import Heartbeat

UPDATE_S = 60.0
MEASURED = 0.95  # of the joules: the first minutes of a meter teach what a slot costs
RESTING: dict[str, RestName] = {"asleep": "asleep", "suspended": "suspended"}


class EnergyLedger:
    """The energy of every camera; `take` and `estimate` may be called on any thread."""

    def __init__(
        self,
        camera_ids: Sequence[str],
        profiles: Sequence[DeviceProfile],
        idle_modes: Sequence[Mode],
        budgets: Sequence[Budget],
        interval_s: float,
        num_selected: float,
        now_ns: Callable[[], int],
        keep: Callable[[EnergyReading], Any] | None = None,
        capacities_j: Sequence[float] = (),
    ) -> None:
        """Start from the power profiles.

        Args:
            camera_ids: `(num_cameras,)` of the rig.
            profiles: `(num_cameras,)` assumed power until it is measured.
            idle_modes: `(num_cameras,)` what each does in slots without an order.
            budgets: `(num_cameras,)` what each may spend.
            interval_s: seconds per slot.
            num_selected: cameras that are to be active in a slot.
            now_ns: nanoseconds since 1970.
            keep: called with meter readings, such as `StoreWriter.energy`.
            capacities_j: `(num_cameras,)` of their batteries, infinite where unknown; by default
                all are.
        """
        self._index = {camera_id: index for index, camera_id in enumerate(camera_ids)}
        self._cameras: list[CameraEnergy] = [
            new_camera(profile, mode, capacity_j)
            for profile, mode, capacity_j in zip(
                profiles, idle_modes, capacities_j or [np.inf] * len(profiles), strict=True
            )
        ]
        self._profiles, self._resting_w = tuple(profiles), np.full(len(profiles), np.nan)
        self._budgets, self._interval_s = tuple(budgets), interval_s
        self._num_selected, self._now_ns, self._keep = num_selected, now_ns, keep
        self._lock = threading.Lock()
        # Joules of all cameras so far: spent, had all been active, and the part that was learned.
        self._sums_j = np.zeros(3)
        self._estimate: EnergyEstimate | None = None  # before the first is asked for
        self._last: EnergyEstimate | None = None
        self._estimated_ns: int | None = None  # when it is to be made anew

    @cached_property
    def _modes(self) -> list[CameraModes]:
        """The modes of each camera and their costs."""
        return [modes_of(profile, self._interval_s) for profile in self._profiles]

    @cached_property
    def _gate_j(self) -> NDArray[np.float64]:
        """`(num_cameras,)` of a look at an image that is unchanged."""
        gates = [modes.look("gate") for modes in self._modes]
        return np.array([0.0 if gate is None else gate.joules for gate in gates])

    def take(self, beat: Heartbeat) -> None:
        """Add a heartbeat; heartbeats of cameras outside the rig are ignored."""
        index = self._index.get(beat.camera_id)
        if index is None:
            return
        resting = RESTING.get(beat.mode)
        rest = None if resting is None else self._modes[index].rest(resting)
        resting_w = self._resting_w.copy()  # replaced whole, as another thread reads it
        resting_w[index] = np.nan if rest is None else rest.watts
        with self._lock:
            self._resting_w = resting_w
            before = self._cameras[index].beat
            self._cameras[index] = observe(self._cameras[index], beat)
        if self._keep is None or before is None or before.session != beat.session:
            return
        span_s = (beat.sent_edge_ns - before.sent_edge_ns) / 1e9
        if beat.energy_j is not None and before.energy_j is not None and span_s > 0:
            source = "measured" if beat.measured else "modelled"
            spent_j = max(beat.energy_j - before.energy_j, 0.0)
            video_j = min(max(beat.recording_j - before.recording_j, 0.0), spent_j)
            rest_j = spent_j - video_j
            self._keep(EnergyReading(beat.sent_edge_ns, beat.camera_id, rest_j, span_s, source))
            if video_j > 0:  # rows differ in their time
                end_ns = beat.sent_edge_ns + 1
                self._keep(EnergyReading(end_ns, beat.camera_id, video_j, span_s, RECORDING))

    def change(self, budgets: Sequence[Budget], num_selected: float) -> None:
        """Use other budgets from the next slot on.

        Args:
            budgets: `(num_cameras,)` what each may spend.
            num_selected: cameras that are to be active in a slot.
        """
        with self._lock:
            self._budgets, self._num_selected = tuple(budgets), num_selected
            self._estimated_ns = None

    def estimate(self) -> tuple[EnergyEstimate, bool]:
        """Return budgets and costs, recomputed once a minute, and whether they are new."""
        now_ns = self._now_ns()
        with self._lock:  # `change` resets the time, on another thread
            known, made_ns = self._estimate, self._estimated_ns
            if known is not None and made_ns is not None and now_ns - made_ns < UPDATE_S * 1e9:
                return known, False
            self._estimate, self._estimated_ns = self._estimated(), now_ns
            return self._estimate, True

    def updated(self) -> tuple[EnergyEstimate | None, list[tuple[str | None, str]]]:
        """Return budgets and costs, if they are new; call it between slots.

        Also returns messages for operators, each with its camera: costs measured for the first
        time, or no longer; budgets that are too small.
        """
        estimate, new = self.estimate()
        if not new:
            return None, []
        last, self._last = self._last, estimate
        return estimate, self._events(last, estimate)

    def _events(
        self, last: EnergyEstimate | None, now: EnergyEstimate
    ) -> list[tuple[str | None, str]]:
        events: list[tuple[str | None, str]] = []
        for index, camera_id in enumerate(self._index):
            cost = now.slots[index]
            if cost.measured != (last is not None and last.slots[index].measured):
                costs = f"{cost.active_j:.3g} J per active slot, {cost.idle_j:.3g} J per idle slot"
                events.append((camera_id, f"{costs} ({cost.why})"))
            if now.starved[index] and not (last is not None and last.starved[index]):
                idle_w = f"{cost.idle_j / self._interval_s:.3g} W"
                said = f"budget below its idle power of {idle_w}, selected almost never"
                events.append((camera_id, said))
        before = self._num_selected if last is None else last.num_selected
        asked = self._num_selected
        if (now.num_selected < asked) != (before < asked):
            events.append(
                (
                    None,
                    f"budgets allow {plural(round(now.num_selected, 2), 'camera')} per slot"
                    + (f", {asked:g} requested" if now.num_selected < asked else ""),
                )
            )
        return events

    def saving(self) -> Saving | None:
        """Return the saving of whole cameras so far; None before the first slot."""
        spent_j, always_j, learned_j = self._sums_j.tolist()
        return saving(spent_j, always_j, learned_j >= MEASURED * spent_j)

    def charge(
        self,
        selected: NDArray[np.bool_],
        unchanged: NDArray[np.bool_] | None = None,
        blind: bool = False,
    ) -> NDArray[np.float64]:
        """Return `(num_cameras,)` joules charged for a slot with this selection, and add them up.

        Sleeping cameras are charged the sleep power of their profile. A camera whose image was
        unchanged is charged an idle slot, and the gate's joules if its profile states them.

        Args:
            selected: `(num_cameras,)` who was ordered to look.
            unchanged: `(num_cameras,)` whose view says that the network did not run; None: nobody.
            blind: whether no view arrived although one was due: the slot saves nothing.
        """
        resting_j = self._resting_w * self._interval_s
        estimate = self._estimate or self._estimated()
        spent_j = estimate.spent_j(selected)
        if unchanged is not None and unchanged.any():
            gated_j = estimate.spent_j(np.zeros_like(selected)) + self._gate_j
            spent_j = np.where(selected & unchanged, np.minimum(gated_j, spent_j), spent_j)
        spent_j = np.where(selected, spent_j, np.fmin(spent_j, resting_j))  # NaN: awake
        if not blind:
            always_j = sum(slot.active_j for slot in estimate.slots)
            learned = np.array([slot.measured for slot in estimate.slots])
            sums_j = spent_j.sum(), always_j, spent_j[learned].sum()
            self._sums_j = self._sums_j + sums_j  # replaced whole: another thread reads it
        return spent_j

    def _estimated(self) -> EnergyEstimate:
        return estimate_energy(
            self._cameras,
            self._budgets,
            self._interval_s,
            self._now_ns() / 1e9,
            self._num_selected,
        )
