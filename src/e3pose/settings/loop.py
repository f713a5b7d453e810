"""Settings of the loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from msgspec import Meta

from e3pose.base.errors import InputError
from e3pose.base.quantities import duration_s, length_m, milliseconds_s, power_w
from e3pose.base.table import check_bounds, entry
from e3pose.settings.energy import AWAKE, EnergyPlan, RestChoice
from e3pose.settings.faults import NO_FAULTS, Faults

if TYPE_CHECKING:
    from e3pose.energy.rest_costs import RestCosts
    from e3pose.estimate.base import Estimator
    from e3pose.predict.base import Predictor
    from e3pose.select.policies.base import Policy

# The names that users give: what estimates, and who decides unless they say otherwise.
PIPELINES = {
    "memory": ("memory", "information"),
    "paper": ("paper", "e3pose"),
}
PAPER_CAMERAS = 3  # per slot, as in the paper; it needs two views of everybody
USUAL_CAMERAS = 2
BUDGET_MARGIN = 0.2  # of the default budget above C/N: the paper's 0.8 for 3 of 5 cameras
# Of the camera slots that a lifetime affords: the rest lets the choice among the cameras be free.
LIFETIME_SHARE = 0.95
MAX_LEAD = 1000
WHOLE_EVERY = 5  # detections; chosen on simulated scenes
MAX_WHOLE_EVERY = 1000
PAPER_ONLY, EXPERIMENTS = "Paper", "Experiments"  # groups of options
FEEDBACK = "+feedback"  # after the name of a policy in a table of several
MAX_TARGET_M = 1.0
MAX_SEED = 2**31 - 1
MAX_WATTS = 1e6
FIND_RANGE_S = (0.1, 3600.0)

Settings = TypeVar("Settings", bound="LoopSettings")
AtLeast0 = Annotated[float, Meta(ge=0)]
Seed = Annotated[int, Meta(ge=0, le=MAX_SEED)]


def read_name(found: object) -> str:
    """Return the name of a policy or a predictor; raise `InputError` for anything else."""
    if not isinstance(found, str):
        raise InputError("", repr(found)[:60], "a name")
    return found


def read_cameras(found: object) -> float:
    """Return a number of cameras; raise `InputError` for anything else."""
    if isinstance(found, int | float) and not isinstance(found, bool) and 0 < found < float("inf"):
        return found
    shown = f"{found:g}" if isinstance(found, float) else repr(found)[:60]
    raise InputError("", shown, "a number above 0")


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """Settings of the loop; checked when it is made, as far as that needs no rig.

    A field that a person may set is explained by its help; `read_table` reads it from a site file,
    and `cli.settings_options` makes it an option. `policy` and `predictor` may be objects.

    Attributes:
        policy: who decides: a name of `POLICIES` or of one's own, or an object; the pipeline's
            own by default.
        num_selected: the paper's C; a mean if it is no whole number. By default what the budget of
            a lifetime pays for, or else 2, and 3 with the pipeline `paper`.
        foresees: compute the information expected of each camera even if the policy needs none.
        cost_j: energy of an active slot beyond that of an idle one, of each camera; all alike by
            default, and only the proportions matter.
        rest_costs: what cameras draw awake and asleep; of the default profile if None.
        estimator: an object in place of the pipeline's own.

    Raises:
        InputError: naming the key of a site file, which is also the option.
    """

    pipeline: str = entry(
        "memory",
        help="""`memory`: a filter per person. `paper`: the system as published.""",
    )
    policy: str | Policy | None = entry(None, read=read_name)
    num_selected: float | None = entry(None, key="cameras", read=read_cameras)
    target_error_m: float | None = entry(
        None,
        key="target_error",
        read=length_m,
        group="Goal",
        help="""Wake as few cameras as keep the expected error below this, such as 40mm.""",
    )
    rest: RestChoice = entry(
        AWAKE,
        group="Goal",
        help="""Rest of cameras not needed for seconds.""",
    )
    watts: float | None = entry(
        None,
        read=power_w,
        group="Goal",
        help="""Mean power that all cameras together may draw, such as 30W. Needs --rest; replaces
        --cameras.""",
    )
    find_within_s: float = entry(
        1.0,
        key="find_within",
        read=duration_s,
        shown="1s",
        group=EXPERIMENTS,
        help="""Longest time to find a newcomer in view of an awake camera while the place is empty:
        1s, 500ms. With --rest, cameras look as rarely as this allows.""",
    )
    budget: float | tuple[float, ...] | None = entry(
        None,
        flag="-E",
        group=EXPERIMENTS,
        help="""Energy budget E: share of slots a camera may be active, C/N to 1. Default:
        C/N + 0.2. `evaluate` also takes several, comma-separated.""",
    )
    quality_weight: AtLeast0 | None = entry(
        None,
        flag="-V",
        group=EXPERIMENTS,
        help="""Quality weight V: higher prefers better views, lower spreads energy more evenly.
        Default: set by the policy. `evaluate` also takes several, comma-separated.""",
    )
    raw_weight: bool = entry(
        False,
        group=PAPER_ONLY,
        help="V of the paper's policies weighs IoU itself, as in its eq. (9).",
    )
    lead_slots: Annotated[int, Meta(ge=1, le=MAX_LEAD)] = entry(
        1,
        key="lead",
        group=EXPERIMENTS,
        help="Lead tau: slots between a decision and the slot it is for.",
    )
    warmup_slots: Annotated[int, Meta(ge=0, le=MAX_LEAD)] = entry(
        10,
        key="warmup",
        group=EXPERIMENTS,
        help="Warm-up M: slots at the start in which every camera detects.",
    )
    seed: Seed = entry(0, group=EXPERIMENTS, help="Random seed.")
    phase: Seed = entry(
        0, group=EXPERIMENTS, help="Camera that starts the round robin and wins ties."
    )
    predictor: str | Predictor | None = entry(
        None,
        read=read_name,
        group=EXPERIMENTS,
        help="""Motion predictor: attention-lstm, attention-lstm-paper (the published network),
        constant-velocity, damped-velocity, zero-velocity, or a file from `e3pose train`. The
        policy predicts with it; attention-lstm and trained files also correct the filter's
        velocities (pipeline `memory`). Default: chosen to suit the pipeline.""",
    )
    noise: str | None = entry(
        None,
        group=EXPERIMENTS,
        help="""Keypoint noise model: a detector name, or a file from `e3pose calibrate noise`.
        Default: the model of the recording's detector.""",
    )
    feedback: bool = entry(
        False,
        group=EXPERIMENTS,
        help="""Semantic feedback: detect again in the videos of the recording, only where people
        are expected, in parts scaled to the network's best size.""",
    )
    whole_every: Annotated[int, Meta(ge=1, le=MAX_WHOLE_EVERY)] = entry(
        WHOLE_EVERY,
        group=EXPERIMENTS,
        help="With feedback, detect in the whole image every this many detections.",
    )
    matcher: str | None = entry(
        None,
        read=read_name,
        group=PAPER_ONLY,
        help="""How the views of one person are matched: `epipolar` (as the paper words it,
        default), `tanke-gall` (by the rules of the publication that the paper names) or `rays` (by
        how near rays pass each other; take it for single photos).""",
    )
    match_distance_m: float | None = entry(
        None,
        key="match_distance",
        read=length_m,
        group=PAPER_ONLY,
        help="""Maximum mean distance between the rays of two views of one person: 100mm, 0.1m.
        Default: 150mm. Matcher `rays` only.""",
    )
    epipolar_px: float | None = entry(
        None,
        group=PAPER_ONLY,
        help="""Maximum mean distance from epipolar lines between two views of one person, in
        pixels. Default: 30 with the matcher `epipolar`, 20 with `tanke-gall`.""",
    )
    reject_outliers: bool = entry(
        False, group=PAPER_ONLY, negative=True, help="Reject views that disagree with the others."
    )
    fill: bool | None = entry(
        None,
        group=PAPER_ONLY,
        negative=True,
        help="Keep a joint that a slot lacks where it last was on the body. Default: on.",
    )
    occlusion_limit: AtLeast0 = entry(
        0.05, group=PAPER_ONLY, help="Occlusion threshold of the policy `independent`."
    )
    independent_queue: bool = entry(
        False,
        group=PAPER_ONLY,
        help="Keep cameras of the policy `independent` within their energy budgets, too.",
    )
    round_trip_s: float = entry(
        0.05,
        key="round_trip_ms",
        read=milliseconds_s,
        shown=50.0,
        group=PAPER_ONLY,
        help="Network round trip that the policy `central-2d` waits for in each decision.",
    )
    foresees: bool = entry(False, key="")
    cost_j: tuple[float, ...] | None = entry(None, key="")
    rest_costs: RestCosts | None = entry(None, key="")
    estimator: Estimator[Any] | None = entry(None, key="")

    def __post_init__(self) -> None:
        check_bounds(self)
        if not (isfinite(self.round_trip_s) and self.round_trip_s >= 0):
            raise InputError("round_trip_ms", self.round_trip_s, "a number of at least 0")
        target_m = self.target_error_m
        if target_m is not None and not 0 < target_m <= MAX_TARGET_M:
            raise InputError("target_error", f"{1000 * target_m:g} mm", "1 mm to 1 m")
        watts, find_s = self.watts, self.find_within_s
        if watts is not None and not 0 < watts <= MAX_WATTS:
            raise InputError("watts", f"{watts:g} W", f"more than 0 and at most {MAX_WATTS:g} W")
        if watts is not None and self.rest == AWAKE:
            raise InputError("watts", "without rest", "rest = asleep or suspended")
        if not FIND_RANGE_S[0] <= find_s <= FIND_RANGE_S[1]:
            raise InputError("find_within", f"{find_s:g} s", "0.1 s to an hour")
        shares = self.budget if isinstance(self.budget, tuple) else (self.budget,)
        for share in shares:
            if share is not None and not 0 < share <= 1:
                raise InputError("budget", f"{share:g}", "a share of the slots in (0, 1]")

    @property
    def policy_name(self) -> str:
        """The policy that decides."""
        if self.policy is None:
            return pipeline_row(self.pipeline)[1]
        return self.policy if isinstance(self.policy, str) else type(self.policy).__name__

    @property
    def row_name(self) -> str:
        """The policy that decides and whether cameras get feedback."""
        return self.policy_name + FEEDBACK * self.feedback

    def for_rig(
        self: Settings,
        num_cameras: int,
        plan: EnergyPlan | None = None,
    ) -> Settings:
        """Return the settings with all that follows from a rig and its energy filled in.

        Args:
            num_cameras: of the rig.
            plan: what the cameras draw and have; its budgets and costs are taken over.

        Raises:
            InputError: for settings that contradict each other, or ask for more than the rig has.
        """
        if plan is None:
            count = self.num_selected
            if count is None:
                paper = pipeline_row(self.pipeline)[0] == "paper"
                usual = PAPER_CAMERAS if paper else USUAL_CAMERAS
                return replace(self, num_selected=min(usual, num_cameras))
            if not 0 < count <= num_cameras:
                wanted = f"more than 0 and at most the rig's {num_cameras}"
                raise InputError("cameras", f"{count:g} per slot", wanted)
            return self
        if self.num_selected is not None and self.target_error_m is not None:
            found = "a number of cameras as well"
            wanted = "one of the two: a target error chooses the number of cameras"
            raise InputError("target_error", found, wanted)
        if self.watts is not None and self.num_selected is not None:
            wanted = "one of the two: watts choose the number of cameras"
            raise InputError("watts", "a number of cameras as well", wanted)
        if plan.budget is not None and self.budget is not None:
            raise InputError("lifetime", "with budget", "one of them: it sets all budgets")
        count = self.num_selected
        if count is None and plan.budget is not None:
            count = min(LIFETIME_SHARE * sum(plan.budget), num_cameras)
        budget = self.budget if plan.budget is None else plan.budget
        costs = plan.rest_costs(self.rest)
        made = replace(
            self, num_selected=count, budget=budget, cost_j=plan.cost_j, rest_costs=costs
        )
        return made.for_rig(num_cameras)

    def share(self, num_cameras: int) -> float | tuple[float, ...] | None:
        """Return the share of slots that cameras may be active; None without a limit."""
        # Who sleeps spends nothing: even turns are no aim where others watch instead.
        free = self.target_error_m is not None or self.rest != AWAKE
        if self.budget is not None or free:
            return self.budget
        count = self.for_rig(num_cameras).num_selected
        # The paper's E_n for those who name none: a margin above C/N, at most every slot.
        return None if count is None else min(1.0, count / num_cameras + BUDGET_MARGIN)


@dataclass(frozen=True, slots=True)
class ReplaySettings(LoopSettings):
    """Settings for replaying a recording.

    Attributes:
        faults: cameras that die and views that are lost.
    """

    faults: Faults = entry(NO_FAULTS, key="")


def pipeline_row(name: str) -> tuple[str, str]:
    """Return the estimator and the policy of a pipeline; one of one's own has the usual policy."""
    return PIPELINES.get(name, (name, PIPELINES["memory"][1]))
