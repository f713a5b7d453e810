"""Policies: the situation before a slot -> the cameras that detect in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from e3pose.base.plugins import making, member
from e3pose.select.policies.base import Need as Need
from e3pose.select.policies.base import Policy as Policy
from e3pose.select.policies.base import Promise as Promise
from e3pose.select.policies.base import Selection as Selection
from e3pose.select.policies.base import Situation as Situation
from e3pose.select.policies.drift_plus_penalty import Central2D, DriftPlusPenalty
from e3pose.select.policies.fixed import All, Random, RoundRobin
from e3pose.select.policies.independent import Independent
from e3pose.select.policies.information import Information

GROUP = "e3pose.policies"  # the entry points of other packages
# tuned: camera slots | simulated people, seeds 701 to 706, and motion capture | by the truth 0: 4 %
#   more error; 0.3 to 3 the same, docs/research/paper-comparison.md
OCCLUSION_WEIGHT = 1.0
# tuned: camera slots per nat | simulated, five scenes, seeds 101 and 102 | 3 to 1000 differ by less
#   than the seeds
INFORMATION_WEIGHT = 10.0  # simulated: docs/explanation/camera-selection.md


@dataclass(frozen=True, slots=True)
class PolicySettings:
    """User settings of a policy.

    Attributes:
        num_selected: the paper's C, cameras per slot; a mean if it is no whole number.
        quality_weight: the paper's V, of its own policies in camera slots; the policy's own by
            default.
        target_error_m: of policies that aim: the expected error to keep with the fewest cameras.
        seed: of random choices.
        phase: offset of turns and ties.
        occlusion_limit: of `independent`.
        independent_queue: whether it also keeps every camera within its energy budget.
        round_trip_s: of `central-2d`.
        raw_weight: whether the weight of the paper's policies is the paper's V, of IoU itself.
        order: in which cameras take turns; rig order if empty.
    """

    num_selected: float = 3
    quality_weight: float | None = None
    target_error_m: float | None = None
    seed: int = 0
    phase: int = 0
    occlusion_limit: float = 0.05
    independent_queue: bool = False
    round_trip_s: float = 0.05
    raw_weight: bool = False
    order: tuple[int, ...] = ()

    def weight(self, usual: float = OCCLUSION_WEIGHT) -> float:
        """Return the quality weight, or the `usual` one of a policy if none was asked for."""
        return usual if self.quality_weight is None else self.quality_weight


# Settings that may change what a policy selects, by their names in `LoopSettings`.
COUNT, BUDGET, WEIGHT = "num_selected", "budget", "quality_weight"
TARGET, QUEUE = "target_error_m", "independent_queue"


@dataclass(frozen=True, slots=True)
class PolicyRow:
    """One policy of the table.

    Attributes:
        make: settings -> policy.
        about: one line for `--help` and tables.
        predictor: the predictor it uses by default.
        needs: of the loop.
        uses: settings that change what it selects, by their names in `LoopSettings`.
        promises: of its selections.
    """

    make: Callable[[PolicySettings], Policy]
    about: str = ""
    predictor: str = "constant-velocity"
    needs: frozenset[Need] = frozenset()
    uses: frozenset[str] = frozenset({COUNT, BUDGET, WEIGHT})
    promises: frozenset[Promise] = frozenset()

    @classmethod
    def of(cls, policy: Policy) -> PolicyRow:
        """Return the row of a user-defined policy."""
        return cls(
            lambda settings: policy,
            needs=frozenset({Need.OWN_BOXES}),
            uses=frozenset({BUDGET, WEIGHT}),
        )


BOTH = frozenset({Promise.COUNT, Promise.BUDGET})
POLICIES: dict[str, PolicyRow] = {
    "all": PolicyRow(
        lambda s: All(),
        "every camera in every slot (SA)",
        uses=frozenset(),
    ),
    "random": PolicyRow(
        lambda s: Random(s.num_selected, s.seed),
        "C cameras at random (RS)",
        uses=frozenset({COUNT}),
        promises=BOTH,
    ),
    "round-robin": PolicyRow(
        lambda s: RoundRobin(s.num_selected, s.phase, s.order),
        "C cameras in turn, one after another from directions far apart",
        uses=frozenset({COUNT}),
        promises=BOTH,
    ),
    "independent": PolicyRow(
        lambda s: Independent(s.occlusion_limit, queue=s.independent_queue),
        "each camera for itself, by its own 2D motion vectors and a threshold (ID)",
        needs=frozenset({Need.OWN_BOXES}),
        uses=frozenset({QUEUE}),
    ),
    "central-2d": PolicyRow(
        lambda s: Central2D(s.num_selected, s.weight(), s.round_trip_s, s.phase, s.raw_weight),
        "cameras predict boxes, the edge selects, a round trip each time",
        needs=frozenset({Need.OWN_BOXES, Need.SENT_BOXES, Need.HELD_POSES}),
        promises=frozenset({Promise.BUDGET}),
    ),
    "e3pose-mv": PolicyRow(
        lambda s: DriftPlusPenalty(s.num_selected, s.weight(), s.phase, s.raw_weight),
        "drift plus penalty on occlusion predicted by 3D motion vectors",
        promises=BOTH,
    ),
    "e3pose": PolicyRow(
        lambda s: DriftPlusPenalty(s.num_selected, s.weight(), s.phase, s.raw_weight),
        "drift plus penalty on occlusion predicted by the attention-LSTM",
        predictor="attention-lstm",
        promises=BOTH,
    ),
    "information": PolicyRow(
        lambda s: Information(
            s.num_selected, s.weight(INFORMATION_WEIGHT), s.target_error_m, s.phase, s.order
        ),
        "the cameras with the most expected information about all people",
        needs=frozenset({Need.FORESIGHT}),
        uses=frozenset({COUNT, BUDGET, WEIGHT, TARGET}),
        promises=BOTH,
    ),
}


def policy_row(name: str, queue: bool = False) -> PolicyRow:
    """Return the row of the policy called `name`.

    One of one's own is a `PolicyRow`, a class, or a function of `PolicySettings`.

    Args:
        name: of the table, of an entry point, or of a module.
        queue: whether it is given an energy queue, if it may have one.

    Raises:
        InputError: listing the known ones.
    """
    found: Any = member(GROUP, "policy", name, POLICIES)
    if isinstance(found, PolicyRow):
        may_queue = queue and QUEUE in found.uses
        if not may_queue:
            return found
        promises = found.promises | {Promise.BUDGET}
        return replace(found, uses=found.uses | {BUDGET}, promises=promises)
    return PolicyRow(making(found), needs=frozenset({Need.OWN_BOXES}))
