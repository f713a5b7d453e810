"""Write the report: one self-contained HTML file, with a summary and the pictures of cameras.

Whatever comes from a recording is text: escaped in HTML, and in scripts only ever JSON in which no
character can end the script. The page's content security policy forbids every request besides.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from e3pose.base.atomic import write_file
from e3pose.base.errors import InputError
from e3pose.base.installing import not_installed
from e3pose.base.quantities import plural
from e3pose.base.threads import in_order
from e3pose.camera.provenance import Provenance, load_provenance
from e3pose.energy.saving import NO_SAVINGS, whole
from e3pose.evaluate.figures import Distances, Summary, settings_json
from e3pose.model.blind_slot import blind_words, count_blind, duty
from e3pose.output.report import figures
from e3pose.output.report.overlay import overlay_images
from e3pose.output.report.scene import scene
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording
from e3pose.select.policies import Promise
from e3pose.settings.parts import row_of

MAX_TEXT = 300  # characters of a name or description
# What settings are called in the page; those that are not here say little to most readers.
SETTING_WORDS = {
    "pipeline": "estimator",
    "policy": "policy",
    "num_selected": "cameras per slot (C)",
    "budget": "energy budget, share of slots (E)",
    "quality_weight": "quality weight (V)",
    "lead_slots": "lead, slots",
    "warmup_slots": "warm-up, slots (M)",
    "predictor": "predictor",
    "reject_outliers": "outlier rejection",
    "seed": "random seed",
    "smooth": "smoothing",
}
TRUTH_BOX = "<label class='soft'><input type='checkbox' id='truth'> ground truth (grey)</label>"
SURE_BOX = (
    "<label class='soft'><input type='checkbox' id='sure' checked> discs: 90 % confidence</label>"
)
OF_SELECTION = ("policy", "num_selected", "budget", "quality_weight", "lead_slots", "warmup_slots")
BLIND_KEY = (
    " &nbsp; <i class='swatch' style='background:var(--blind)'></i>blind slot: no view arrived"
)
# Filled in by player.js.
WHY = (
    "<div class='soft'>Selection: information gain (nats per joint) and energy price</div>"
    "<table id='why'><thead><tr><th>camera</th><th>gain</th><th>price</th></tr></thead>"
    "<tbody></tbody></table><p class='soft' id='expected'></p>"
)
# The characters that could end a script or start a comment in it, written as JSON escapes.
SCRIPT_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}
MOST_CAMERAS = 2  # those that looked most
MOST_IMAGES = 500  # of all cameras: some 8 MB of page
LONG_SIDE_PX, QUALITY = 480, 70  # of JPEG


def write_report(
    recording: Recording,
    records: Sequence[SlotRecord],
    summary: Summary,
    path: Path,
    lead: str | None = None,
    folder: Path | None = None,
) -> None:
    """Write the page that shows a run to `path`.

    Args:
        recording: what was replayed.
        records: one per slot, in order.
        summary: the figures of `evaluate.summary.summarise`; absent ones are left out of the page.
        path: the `.html` file to write, replaced if it exists.
        lead: what the page says of the lead where it changed during the run; that of the
            settings by default.
        folder: of the recording, whose videos are shown beside the player, if it has any.
    """
    write_file(path, render(recording, records, summary, lead, folder))


def render(
    recording: Recording,
    records: Sequence[SlotRecord],
    summary: Summary,
    lead: str | None = None,
    folder: Path | None = None,
) -> str:
    """Return the page as text; arguments are those of `write_report`."""
    from plotly.offline import get_plotlyjs

    drawn = scene(recording, records)
    filmed = film(recording, records[:: drawn["stride"]], folder)
    charts = _charts(recording, records, summary, drawn)
    sure = any(len(person) > 2 for people in drawn["people"] for person in people)
    return Template(packaged("page.html")).substitute(
        title=shown_text(recording.name or "Recording"),
        doubts="".join(
            f"<p class='doubt'>Do not trust this: {shown_text(each)}</p>" for each in summary.doubts
        ),
        headline=shown_text(" ".join(headline(recording, records, summary)), 1000),
        sentences="".join(
            f"<p class='soft'>{shown_text(' '.join(said), 2000)}</p>"
            for said in (sentences(recording, records, summary), summary.notes)
        ),
        thinning=f"<p class='soft'>{thinning(drawn['stride'], drawn['numSlots'])}</p>",
        cards="".join(
            f"<div><b>{shown_text(value)}</b><span>{shown_text(meaning)}</span></div>"
            for value, meaning in cards(recording, records, summary)
        ),
        cell=_cell(drawn),
        film_box=_film_box(filmed),
        film=embed(filmed),
        truth_box=TRUTH_BOX if drawn["truthLimbs"] else "",
        sure_box=SURE_BOX if sure else "",
        selection="hidden" if summary.all_looked else "",
        blind_key=BLIND_KEY if drawn["blind"] else "",
        why=WHY if "gain" in drawn else "",
        quality=_quality(summary),
        energy="" if summary.all_looked else _energy(summary, charts),
        settings=_settings(recording, summary, lead),
        source=shown_text(recording.source),
        data=embed(drawn),
        figures=embed(charts),
        scene=packaged("scene.js"),
        player=packaged("player.js"),
        charts=packaged("charts.js"),
        plotly=get_plotlyjs(),
    )


def embed(value: Any) -> str:
    """Return `value` as JSON that may stand inside a script element whatever strings are in it."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    return text.translate(SCRIPT_ESCAPES)


def _charts(
    recording: Recording,
    records: Sequence[SlotRecord],
    summary: Summary,
    drawn: Mapping[str, Any],
) -> dict[str, Any]:
    if not records:
        return {}
    cameras = recording.rig.titles
    shares = duty(records, len(cameras)).tolist()
    charts = {
        "strips": None if summary.all_looked else figures.strips(drawn),
        "energy": summary.energy and figures.energy_bars(summary.energy, cameras),
        "duty": figures.duty_bars(shares, budget(summary, len(cameras)), [*cameras.values()]),
    }
    return {name: chart for name, chart in charts.items() if chart is not None}


def _energy(summary: Summary, charts: Mapping[str, Any]) -> str:
    boxes = [f'<div id="{name}"></div>' for name in ("energy", "duty") if name in charts]
    words = shown_text(_energy_words(summary), 1000)
    return (
        f"<section><h2>Energy per camera</h2><p class='soft'>{words}</p>"
        f"<div class='two'>{''.join(boxes)}</div></section>"
    )


def _quality(summary: Summary) -> str:
    """Return how good the poses are: by camera, by joint, and as the estimator states it."""
    used, apart = summary.reprojection, summary.held_out
    if used is None:
        return ""
    held_out = {} if apart is None else apart.cameras
    heads = ("camera", "reprojection, px", "held out, px", "held out, mm", "left out, %")
    by_camera = []
    for name, one in used.cameras.items():
        judge = held_out.get(name, Distances())
        figures = (one.median_px, judge.median_px, judge.median_mm, one.missed_percent)
        by_camera.append((name, *map(_figure, figures)))
    cameras = _table(heads, by_camera)
    joints = {} if apart is None else apart.mean.joints
    rows = [(name, _figure(one.median_mm)) for name, one in joints.items() if one.keypoints]
    by_joint = _table(("joint", "held out, mm"), rows) if rows else ""
    stated = summary.expected.error_mm
    words = (
        "Medians. Reprojection: how far the poses are from the keypoints that they are made of. "
        "Held out: the same, from poses that were made without this camera; mm are across its "
        "rays, and its own errors count too. Left out: people whom the camera detected, and who "
        "have no pose."
    )
    words += f" The estimator itself expects {stated:.0f} mm." if stated is not None else ""
    return (
        f"<section class='quality'><h2>How good it is</h2><p class='soft'>{words}</p>"
        f"<div class='two'><div>{cameras}</div><div>{by_joint}</div></div></section>"
    )


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = ["".join(f"<td>{shown_text(cell)}</td>" for cell in row) for row in rows]
    head = "".join(f"<th>{each}</th>" for each in heads)
    return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"


def _energy_words(summary: Summary) -> str:
    energy = summary.energy
    if energy is None:
        return "Share of slots in which each camera was active, blind slots left out."
    hours = [round(camera.battery_hours, 1) for camera in energy.cameras.values()]
    lasts = " to ".join(f"{each:.1f}" for each in sorted({min(hours), max(hours)}))
    whole = summary.savings.whole_camera
    by = f"Modelled with the power profile {energy.profile}"
    if whole is not None and whole.basis == "measured":
        by = "Learned from the cameras' power meters"
    return (
        f"Bars: energy of each whole camera in this run; behind them: the same camera always "
        f"active. {by}; cameras that are not selected are in {energy.idle_mode} mode. "
        f"A {energy.battery_wh:g} Wh battery lasts {lasts} h "
        f"instead of {energy.battery_hours_always_active:.1f} h."
    )


def _settings(recording: Recording, summary: Summary, lead: str | None) -> str:
    rows: dict[str, Any] = {
        "cameras": ", ".join(recording.rig.titles.values()),
        "slots per second": f"{recording.fps:g}",
        "skeleton": recording.skeleton.name,
    }
    settings = settings_json(summary.settings)
    settings["policy"] = summary.policy
    if lead:
        settings["lead_slots"] = lead
    left_out = OF_SELECTION if summary.all_looked else ()
    rows |= {
        words: _setting(settings[key])
        for key, words in SETTING_WORDS.items()
        if key in settings and key not in left_out
    }
    return "".join(
        f"<tr><td class='soft'>{shown_text(key)}</td><td>{shown_text(value, 2000)}</td></tr>"
        for key, value in rows.items()
    )


def _setting(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _film_box(filmed: Mapping[str, Any] | None) -> str:
    if filmed is None:
        return ""
    if "why" in filmed:
        return f"<div id='film-box' class='soft'>No pictures: {shown_text(filmed['why'])}</div>"
    options = "".join(f"<option>{shown_text(name)}</option>" for name in filmed["cameras"])
    return (
        "<div id='film-box'><img id='film' alt=''><label class='soft'>camera "
        f"<select id='film-of'>{options}</select></label></div>"
    )


def _cell(drawn: Mapping[str, Any]) -> str:
    size = max(high - low for low, high in zip(drawn["low"], drawn["high"], strict=True))
    return f"{max(1, -(-size // 30_000))} m"  # as `drawFloor` of scene.js


def shown_text(value: object, most: int = MAX_TEXT) -> str:
    """Return a value as text of a page: escaped, and cut where it is too long."""
    text = str(value)
    return escape(text if len(text) <= most else text[: most - 1] + "…")


def packaged(name: str) -> str:
    """Return a file that is part of the reports."""
    return resources.files("e3pose.output.report").joinpath(name).read_text(encoding="utf-8")


def film(
    recording: Recording, shown: Sequence[SlotRecord], folder: Path | None
) -> dict[str, Any] | None:
    """Return pictures of the cameras that looked most; None where nothing was filmed.

    Args:
        recording: with videos or without.
        shown: the slots that the page shows, in order.
        folder: the recording's, for videos that stand in it; None of one that has none.

    Returns:
        `cameras`; `at`, for each picture the index of its slot among those shown; `jpeg`, for each
        camera its pictures as base64. Where videos cannot be read, `why` alone.
    """
    shares = duty(shown, len(recording.rig)) if shown else np.zeros(len(recording.rig))
    order = [recording.rig.camera_ids[index] for index in np.argsort(-shares, kind="stable")]
    chosen = [name for name in order if name in recording.videos][:MOST_CAMERAS]
    if not chosen or not shown:
        return None
    count = min(len(shown), MOST_IMAGES // len(chosen))
    at = np.unique(np.linspace(0, len(shown) - 1, count).round().astype(int)).tolist()
    try:
        slots = [shown[i] for i in at]
        made = in_order(lambda name: _pictures(recording, slots, folder, name), chosen, len(chosen))
        pictures = list(made)
    except InputError as error:
        return {"why": str(error.elsewhere())}
    except ModuleNotFoundError as error:
        return {"why": not_installed(error.name, "camera")}
    return {"cameras": [recording.rig.titles[name] for name in chosen], "at": at, "jpeg": pictures}


def _pictures(
    recording: Recording, slots: Sequence[SlotRecord], folder: Path | None, name: str
) -> list[str]:
    import cv2

    made, noted = [], Provenance() if folder is None else load_provenance(folder)
    width, height = recording.rig.cameras[recording.rig.index(name)].image_size
    height_px = round(LONG_SIDE_PX * min(1.0, height / width))
    for image in overlay_images(
        recording, slots, folder, height_px, provenance=noted, cameras=[name]
    ):
        _, jpeg = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        made.append(base64.b64encode(jpeg.tobytes()).decode())
    return made


def budget(summary: Summary, num_cameras: int) -> float | None:
    """Return the share of slots a camera may be active; None without one limit for all."""
    asked = summary.settings.budget
    if asked is None and Promise.BUDGET in row_of(summary.settings).promises:
        asked = summary.settings.share(num_cameras)
    return asked if isinstance(asked, float | int) else None


def headline(recording: Recording, records: Sequence[SlotRecord], summary: Summary) -> list[str]:
    """Say in two sentences who was there and what it cost; no markup."""
    if not records:
        return ["The recording is empty.", "There is nothing to show."]
    minutes, seconds = divmod(len(records) * recording.interval_s, 60)
    long = f"{minutes:.0f} min {seconds:.0f} s" if minutes else f"{seconds:.1f} s"
    counts = [len(record.people) for record in records]
    num_cameras = len(recording.rig)
    who = "Nobody was" if max(counts) == 0 else f"Up to {plural(max(counts), 'person', 'people')}"
    seen = "found" if max(counts) == 0 else f"followed in {plural(num_cameras, 'camera')}"
    mean = duty(records, num_cameras).sum()
    if summary.all_looked:
        return [f"{who} {seen}, for {long}.", "All cameras were active in every slot."]
    looked = f"On average {mean:.1f} of {num_cameras} cameras were active."
    saved = "" if summary.savings == NO_SAVINGS else f" {summary.savings.sentence()}."
    return [f"{who} {seen}, for {long}.", f"{looked}{saved}"]


def sentences(recording: Recording, records: Sequence[SlotRecord], summary: Summary) -> list[str]:
    """Say what the headline does not, without the notes of the run; no markup."""
    policy = "" if summary.all_looked else f", policy {summary.policy}"
    said = [f"{plural(len(records), 'slot')} of {1000 * recording.interval_s:.3g} ms{policy}."]
    if share := np.mean([len(record.people) > 0 for record in records] or [False]):
        said.append(f"People present in {100 * share:.0f} % of the slots.")
    elif records:
        said.append(
            "No people found: a new person must be detected by two cameras at nearly the same time."
        )
    if blind := count_blind(records):
        count = sum(blind.values())
        said.append(
            f"In {count} of {plural(len(records), 'slot')} ({100 * count / len(records):.0f} %) no "
            f"view arrived ({blind_words(blind)}): these blind slots are no rest, and are left out "
            "of the shares and savings."
        )
    return said


def cards(
    recording: Recording, records: Sequence[SlotRecord], summary: Summary
) -> list[tuple[str, str]]:
    """Return the large figures as (value, name); unknown ones are left out."""
    found: list[tuple[str, str]] = []
    if records:
        mean = duty(records, len(recording.rig)).sum()
        looked = f"{mean:.1f} of {len(recording.rig)}"
        found += [] if summary.all_looked else [(looked, "active cameras per slot, mean")]
        if blind := sum(count_blind(records).values()):
            found.append((f"{blind} of {len(records)}", "blind slots: no view arrived"))
    for name, saved in summary.savings.named():
        if saved is not None and not summary.all_looked:
            found.append((f"{whole(saved.percent)} %", f"{name} saved ({saved.basis})"))
    metrics = summary.metrics
    slot_ms = None if summary.all_looked else summary.stage_ms.get("slot")
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
