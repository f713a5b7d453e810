"""An event of one's own: somebody kneels or crouches for two seconds.

Run: python examples/10_own_event.py
In a site file: kinds = ["fall", "examples/10_own_event.py:crouches"] under [events]
"""

from __future__ import annotations

from collections.abc import Mapping

from e3pose import ReplaySettings, replay
from e3pose.events.body import Joints
from e3pose.events.intervals import Bounds, Interval, turn
from e3pose.events.people import Seen
from e3pose.events.rules import Snapshot
from e3pose.events.states import CROUCHING
from e3pose.events.watch import advance, begin_watch
from e3pose.model.person_event import PersonEvent
from e3pose.settings.events_table import EventsTable
from e3pose.simulate import SceneSettings, simulate

Intervals = Mapping[int, Interval]


class Crouches:
    """Tells when somebody has crouched for a while, and when that is over."""

    def __init__(self, after_s: float) -> None:
        self._bounds = Bounds(after_s=after_s)

    def begin(self) -> Intervals:
        """Return what it remembers before the first slot."""
        return {}

    def advance(self, memory: Intervals, snapshot: Snapshot) -> tuple[Intervals, list[PersonEvent]]:
        """Return what it remembers after a slot, and the events of it."""
        values = {track: float(one.states[CROUCHING]) for track, one in snapshot.shown.items()}
        turned = turn(memory, values, snapshot.time_ns, self._bounds)
        events = [
            snapshot.event("crouches", "begun", track, interval, "crouched", interval.most)
            for track, interval in turned.begun.items()
        ] + [
            snapshot.event("crouches", "ended", track, interval, "crouched", interval.most)
            for track, interval in turned.ended.items()
        ]
        return turned.intervals, events


def crouches(table: EventsTable, joints: Joints) -> Crouches:
    """Return the rule for the settings of a site and the joints of its skeleton."""
    return Crouches(after_s=2.0)


def main() -> None:
    """Print who crouched in a simulated home."""
    home = SceneSettings("home-floor", seconds=18, fps=12.5, cameras=2)
    recording = simulate(home, seed=2)
    own = EventsTable(kinds=(f"{__file__}:crouches",))
    watch = begin_watch(own, recording.skeleton.joints)
    for record in replay(recording, ReplaySettings(num_selected=2)):
        watch, events = advance(watch, Seen(record.slot, round(record.time_s * 1e9), record.people))
        for event in events:
            print(f"{event.time_ns / 1e9:.1f} s: person {event.track} {event.kind}, {event.phase}")


if __name__ == "__main__":
    main()
