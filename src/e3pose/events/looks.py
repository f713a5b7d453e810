"""Which looks the events of a site are worth: what the planner is asked for.

Of somebody who sinks, is just down or was lost, it is unsure whether they fall: that is worth a
second camera at once. Everybody who is known lies on a bed or a sofa: a few looks a second are
enough, and cameras rest.
"""

from __future__ import annotations

from e3pose.events.people import Person
from e3pose.events.watch import Watch
from e3pose.model.look_request import NO_REQUEST, LookRequest

CAMERAS = 2.0  # definition: a second camera
# Looks a second while everybody lies: who rolls off a bed is down half a second later, and two
# looks show it; more are spent on people who sleep.
ENOUGH_PER_S = 4.0
# tuned: s, share of the stature | by reasoning: half way down to a fall's least drop, in the time
#   that a fall takes | `home-fall`, seeds 0 to 5, 26 W, with all of `is_unsure`: 25 of 29 found
#   and not 22
WITHIN_S, SINKS = 0.8, 0.08
# Probability of being on the floor from which on a fall is possible, a third of what `rules.fall`
# begins one with: a larger one asks for looks when it is decided, a smaller one for whoever sits.
PERHAPS_DOWN = 0.2
SURELY_LIES = 0.9  # probability; with less the looks become few while somebody gets up
# Seconds down for which looks are asked: a fall is told after `fall_s`, two by default, and the
# looks before it decide whether it is one; later ones change nothing and take from the budget.
LASTS_S = 3.0


def looks_of(watch: Watch) -> LookRequest:
    """Return the looks that what is known of the people of a site is worth."""
    if "fall" not in watch.rules or not watch.known:
        return NO_REQUEST
    unsure = tuple(track for track, one in watch.known.items() if is_unsure(one, watch))
    if unsure:
        return LookRequest(CAMERAS, unsure)
    all_rest = all(rests(person) for person in watch.known.values())
    return LookRequest(enough_per_s=ENOUGH_PER_S) if all_rest else NO_REQUEST


def rests(person: Person) -> bool:
    """Return whether somebody lies on a bed or a sofa."""
    return person.surface_m > 0 and person.lies >= SURELY_LIES


def is_unsure(person: Person, watch: Watch) -> bool:
    """Return whether somebody may fall or may have fallen just now: sinking, down, or lost."""
    if person.track not in watch.shown:
        return True
    if rests(person):
        return False
    if person.on_floor > PERHAPS_DOWN:
        down = watch.memories["fall"].intervals.get(person.track)
        return down is None or watch.time_ns - down.since_ns < LASTS_S * 1e9
    since_ns = watch.time_ns - WITHIN_S * 1e9
    heights = [height for time_ns, height, _ in person.trail if time_ns >= since_ns]
    return len(heights) > 1 and max(heights) - heights[-1] > SINKS
