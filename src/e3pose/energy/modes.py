"""What a camera can do, and what each costs: looks and rests, one table a camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from e3pose.energy.profiles import DeviceProfile

RestName = Literal["idle", "not-capturing", "asleep", "suspended"]
LookName = Literal["whole", "part", "tracked", "gate", "nothing"]
RESTS: tuple[RestName, ...] = ("idle", "not-capturing", "asleep", "suspended")
LOOKS: tuple[LookName, ...] = ("whole", "part", "tracked", "gate", "nothing")

WAKE_S = 0.5  # tuned: s | not recorded, what a USB camera takes to its first frame | not measured
SLOT_S = 0.04  # of a look whose joules a profile states by its power alone: 25 slots per second
NOT_STATED = "not stated"


@dataclass(frozen=True, slots=True)
class Rest:
    """What a camera does between looks.

    Attributes:
        name: one of `RESTS`: `idle` captures and runs no network; `not-capturing` has closed its
            source and still hears orders; `asleep` neither captures nor is reachable, the program
            waits; `suspended` is a suspended machine.
        watts: of the whole device.
        enter_s: from the last look or the order until it draws that.
        wake_s: from the alarm to the first frame, mean.
        wake_sd_s: standard deviation of `wake_s`.
        source: where the row is from.
    """

    name: str
    watts: float
    enter_s: float = 0.0
    wake_s: float = 0.0
    wake_sd_s: float = 0.0
    source: str = NOT_STATED


@dataclass(frozen=True, slots=True)
class Look:
    """A way to look in one slot.

    Attributes:
        name: one of `LOOKS`: `whole` detects in all of an image, `part` where people are expected,
            `tracked` follows the keypoints of the look before, `gate` compares a small image with
            that of the look before, `nothing` is a slot without a look.
        joules: that it takes beyond an idle slot.
        latency_s: from frame to view; 0 where the table does not state it.
        source: where the row is from.
    """

    name: str
    joules: float
    latency_s: float = 0.0
    source: str = NOT_STATED


@dataclass(frozen=True, slots=True)
class CameraModes:
    """The table of one camera. A mode without a row is one that the camera does not have.

    Attributes:
        looks: in the order of `LOOKS`.
        rests: in the order of `RESTS`, each drawing at most as much as the one before.
        table: which table this is, for people.
    """

    looks: tuple[Look, ...]
    rests: tuple[Rest, ...]
    table: str = NOT_STATED

    def look(self, name: LookName) -> Look | None:
        """Return a look; None where the camera does not have it."""
        return next((look for look in self.looks if look.name == name), None)

    def rest(self, name: RestName) -> Rest | None:
        """Return a rest; None where the camera does not have it."""
        return next((rest for rest in self.rests if rest.name == name), None)


def modes_of(profile: DeviceProfile, interval_s: float = SLOT_S) -> CameraModes:
    """Return the table of a camera by its power profile.

    Rows that the profile states go first. Otherwise a look at the whole image takes what an active
    slot draws beyond an idle one, idling draws what `power-saving` says and not capturing what
    `aggressive-power-saving` says; sleep and suspension have to be stated.

    Args:
        profile: of the camera's device.
        interval_s: seconds per slot, for a look that the profile states by its power alone.
    """
    idle_w = profile.watts("power-saving")
    whole_j = (profile.watts("active") - idle_w) * interval_s
    slot = f"active less power-saving, {1e3 * interval_s:.4g} ms"
    off_w = profile.watts("aggressive-power-saving")
    rests = {
        "idle": Rest("idle", idle_w, source="power-saving"),
        "not-capturing": Rest(
            "not-capturing", off_w, wake_s=WAKE_S, source="aggressive-power-saving"
        ),
        **{rest.name: rest for rest in profile.rests},
    }
    looks = {
        "whole": Look("whole", whole_j, source=slot),
        "nothing": Look("nothing", 0.0, source="a slot without a look"),
        **{look.name: look for look in profile.looks},
    }
    return CameraModes(
        looks=tuple(looks[name] for name in LOOKS if name in looks),
        rests=tuple(rests[name] for name in RESTS if name in rests),
        table=f"profile {profile.name}",
    )
