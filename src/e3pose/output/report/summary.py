"""The summary of a report: sentences and headline figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from e3pose.base.quantities import plural
from e3pose.energy.saving import NO_SAVINGS, whole
from e3pose.evaluate.figures import Summary
from e3pose.model.blind_slot import blind_words, count_blind, duty
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording
from e3pose.select.policies import Promise
from e3pose.settings.parts import row_of


def budget(summary: Summary, num_cameras: int) -> float | None:
    """Return the share of slots a camera may be active; None without one limit for all."""
    asked = summary.settings.budget
    if asked is None and Promise.BUDGET in row_of(summary.settings).promises:
        asked = summary.settings.share(num_cameras)
    return asked if isinstance(asked, float | int) else None


def headline(recording: Recording, records: Sequence[SlotRecord], summary: Summary) -> list[str]:
    """Say in two sentences who was there and what it took; no markup."""
    if not records:
        return ["The recording is empty.", "There is nothing to show."]
    minutes, seconds = divmod(round(len(records) * recording.interval_s), 60)
    long = f"{minutes} min {seconds} s" if minutes else f"{seconds} s"
    counts = [len(record.people) for record in records]
    num_cameras = len(recording.rig)
    who = "Nobody was" if max(counts) == 0 else f"Up to {plural(max(counts), 'person', 'people')}"
    seen = "found" if max(counts) == 0 else f"followed in {plural(num_cameras, 'camera')}"
    mean = duty(records, num_cameras).sum()
    looked = f"On average {mean:.1f} of {num_cameras} cameras were active."
    saved = "" if summary.savings == NO_SAVINGS else f" {summary.savings.sentence()}."
    return [f"{who} {seen}, for {long}.", f"{looked}{saved}"]


def sentences(recording: Recording, records: Sequence[SlotRecord], summary: Summary) -> list[str]:
    """Say what happened, one thought per sentence, without the notes of the run; no markup."""
    num_cameras = len(recording.rig)
    seconds = len(records) * recording.interval_s
    said = [
        f"{num_cameras} calibrated cameras, {plural(len(records), 'slot')} of "
        f"{1000 * recording.interval_s:.3g} ms ({seconds:.1f} s)."
    ]
    if not records:
        return [*said, "The recording is empty."]
    counts = [len(record.people) for record in records]
    share = np.mean(np.array(counts) > 0)
    if max(counts) == 0:
        said.append(
            "No people found: a new person must be detected by two cameras at nearly the same time."
        )
    else:
        said.append(
            f"Up to {plural(max(counts), 'person', 'people')} at a time; "
            f"people present in {100 * share:.0f} % of the slots."
        )
    if blind := count_blind(records):
        count = sum(blind.values())
        said.append(
            f"In {count} of {plural(len(records), 'slot')} ({100 * count / len(records):.0f} %) no "
            f"view arrived ({blind_words(blind)}): these blind slots are no rest, and are left out "
            "of the shares and savings."
        )
    mean = duty(records, num_cameras).sum()
    by = f" (policy {summary.policy})"
    said.append(f"On average {mean:.1f} of {num_cameras} cameras are active per slot{by}.")
    return said


def cards(
    recording: Recording, records: Sequence[SlotRecord], summary: Summary
) -> list[tuple[str, str]]:
    """Return the large figures as (value, what it is); one that cannot be had is left out."""
    found: list[tuple[str, str]] = []
    if records:
        mean = duty(records, len(recording.rig)).sum()
        found.append((f"{mean:.1f} of {len(recording.rig)}", "active cameras per slot, mean"))
        if blind := sum(count_blind(records).values()):
            found.append((f"{blind} of {len(records)}", "blind slots: no view arrived"))
    for name, saved in summary.savings.named():
        if saved is not None:
            found.append((f"{whole(saved.percent)} %", f"{name} saved ({saved.basis})"))
    metrics, slot_ms = summary.metrics, summary.stage_ms.get("slot")
    pcp = None if metrics.pcp is None else metrics.pcp.actors.get("average")
    held_out = summary.held_out
    for value, form, meaning in (
        (pcp, "{:.1f} %", "PCP, correct limbs (actors 1-3)"),
        (metrics.mpjpe_mm, "{:.0f} mm", "mean joint error (MPJPE)"),
        (metrics.recall_500mm, "{:.3f}", "recall within 500 mm"),
        (held_out and held_out.mean.median_mm, "{:.0f} mm", "from held-out cameras, median"),
        (slot_ms and slot_ms.median, "{:.2f} ms", "edge computing time per slot, median"),
    ):
        if value is not None:
            found.append((form.format(value), meaning))
    return found


def thinning(stride: int, num_slots: int) -> str:
    """Say that the page does not show every slot, if so."""
    if stride == 1:
        return ""
    return (
        f"Long run: the page shows one in {stride} of {num_slots} slots. "
        "The figures include all slots."
    )
