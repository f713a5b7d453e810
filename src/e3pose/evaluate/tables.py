"""Figures as tables for a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.table import Table

from e3pose.base.quantities import plural
from e3pose.energy.saving import AGAINST, NO_SAVINGS, whole
from e3pose.evaluate.columns import print_tables, table_console
from e3pose.evaluate.figures import HeldOut, Summary, as_json
from e3pose.model.noises import DEFAULT

if TYPE_CHECKING:
    from rich.console import Console

SAVED = tuple(
    (f"{name} saved %", ("savings", name.replace(" ", "_"), "percent"), 0)
    for name, _ in NO_SAVINGS.named()
)
# Heading, path inside a row, digits. Columns that no row has are left out.
COLUMNS: tuple[tuple[str, tuple[str, ...], int], ...] = (
    ("cameras", ("selection", "mean_cameras"), 2),
    ("PCP 1 %", ("metrics", "pcp", "actor1"), 1),
    ("PCP 2 %", ("metrics", "pcp", "actor2"), 1),
    ("PCP 3 %", ("metrics", "pcp", "actor3"), 1),
    ("PCP avg %", ("metrics", "pcp", "average"), 2),
    ("AP25 %", ("metrics", "ap", "25"), 1),
    ("AP50 %", ("metrics", "ap", "50"), 1),
    ("AP105 %", ("metrics", "ap", "105"), 1),
    ("AP150 %", ("metrics", "ap", "150"), 1),
    ("MPJPE mm", ("metrics", "mpjpe_mm"), 1),
    ("p95 mm", ("metrics", "p95_mm"), 0),
    ("p99 mm", ("metrics", "p99_mm"), 0),
    ("wrong limbs %", ("metrics", "wrong_limbs_percent"), 2),
    ("jitter m/s2", ("metrics", "acceleration_error_mps2"), 2),
    ("recall", ("metrics", "recall_500mm"), 3),
    ("ids", ("identities",), 1),
    ("switches", ("metrics", "id_switches"), 1),
    ("held-out mm", ("held_out", "mean", "median_mm"), 1),
    ("held-out px", ("held_out", "mean", "median_px"), 1),
    ("held-out wrong %", ("held_out", "mean", "wrong_limbs_percent"), 1),
    ("missed %", ("held_out", "mean", "missed_percent"), 1),
    ("unseen %", ("held_out", "mean", "unseen_percent"), 1),
    ("expected mm", ("expected", "error_mm"), 1),
    ("in 90 %", ("expected", "coverage_90"), 1),
    *SAVED,
    ("spread W", ("energy", "watts_spread"), 2),
    ("ms/slot", ("stage_ms", "slot", "median"), 2),
)
HELD_OUT_TITLE = (
    "Distance from the keypoints of cameras that took no part (mm: across the ray). It includes "
    "their own errors, which last: compare replays, not levels"
)
REPROJECTION_TITLE = "Distance of the poses from the keypoints that they are made of: reprojection"
TELLING = 1.5  # how far keypoints may be off what the noise file states, unsaid
FIGURE_NAMES = {
    "cameras": "active cameras per slot, mean",
    "PCP 1 %": "PCP actor 1, %",
    "PCP 2 %": "PCP actor 2, %",
    "PCP 3 %": "PCP actor 3, %",
    "PCP avg %": "PCP average of actors 1-3, %",
    "p95 mm": "95th percentile of joint error, mm",
    "p99 mm": "99th percentile of joint error, mm",
    "wrong limbs %": "limbs turned by over 30 degrees, or 150 mm off at their end, %",
    "jitter m/s2": "acceleration error of the joints, m/s2",
    "recall": "recall within 500 mm",
    "ids": "track IDs assigned",
    "switches": "identity switches of labelled people",
    "held-out mm": "median distance across the rays of held-out cameras, mm",
    "held-out px": "median distance from the keypoints of held-out cameras, px",
    "held-out wrong %": "limbs that held-out cameras see elsewhere, %",
    "missed %": "people whom held-out cameras detect without a pose, %",
    "unseen %": "poses in the image of held-out cameras without a detection, %",
    "expected mm": "expected joint error, mm",
    "in 90 %": "joints inside the 90 % confidence radius, %",
    **{heading: f"{AGAINST.lower()}, modelled, %" for heading, *_ in SAVED},
    "spread W": "spread of mean power over the cameras (standard deviation), W",
    "ms/slot": "edge computing time per slot, median ms",
}


def print_summary(summary: Summary, titles: Mapping[str, str] | None = None) -> None:
    """Print the figures of one replay and what every camera did, by their titles."""
    console = table_console()
    policy = "all cameras" if summary.all_looked else f"policy {summary.policy}"
    title = f"{policy}, {plural(summary.slots, 'slot')}"
    if summary.smooth is not None:
        title += f", smoothed ({summary.smooth})"
    figures = Table(title=title, title_justify="left", show_header=False)
    figures.add_column()
    figures.add_column(justify="right")
    table, apart = as_json(summary), ["held_out", "savings"]  # said below
    apart += ["energy", "selection", "stage_ms"] if summary.all_looked else []
    for heading, path, digits in COLUMNS:
        value = None if path[0] in apart else find(table, path)
        if value is not None:
            shown = str(value) if isinstance(value, int) else f"{value:.{digits}f}"
            figures.add_row(FIGURE_NAMES.get(heading, heading), shown)
    for doubt in summary.doubts:
        console.print(f"Do not trust this: {doubt}", style="red", soft_wrap=True)
    console.print(figures)
    for found, title in (
        (summary.reprojection, REPROJECTION_TITLE),
        (summary.held_out, HELD_OUT_TITLE),
    ):
        if found is not None:
            print_held_out(found, console, title)
    saved = [] if summary.all_looked else [f"{summary.savings.sentence()}."]
    for line in (*saved, *warmup_lines(summary), *noise_lines(summary)):
        console.print(line)
    selection, energy = summary.selection, summary.energy
    if selection is None or energy is None or summary.all_looked:
        return
    cameras = Table(
        title=f"whole cameras, modelled: profile {energy.profile}, {energy.battery_wh:g} Wh",
        title_justify="left",
    )
    cameras.add_column("camera", no_wrap=True)
    for heading in ("active %", "saved %", "mean W", "battery h"):
        cameras.add_column(heading, justify="right")
    for camera_id, share in selection.duty.items():
        figure = energy.cameras[camera_id]
        cameras.add_row(
            (titles or {}).get(camera_id, camera_id),
            f"{100 * share:.1f}",
            str(whole(100 * (1 - figure.mean_watts / figure.active_watts))),
            f"{figure.mean_watts:.2f}",
            f"{figure.battery_hours:.2f}",
        )
    console.print(cameras)


def print_held_out(held_out: HeldOut, console: Console, title: str = HELD_OUT_TITLE) -> None:
    """Print what every held-out camera says, and the mean of several."""
    rows = dict(held_out.cameras)
    if len(rows) > 1:
        rows["mean"] = held_out.mean
    columns = {
        heading: [_number(getattr(row, name)) for row in rows.values()]
        for heading, name in (
            ("median mm", "median_mm"),
            ("mean mm", "mean_mm"),
            ("median px", "median_px"),
            ("mean px", "mean_px"),
            ("wrong limbs %", "wrong_limbs_percent"),
            ("missed %", "missed_percent"),
            ("unseen %", "unseen_percent"),
            ("keypoints", "keypoints"),
        )
    }
    print_tables(console, {"camera": list(rows)}, columns, title, apart=True)


def warmup_lines(summary: Summary) -> list[str]:
    """Return a line on the warm-up if it is a tenth of the run or more, so that means show it."""
    warmup = summary.settings.warmup_slots
    if not summary.slots or 10 * warmup < summary.slots:
        return []
    return [f"warm-up: all cameras are active in the first {plural(warmup, 'slot')}"]


def noise_lines(summary: Summary) -> list[str]:
    """Return a line for each camera whose keypoints are clearly other than files say."""
    noise = summary.noise
    if noise is None:
        return []
    lines = [
        f"{camera_id}: keypoint noise {factor:.1f}x what {noise.file} states"
        for camera_id, factor in noise.factors.items()
        if not 1 / TELLING <= factor <= TELLING
    ]
    if lines and noise.file != DEFAULT and len(lines) > len(noise.factors) / 2:
        lines.append(
            f"are these keypoints of {noise.file}? Name their detector (e3pose import --detector), "
            "or measure its noise (e3pose calibrate noise)"
        )
    return lines


def find(figures: Mapping[str, Any], path: Sequence[str]) -> Any:
    """Return the figure at a path of keys; None where there is none."""
    value: Any = figures
    for key in path:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _number(value: Any) -> str:
    return "-" if value is None else f"{value:.1f}" if isinstance(value, float) else str(value)
