"""One replay of a recording as a piece of work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from e3pose.base.arrays import Floats
from e3pose.evaluate.metrics import count_parts, pcp_percent
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy, in_skeleton
from e3pose.model.skeleton import SHELF14
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording
from e3pose.select.occlusion import occlusion, person_boxes
from e3pose.select.policies import PolicySettings, Situation, policy_row
from e3pose.select.policies.base import Policy, Selection
from e3pose.simulate import SceneSettings, simulate
from e3pose_lab.noise.calibrate import first_slots
from e3pose_lab.reproduce.simulated import gathered, with_detections
from e3pose_lab.reproduce.sources import Sources
from e3pose_lab.reproduce.work import Piece

SHELF, FRAGMENT, MOTION = "shelf", "panoptic-fragment", "panoptic-motion"
SHELF_FEEDBACK, PIZZA = "shelf-feedback", "pizza"


def pcp_readings(
    recording: Recording, records: Sequence[SlotRecord]
) -> dict[str, dict[str, float]]:
    """Return PCP of a replay without a memory in three readings of the protocol; {} without truth.

    Returns:
        By actor and `average`: `shown` with filled joints; `estimated` without them, a limb that
        lacks an end being wrong; `skipped` likewise, such a limb not being counted.
    """
    truth = recording.truth
    if truth is None or truth.skeleton != SHELF14:
        return {}
    first, stop = recording.scored_slots or (0, recording.num_slots)
    by_slot = {record.slot: record for record in records}
    scored = [by_slot.get(slot) for slot in range(first, stop)]
    shown = in_skeleton(scored, recording.skeleton, truth.skeleton)
    placed = in_skeleton(
        [None if record is None else _placed(record) for record in scored],
        recording.skeleton,
        truth.skeleton,
    )
    readings = {"estimated": (placed, False), "shown": (shown, False), "skipped": (placed, True)}
    return {
        name: pcp_percent(count_parts(people, truth.joints_m[first:stop], skip), truth.person_ids)
        for name, (people, skip) in readings.items()
    }


def _placed(record: SlotRecord) -> SlotRecord:
    """Return the record without the joints that were not estimated in its slot."""
    people, measured = record.people, record.people.measured
    joints_m = np.where(measured[..., None], people.joints_m, np.nan)
    people = replace(people, joints_m=joints_m, scores=np.where(measured, people.scores, 0.0))
    return replace(record, people=people)


@dataclass(frozen=True, slots=True)
class Asked:
    """Settings of a replay.

    Attributes:
        recording: `SHELF`, `SHELF_FEEDBACK`, `PIZZA`, `FRAGMENT`, `MOTION`, or a simulated scene.
        policy: who decides.
        pipeline: a name of `settings.loop.PIPELINES`.
        cameras: the paper's C.
        quality_weight: the paper's V; the default by default.
        budget: the paper's E_n; C/N + 0.2 by default.
        lead: the paper's tau.
        seed: of the policy, and of simulated detections and scenes.
        predictor: the policy's own by default.
        sees_all: let the policy see the occlusion that the detections of all cameras show, which
            no policy can know.
        cost_j: energy of an active slot beyond that of an idle one, of each camera.
        target_mm: wake the fewest cameras whose expected error meets this instead of C.
        matcher: of the pipeline `paper`; the paper's by default.
        raw_weight: V weighs IoU itself.
        fill: whether joints that a slot lacks keep their place, without a memory.
        seconds: length of what is simulated, or of `PIZZA`; 0 for all there is.
        fps: of what is simulated; its own by default.
    """

    recording: str
    policy: str
    pipeline: str = "paper"
    cameras: float | None = 3
    quality_weight: float | None = None
    budget: float | tuple[float, ...] | None = None
    lead: int = 1
    seed: int = 0
    predictor: str | None = None
    sees_all: bool = False
    cost_j: tuple[float, ...] | None = None
    target_mm: float | None = None
    matcher: str | None = None
    raw_weight: bool = False
    fill: bool = True
    seconds: float = 0.0
    fps: float = 0.0


# Keys of `Run.pcp`, and what each counts.
READINGS = {
    "estimated": "as estimated",
    "shown": "filled",
    "skipped": "limbs without an estimate not counted",
}


@dataclass(frozen=True, slots=True)
class Run:
    """Figures of a replay.

    Attributes:
        pcp: by actor and `average`, by reading (`pcp_readings`); empty without labels of Shelf.
        ap: by limit in millimetres; empty where not everybody is annotated.
        within: share of poses, likewise: what the paper calls AP.
        mpjpe_mm: of matches below 500 mm; None without any.
        recall: share of labelled people found within 500 mm.
        duty: share of the slots in which each camera was selected.
        cameras: selected, the mean of all slots.
        occlusion: mean over slots of the occlusion, eq. (4), summed over the selected cameras, as
            the detections of all cameras show it; warm-up left out.
        highest: the longest virtual queue of any camera, in slots.
        queue: the sum of the queues, the mean of all slots.
        switches: how often a person's number changed.
        idle: by camera, how many slots each of its times without work lasted.
    """

    pcp: dict[str, dict[str, float]]
    ap: dict[str, float]
    within: dict[str, float]
    mpjpe_mm: float | None
    recall: float | None
    duty: tuple[float, ...]
    cameras: float
    occlusion: float
    highest: float
    queue: float
    switches: int | None
    idle: tuple[tuple[int, ...], ...]

    @property
    def average(self) -> float:
        """PCP averaged over actors 1-3, of all that is shown."""
        return self.pcp["shown"]["average"]

    @property
    def error_mm(self) -> float:
        """MPJPE; NaN without a match."""
        return float("nan") if self.mpjpe_mm is None else self.mpjpe_mm

    @property
    def error_with_misses_mm(self) -> float:
        """The mean error in which everybody who was not found counts as 500 mm off."""
        recall = self.recall or 0.0
        return (self.error_mm if recall else 0.0) * recall + 500.0 * (1 - recall)


@dataclass(frozen=True, slots=True)
class SeesAll:
    """A policy that knows the true occlusion of the slot it decides for.

    Attributes:
        policy: who decides.
        occlusion: `(num_slots, num_cameras)` from the detections of all cameras.
    """

    policy: Policy
    occlusion: Floats

    def select(self, situation: Situation) -> Selection:
        """See `Policy.select`."""
        slot = min(situation.slot, len(self.occlusion) - 1)
        return self.policy.select(replace(situation, occlusion=self.occlusion[slot]))


def replayed(sources: Sources, asked: Asked) -> Run:
    """Replay a recording and summarise it."""
    recording = recording_of(sources, asked)
    records = records_of(recording, asked)
    return summed_up(recording, asked, records)


def piece(asked: Asked) -> Piece[Asked, Run]:
    """Return a replay as a piece of work."""
    return Piece(replayed, asked)


def over_seeds(asked: Asked, seeds: int) -> list[Piece[Asked, Run]]:
    """Return a replay for each of the first seeds."""
    return [piece(replace(asked, seed=seed)) for seed in range(seeds)]


def records_of(recording: Recording, asked: Asked) -> list[SlotRecord]:
    """Return one record per slot."""
    settings = ReplaySettings(
        pipeline=asked.pipeline,
        policy=asked.policy,
        num_selected=asked.cameras,
        quality_weight=asked.quality_weight,
        budget=asked.budget,
        lead_slots=asked.lead,
        seed=asked.seed,
        phase=asked.seed,
        predictor=asked.predictor,
        matcher=asked.matcher,
        raw_weight=asked.raw_weight,
        fill=None if asked.fill else False,
        cost_j=asked.cost_j,
        target_error_m=None if asked.target_mm is None else asked.target_mm / 1000,
    )
    if not asked.sees_all:
        return list(replay(recording, settings))
    wanted = PolicySettings(
        num_selected=asked.cameras or 0.0,
        quality_weight=asked.quality_weight,
        seed=asked.seed,
        phase=asked.seed,
    )
    policy = SeesAll(policy_row(asked.policy).make(wanted), seen_occlusion(recording))
    return list(replay(recording, settings, policy=policy))


def summed_up(recording: Recording, asked: Asked, records: Sequence[SlotRecord]) -> Run:
    """Return the figures of a replay."""
    figures = accuracy(recording, records)
    selected = np.stack([record.selected for record in records])
    deficit = np.stack([record.deficit for record in records])
    total = (selected * seen_occlusion(recording)).sum(axis=1)
    return Run(
        pcp=pcp_readings(recording, records),
        ap=dict(figures.ap or {}),
        within=dict(figures.poses_within or {}),
        mpjpe_mm=figures.mpjpe_mm,
        recall=figures.recall_500mm,
        duty=tuple(selected.mean(axis=0).tolist()),
        cameras=float(selected.sum(axis=1).mean()),
        occlusion=float(total[10 + asked.lead :].mean()) if len(total) > 10 + asked.lead else 0.0,
        highest=float(deficit.max()),
        queue=float(deficit.sum(axis=1).mean()),
        switches=figures.id_switches,
        idle=tuple(idle_runs(used) for used in selected.T),
    )


def idle_runs(used: NDArray[np.bool_]) -> tuple[int, ...]:
    """Return the lengths of the runs of slots in which one camera was not selected."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], used, [True]]).astype(np.int8)))
    return tuple(int(length) for length in edges[1::2] - edges[::2])


def recording_of(sources: Sources, asked: Asked) -> Recording:
    """Return the recording to replay."""
    if asked.recording == SHELF:
        assert sources.shelf is not None, "items say what they need"
        return sources.shelf
    if asked.recording == SHELF_FEEDBACK:
        assert sources.feedback is not None, "items say what they need"
        return sources.feedback
    if asked.recording == PIZZA:
        assert sources.pizza is not None, "items say what they need"
        slots = round(asked.seconds * sources.pizza.fps) or sources.pizza.num_slots
        return first_slots(sources.pizza, slots)
    if asked.recording == FRAGMENT:
        assert sources.panoptic is not None, "items say what they need"
        return with_detections(sources.panoptic, asked.seed)
    if asked.recording == MOTION:
        assert sources.motion is not None, "items say what they need"
        slots = round(asked.seconds * sources.motion.fps)
        return with_detections(gathered(sources.motion, 0, slots), asked.seed)
    return _scene(asked.recording, asked.seconds, asked.fps, FIRST_SEED + asked.seed)


FIRST_SEED = 1000  # of simulated scenes: nothing was chosen on them


@lru_cache(maxsize=32)  # seeds of a scene follow each other, in every setting
def _scene(name: str, seconds: float, fps: float, seed: int) -> Recording:
    return simulate(SceneSettings(scene=name, seconds=seconds, fps=fps or None), seed)


def seen_occlusion(recording: Recording) -> Floats:
    """Return `(num_slots, num_cameras)`: eq. (4) of the people that each camera's detector found.

    A slot without a view has occlusion 0.
    """
    values = np.zeros((recording.num_slots, len(recording.rig)))
    for index, camera in enumerate(recording.rig.cameras):
        for slot in range(recording.num_slots):
            view = recording.view(slot, index)
            if view is not None and len(view) > 1:
                boxes = person_boxes(view.keypoints_px, camera.image_size)
                values[slot, index] = occlusion(boxes)
    return values
