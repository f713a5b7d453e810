"""The figures of one replay as records, and their JSON.

`docs/reference/metrics.md` says what each figure is. One that cannot be had (no truth, no match)
is None in a record and absent in JSON, never 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from typing import Any

from e3pose.energy.saving import NO_SAVINGS, Savings
from e3pose.settings.energy import AWAKE
from e3pose.settings.faults import Faults
from e3pose.settings.loop import LoopSettings

FORMAT = "e3pose-figures"
VERSION = 2  # 1 had other savings, in `energy` and `processor`
OWN = ("policy", "predictor", "estimator")  # settings that may be objects
OF_RESTS = ("rest", "find_within_s")  # mean nothing while nobody rests


@dataclass(frozen=True, slots=True)
class Pcp:
    """Percentage of correct parts on Shelf.

    Attributes:
        actors: by actor, and `average` over actors 1-3.
        groups: the same by limb group.
    """

    actors: Mapping[str, float]
    groups: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class Accuracy:
    """What the truth of a recording says, over its scored slots."""

    scored_slots: int | None = None
    pcp: Pcp | None = None
    mpjpe_mm: float | None = None
    p95_mm: float | None = None
    p99_mm: float | None = None
    recall_500mm: float | None = None
    joint_coverage: float | None = None
    id_switches: int | None = None
    acceleration_error_mps2: float | None = None
    precision_500mm: float | None = None
    ap: Mapping[str, float] | None = None
    poses_within: Mapping[str, float] | None = None


@dataclass(frozen=True, slots=True)
class Distances:
    """How far projected joints are from the keypoints of a held-out camera.

    Attributes:
        keypoints: how many are compared.
        mean_px: in the image.
        median_px: likewise.
        mean_mm: across the ray, at the depth of the joint.
        median_mm: likewise.
    """

    keypoints: int = 0
    mean_px: float | None = None
    median_px: float | None = None
    mean_mm: float | None = None
    median_mm: float | None = None


@dataclass(frozen=True, slots=True)
class HeldOutCamera(Distances):
    """What one held-out camera says, over the scored slots.

    Attributes:
        people: its detections that count.
        missed_percent: those without a pose.
        poses: that should be in its image.
        unseen_percent: those without a detection: hidden from it, or nobody.
        joints: distances by joint.
    """

    people: int = 0
    missed_percent: float | None = None
    poses: int = 0
    unseen_percent: float | None = None
    joints: Mapping[str, Distances] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class HeldOut:
    """What all held-out cameras say.

    Attributes:
        cameras: by camera id.
        mean: over them; counts are summed.
    """

    cameras: Mapping[str, HeldOutCamera]
    mean: HeldOutCamera


@dataclass(frozen=True, slots=True)
class Expected:
    """What the estimator expects to be off, and whether it is right.

    Attributes:
        error_mm: the mean expected error of all shown joints.
        foreseen_mm: the mean of what was expected of a slot when its cameras were chosen.
        matched_mm: what was expected of the joints of people matched within 500 mm.
        actual_mm: how far off those were.
        coverage_90: the share of them, in percent, within the distance that was to hold 90 %.
    """

    error_mm: float | None = None
    foreseen_mm: float | None = None
    matched_mm: float | None = None
    actual_mm: float | None = None
    coverage_90: float | None = None


@dataclass(frozen=True, slots=True)
class Selected:
    """Selection; shares of the slots by camera.

    Attributes:
        mean_cameras: cameras selected per slot, blind slots left out.
        mean_views: views that arrived per slot.
        duty: share of the slots in which each camera was selected, blind slots left out.
        blind: blind slots by cause; causes that did not occur are absent.
    """

    mean_cameras: float
    mean_views: float
    duty: Mapping[str, float]
    blind: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Deficits:
    """The virtual queues by camera, in slots."""

    final: Mapping[str, float]
    highest: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class CameraEnergy:
    """What one camera spent."""

    mean_watts: float
    active_watts: float
    energy_j: float
    battery_wh: float
    battery_hours: float


@dataclass(frozen=True, slots=True)
class DeviceSaving:
    """What a device of the paper would have saved of CPU, GPU, WiFi and memory.

    `times_paper` is against the paper's 3 of 5 cameras.
    """

    saving_percent: float
    aggressive_saving_percent: float
    times_paper: float
    aggressive_times_paper: float


@dataclass(frozen=True, slots=True)
class Energy:
    """What the selection spent.

    `watts_spread` is the standard deviation of the cameras' mean powers.
    """

    profile: str
    idle_mode: str
    watts_spread: float
    cameras: Mapping[str, CameraEnergy]
    battery_wh: float
    battery_hours_always_active: float
    devices: Mapping[str, DeviceSaving]


@dataclass(frozen=True, slots=True)
class Duration:
    """How long a stage takes, milliseconds."""

    median: float
    p99: float


@dataclass(frozen=True, slots=True)
class NoiseFound:
    """The noise file that was used, and what was learned of each camera by the last slot.

    Attributes:
        file: its name.
        factors: by camera, sigma of its keypoints over what the file states.
    """

    file: str
    factors: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Summary:
    """The figures of one replay.

    Attributes:
        recording: its name.
        slots: how many there were.
        policy: who decided.
        settings: how it was replayed, with all that follows from the rig.
        identities: how many were given.
        metrics: against the truth; None of its figures without one.
        expected: errors that the estimator stated.
        selection: shares by camera; None without a slot, and so on.
        deficits: the virtual queues.
        energy: spent.
        stage_ms: by stage, and `slot` for all of them.
        noise: of the keypoints; None of an estimator that does not learn it.
        smooth: how the poses were smoothed after the replay; None if they were not.
        notes: what a page should say beside, sentence by sentence.
        held_out: distances from the keypoints of held-out cameras, if any.
        savings: against all cameras active in every slot.
    """

    recording: str
    slots: int
    policy: str
    settings: LoopSettings
    identities: int
    metrics: Accuracy
    expected: Expected
    selection: Selected | None
    deficits: Deficits | None
    energy: Energy | None
    stage_ms: Mapping[str, Duration]
    noise: NoiseFound | None
    smooth: str | None = None
    notes: tuple[str, ...] = ()
    held_out: HeldOut | None = None
    savings: Savings = NO_SAVINGS


def as_json(summary: Summary, **more: Any) -> dict[str, Any]:
    """Return figures as the JSON that is written to files.

    Args:
        summary: the figures.
        more: further tables, at the end.
    """
    table: dict[str, Any] = {"format": FORMAT, "version": VERSION}
    for item in fields(summary):
        value = getattr(summary, item.name)
        table[item.name] = {} if value is None else plain(value)
    table["settings"] = settings_json(summary.settings)
    if table.pop("smooth"):
        table["settings"]["smooth"] = summary.smooth
    notes = table.pop("notes")
    if summary.held_out is None:
        del table["held_out"]
    return {**table, **more, **({"notes": notes} if notes else {})}


def settings_json(settings: LoopSettings) -> dict[str, Any]:
    """Return settings as JSON: what is not set is absent, parts of one's own are named."""
    table: dict[str, Any] = {}
    for item in fields(settings):
        if item.name in OF_RESTS and settings.rest == AWAKE:
            continue
        value = getattr(settings, item.name)
        if item.name in OWN and not isinstance(value, str | None):
            value = type(value).__name__
        if value is not None and item.name != "rest_costs":
            table[item.name] = asdict(value) if isinstance(value, Faults) else value
    return table


def plain(value: Any) -> Any:
    """Return nested records as dictionaries and lists, without what is None."""
    if isinstance(value, Pcp):
        return {**value.actors, "groups": plain(value.groups)}
    if is_dataclass(value) and not isinstance(value, type):
        found = {item.name: getattr(value, item.name) for item in fields(value)}
        return {name: plain(each) for name, each in found.items() if each is not None}
    if isinstance(value, Mapping):
        return {str(name): plain(each) for name, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, tuple | list) else value
