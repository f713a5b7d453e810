"""A run in plain words: the sentences and the figures at the top of the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose.pipeline import SlotRecord
from e3pose.plural import counted
from e3pose.recording import Recording


def number(summary: Mapping[str, Any], *path: str) -> float | None:
    """Return the figure at `path` of a nested summary, or None where there is none."""
    value: Any = summary
    for key in path:
        if not isinstance(value, Mapping) or key not in value:
            return None
        value = value[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def duty(recording: Recording, records: Sequence[SlotRecord]) -> NDArray[np.float64]:
    """Return `(num_cameras,)`: the share of slots each camera was awake."""
    if not records:
        return np.zeros(len(recording.rig))
    return np.asarray(np.stack([record.selected for record in records]).mean(axis=0))


def budget(summary: Mapping[str, Any], num_cameras: int) -> float | None:
    """Return the share of slots a camera could be awake; None without one limit for all."""
    from e3pose.select.policies import POLICIES
    from e3pose.settings.loop import default_budget

    row = POLICIES.get(str(summary.get("policy")))
    asked, count = (
        number(summary, "settings", "budget"),
        number(summary, "settings", "num_selected"),
    )
    settings = summary.get("settings")
    each = settings.get("budget") if isinstance(settings, Mapping) else None
    if isinstance(each, Sequence) or number(summary, "settings", "target_error_m") is not None:
        return asked
    if row is None or not row.budgeted or count is None:
        return asked
    return default_budget(count, num_cameras) if asked is None else asked


def sentences(
    recording: Recording, records: Sequence[SlotRecord], summary: Mapping[str, Any]
) -> list[str]:
    """Say what happened, one thought a sentence; no markup in it."""
    num_cameras = len(recording.rig)
    seconds = len(records) * recording.interval_s
    said = [
        f"{num_cameras} calibrated cameras watched for {counted(len(records), 'slot')} of "
        f"{1000 * recording.interval_s:.3g} ms ({seconds:.1f} s)."
    ]
    if not records:
        return [*said, "There is nothing to show: the recording is empty."]
    counts = [len(record.poses) for record in records]
    share = np.mean(np.array(counts) > 0)
    if max(counts) == 0:
        said.append(
            "Nobody was found in any slot: a person needs to be seen by two awake cameras at once."
        )
    else:
        said.append(
            f"Up to {counted(max(counts), 'person', 'people')} at once stood in 3D, "
            f"somebody in {100 * share:.0f} % of the slots."
        )
    mean = duty(recording, records).sum()
    policy = str(summary.get("policy", ""))
    by = f", chosen by the policy {policy}" if policy else ""
    said.append(f"On average {mean:.1f} of {num_cameras} cameras were awake a slot{by}.")
    saving = number(summary, "energy", "saving_percent")
    device = number(summary, "energy", "device_saving_percent")
    if saving is not None:
        whole = "" if device is None else f", {device:.0f} % of the whole cameras"
        said.append(
            f"Against all cameras always awake this saves {saving:.0f} % of the energy of "
            f"processors, WiFi and memory{whole}."
        )
    notes = summary.get("notes")
    return [*said, *map(str, notes if isinstance(notes, list) else ())]


def cards(
    recording: Recording, records: Sequence[SlotRecord], summary: Mapping[str, Any]
) -> list[tuple[str, str]]:
    """Return the large figures as (value, what it is); one that cannot be had is left out."""
    found: list[tuple[str, str]] = []
    if records:
        mean = duty(recording, records).sum()
        found.append((f"{mean:.1f} of {len(recording.rig)}", "cameras awake a slot, on average"))
    rows = (
        (("energy", "saving_percent"), "{:.0f} %", "energy saved (processors, WiFi, memory)"),
        (("metrics", "pcp", "average"), "{:.1f} %", "PCP, limbs found right (actors 1-3)"),
        (("metrics", "mpjpe_mm"), "{:.0f} mm", "mean joint error (MPJPE)"),
        (("metrics", "recall_500mm"), "{:.3f}", "recall within 500 mm"),
        (("stage_ms", "slot", "median"), "{:.2f} ms", "a slot to compute at the edge (median)"),
    )
    for path, form, meaning in rows:
        value = number(summary, *path)
        if value is not None:
            found.append((form.format(value), meaning))
    return found


def thinning(stride: int, num_slots: int) -> str:
    """Say that the page does not show every slot, if so."""
    if stride == 1:
        return ""
    return (
        f"This run is long: the page shows one in {stride} of its {num_slots} slots. "
        "The figures are of all slots."
    )
