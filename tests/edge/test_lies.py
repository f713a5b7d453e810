"""What cameras say of themselves changes nothing for the others, whatever they say."""

from __future__ import annotations

from functools import cache
from math import ceil

import numpy as np
import pytest
from tests.edge.lying_site import FPS, Kept, run

from e3pose.edge.inbox import BEAT_S, NEAR_S
from e3pose.edge.lead import FAR_S
from e3pose.wire.messages import CameraMode, ClockQuestion, Heartbeat, Hello, View
from lies import HONEST, Change, Lie, lies_of_fields, schemes

pytestmark = pytest.mark.slow

SCHEMES = {lie.name: lie for lie in schemes()}
CAMERAS, SECONDS = 4, 24.0
GONE = Lie("gone", dict.fromkeys((Hello, View, Heartbeat, ClockQuestion), lambda m, n, dice: None))
BEGUN = round(4 * FPS) + 90  # slots until liars begin and the edge has noticed


@cache
def without(lie: str, liars: int, seconds: float, idle_mode: CameraMode) -> Kept:
    """Return what a site gives whose cameras are honest, or whose last ones are gone."""
    return run({"none": HONEST, "gone": GONE}[lie], liars, seconds, CAMERAS, idle_mode)


def check(
    kept: Kept,
    liars: int,
    seconds: float,
    idle_mode: CameraMode,
    more_lead: int = 2,
    false_people: bool = False,
) -> None:
    """Assert that cameras that lie cost no more than cameras that are gone."""
    honest, gone = (without(lie, liars, seconds, idle_mode) for lie in ("none", "gone"))
    assert max(kept.leads) <= max(honest.leads) + more_lead

    def worst(name: str, of: object = np.mean) -> float:
        figures = [float(of(getattr(each, name)[BEGUN:])) for each in (honest, gone)]  # type: ignore[operator]
        return max(figures) if name == "latencies_s" else min(figures)

    assert np.median(kept.latencies_s[BEGUN:]) <= worst("latencies_s", np.median) + 0.005
    tracked = [np.mean(np.array(each.people[BEGUN:]) >= 2) for each in (kept, honest, gone)]
    # What views show is beyond what this defends against: false people hide and attract.
    # While a slow link is believed, orders are made up to half a second earlier, of older views.
    allowed = 0.3 if false_people else 0.2 if more_lead > 2 else 0.05
    assert tracked[0] >= min(tracked[1:]) - allowed
    assert np.mean(kept.views[BEGUN:]) >= 0.9 * worst("views")
    assert len(kept.leads) >= len(honest.leads) - 1 and kept.lines > 0
    np.testing.assert_allclose(kept.budget, honest.budget)
    np.testing.assert_allclose(kept.price, honest.price, rtol=0.1)
    most = 1.1 * max(*honest.deficit, *gone.deficit) + 3
    assert max(kept.deficit) <= (4 if false_people else 1) * most
    assert all(abs(row.time_ns - came_ns) <= NEAR_S * 1e9 + 1 for came_ns, row in kept.readings)
    assert len(kept.readings) <= CAMERAS * seconds / BEAT_S


@pytest.mark.parametrize("liars", [1, 2])
@pytest.mark.parametrize("name", SCHEMES)
def test_schemes_of_cameras_cost_the_others_nothing(name: str, liars: int) -> None:
    idle_mode: CameraMode = "aggressive-power-saving" if "wakes" in name else "power-saving"
    kept = run(SCHEMES[name], liars, SECONDS, CAMERAS, idle_mode)
    # A camera that misses orders is believed for some attempts that its link is slow.
    slow = "no view" in name and ("orders take" in name or "wakes" in name)
    more_lead = 2 + ceil(FAR_S * FPS) * slow
    check(kept, liars, SECONDS, idle_mode, more_lead, false_people="crowd" in name)


@pytest.mark.parametrize("liars", [1, 2])
@pytest.mark.parametrize("kind", [Hello, View, Heartbeat])
def test_extremes_of_every_field_cost_the_others_nothing(kind: type, liars: int) -> None:
    fields = [(lie, count) for lie, count in lies_of_fields(hold=1) if kind in lie.changes]
    assert len(fields) == len(kind.__struct_fields__)  # type: ignore[attr-defined]
    begins = np.cumsum([0, *(count for _, count in fields)])

    def change(message: object, n: int, dice: object) -> object:
        at = int(np.searchsorted(begins, n % begins[-1], side="right")) - 1
        each: Change = fields[at][0].changes[kind]
        return each(message, n, dice)  # type: ignore[arg-type]

    seconds = {"Hello": 200.0, "View": 40.0, "Heartbeat": 160.0}[kind.__name__]
    kept = run(Lie(kind.__name__, {kind: change}), liars, seconds, CAMERAS)
    check(kept, liars, seconds, "power-saving")
