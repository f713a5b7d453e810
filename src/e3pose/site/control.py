"""Control of a running edge by operators: validated at once, applied from the next slot.

Nothing of it is written down: an edge that is restarted runs as its site file says.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from typing import TYPE_CHECKING

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.base.rate_limit import Rate
from e3pose.edge.consumers import NOTHING_ASKED, Asked, Chosen, Spending
from e3pose.energy.budgets import Budget, parse_budget
from e3pose.settings.loop import LoopSettings
from e3pose.settings.parts import make_policy, row_of, shares
from e3pose.settings.resolved import ResolvedSite, resolve_site
from e3pose.wire.codec import decode, encode, one_line
from e3pose.wire.site_messages import Control, Controlled

if TYPE_CHECKING:
    from e3pose.site.event_sink import EventSink

PER_S, BURST = 2.0, 20.0  # requests of an operator
ALL_PER_S, ALL_BURST = 10.0, 60.0  # of all of them
COUNT_S = 10.0  # how long refused requests are counted before they are reported
TOO_MANY = encode(Controlled(problem=f"more than {PER_S:g} requests per second: ask again later"))


class SiteControls:
    """Requests of operators to an edge; see `edge.consumers.Controls`."""

    def __init__(
        self,
        site: ResolvedSite,
        sink: EventSink | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start with the settings of the site file.

        Args:
            site: what its file says.
            sink: takes other zones and bounds of the store; None without a store.
            now_s: a clock, for the rates of requests.
        """
        self._site, self._loop, self._sink = site, site.loop, sink
        self._own: dict[str, Budget] = {}  # camera to the budget that an operator gave it
        self._paused: frozenset[str] = frozenset()
        # To be used from the next slot on.
        self._chosen: Chosen | None = None
        self._spending: Spending | None = None
        self._reported: list[str] = []
        self._now_s = now_s
        self._rate, self._rate_of_all = Rate(PER_S, BURST, now_s), Rate(ALL_PER_S, ALL_BURST, now_s)
        self._refused: Counter[str] = Counter()  # requests by operator
        self._refused_since_s = 0.0
        self._lock = threading.Lock()

    @property
    def paused(self) -> frozenset[str]:
        """Cameras that are left out."""
        return self._paused

    def answer(self, operator: str, payload: bytes) -> bytes:
        """Apply a `Control`, or answer why not; on a thread of the transport."""
        if self._too_many(operator):
            return TOO_MANY
        try:
            said = self.take(decode(payload, Control, "control"))
        except InputError as error:
            return encode(Controlled(problem=one_line(str(error))))
        return encode(Controlled(said=one_line(said)))

    def take(self, control: Control) -> str:
        """Apply a request completely or not at all; return a message about it.

        Raises:
            InputError: naming what cannot be had.
        """
        with self._lock:
            if control.reread:
                said = self._of_file(control)
            else:
                said = self._of_camera(control) if control.camera_id else self._of_loop(control)
            if not said:
                raise InputError("control", "nothing to change", "one setting at least")
            self._reported.append(said)
        return said

    def applied(self) -> Asked:
        """See `edge.consumers.Controls`."""
        if not self._reported and not self._refused:  # nearly always
            return NOTHING_ASKED
        with self._lock:
            lines, self._reported = [*self._reported, *self._refusals()], []
            chosen, self._chosen = self._chosen, None
            spending, self._spending = self._spending, None
        return Asked(chosen, spending, lines)

    def _too_many(self, operator: str) -> bool:
        """Return whether an operator asks too often, and count that."""
        with self._lock:
            if not (self._rate.wait_s(operator) or self._rate_of_all.wait_s("")):
                return False
            if not self._refused:
                self._refused_since_s = self._now_s()
            self._refused[operator[:64]] += 1
        return True

    def _refusals(self) -> list[str]:
        if not self._refused or self._now_s() < self._refused_since_s + COUNT_S:
            return []
        (most, _), *_ = self._refused.most_common(1)
        count, self._refused = self._refused.total(), Counter()
        return [f"{plural(count, 'request')} refused, most of operator {most}: too many per second"]

    def _of_file(self, control: Control) -> str:
        """Reload the parts of the site file that a running edge can change."""
        if control != Control(reread=True):
            raise InputError("reread", "with another setting", "one of them at a time")
        new, old = resolve_site(self._site.file.path), self._site
        new.budgets()  # its error first
        store = old.file.store
        if store is not None and new.file.store is not None and self._sink is not None:
            store = replace(store, keep_s=new.file.store.keep_s, max_bytes=new.file.store.max_bytes)
            if store != old.file.store:
                self._sink.writer.keep(store.keep_s, store.max_bytes)
        words = ["storage"] if store != old.file.store else []
        if new.file.zone != old.file.zone:
            words.insert(0, "zones")
            if self._sink is not None:
                self._sink.rezone(new)
        file = replace(old.file, zone=new.file.zone, store=store, budget=new.file.budget)
        self._site = replace(old, file=file, stated=new.stated)
        if new.file.budget != old.file.budget:
            words.append("budget")
            self._budget(dict(self._own), self._loop)
        return f"{', '.join(words) or 'nothing new'} from the site file"

    def _of_loop(self, control: Control) -> str:
        if control.paused is not None or control.budget:
            raise InputError("camera_id", "none", "the camera to pause, or whose budget it is")
        loop, words = self._loop, []
        if control.cameras is not None and control.target_error_mm is not None:
            raise InputError("target_error_mm", "a number of cameras as well", "one of them")
        if control.cameras is not None:
            loop = replace(loop, num_selected=control.cameras, target_error_m=None)
            words.append(f"{plural(control.cameras, 'camera')} per slot")
        if control.target_error_mm is not None:
            loop = replace(loop, target_error_m=control.target_error_mm / 1000)
            words.append(f"target error {control.target_error_mm:g} mm")
        if control.quality_weight is not None:
            loop = replace(loop, quality_weight=control.quality_weight)
            words.append(f"quality weight {control.quality_weight:g}")
        if not words:
            return ""
        loop = loop.for_rig(len(self._site.rig))
        chosen = make_policy(self._site, loop)
        if chosen[1] is None and control.cameras is not None:
            found = f"with the policy {loop.policy_name}, which has no number of cameras"
            raise InputError("cameras", found, "another policy in the site file")
        self._budget(dict(self._own), loop)
        self._loop, self._chosen = loop, chosen
        return ", ".join(words)

    def _of_camera(self, control: Control) -> str:
        name, words = control.camera_id, []
        if name not in self._site.rig.camera_ids:
            raise InputError("camera_id", name, f"one of {', '.join(self._site.rig.camera_ids)}")
        if {control.cameras, control.target_error_mm, control.quality_weight} != {None}:
            raise InputError("camera_id", "with a setting of the site", "one of them at a time")
        if control.budget:
            own = self._own | {name: parse_budget(control.budget, datetime.now().astimezone())}
            self._budget(own, self._loop)
            self._own = own
            words.append(f"budget {control.budget}")
        if control.paused is not None:
            self._paused = self._paused | {name} if control.paused else self._paused - {name}
            words.append("paused" if control.paused else "resumed")
        return f"{name}: {', '.join(words)}" if words else ""

    def _budget(self, own: dict[str, Budget], loop: LoopSettings) -> None:
        """Request the budgets of the loop, except for cameras with their own."""
        each = shares(loop, row_of(loop), len(self._site.rig)).tolist()
        usual = self._site.budgets()
        names = self._site.rig.camera_ids
        budgets = [
            own.get(name, budget or Budget("duty", share))
            for name, budget, share in zip(names, usual, each, strict=True)
        ]
        self._spending = budgets, loop.num_selected or 0.0
