"""Write the report: one self-contained HTML file.

Whatever comes from a recording is text: escaped in HTML, and in scripts only ever JSON in which no
character can end the script. The page's content security policy forbids every request besides.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from types import MappingProxyType
from typing import Any

from e3pose.base.atomic import write_file
from e3pose.evaluate.figures import Summary, settings_json
from e3pose.model.blind_slot import duty
from e3pose.output.report import figures
from e3pose.output.report.film import film
from e3pose.output.report.scene import scene
from e3pose.output.report.summary import budget, cards, headline, sentences, thinning
from e3pose.pipeline import SlotRecord
from e3pose.recording import Recording

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


def write_report(
    recording: Recording,
    records: Sequence[SlotRecord],
    summary: Summary,
    path: Path,
    lead: str | None = None,
    details: Mapping[str, str] = MappingProxyType({}),
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
        details: further rows of the settings, by name.
        folder: of the recording, whose videos are shown beside the player, if it has any.
    """
    text = render(recording, records, summary, lead, details, folder)
    write_file(path, text)


def render(
    recording: Recording,
    records: Sequence[SlotRecord],
    summary: Summary,
    lead: str | None = None,
    details: Mapping[str, str] = MappingProxyType({}),
    folder: Path | None = None,
) -> str:
    """Return the page as text; arguments are those of `write_report`."""
    from plotly.offline import get_plotlyjs

    drawn = scene(recording, records)
    filmed = film(recording, records[:: drawn["stride"]], folder)
    charts = _charts(recording, records, summary, drawn)
    boxes = [f'<div id="{name}"></div>' for name in ("energy", "duty") if name in charts]
    return Template(packaged("page.html")).substitute(
        title=shown_text(recording.name or "Recording"),
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
        truth_box=_truth_box(drawn),
        sure_box=_sure_box(drawn),
        blind_key=BLIND_KEY if drawn["blind"] else "",
        why=WHY if "gain" in drawn else "",
        energy_words=shown_text(_energy_words(summary), 1000),
        energy_boxes="".join(boxes),
        settings=_settings(recording, summary, lead, details),
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
    cameras = recording.rig.camera_ids
    shares = duty(records, len(cameras)).tolist()
    charts = {
        "strips": figures.strips(drawn),
        "energy": summary.energy and figures.energy_bars(summary.energy, cameras),
        "duty": figures.duty_bars(shares, budget(summary, len(cameras)), cameras),
    }
    return {name: chart for name, chart in charts.items() if chart is not None}


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


def _settings(
    recording: Recording, summary: Summary, lead: str | None, details: Mapping[str, str]
) -> str:
    rows: dict[str, Any] = {
        "cameras": ", ".join(recording.rig.camera_ids),
        "slots per second": f"{recording.fps:g}",
        "skeleton": recording.skeleton.name,
    }
    settings = settings_json(summary.settings)
    settings["policy"] = summary.policy
    if lead:
        settings["lead_slots"] = lead
    rows |= {
        SETTING_WORDS[key]: _setting(settings[key]) for key in SETTING_WORDS if key in settings
    }
    rows |= details
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


def _truth_box(drawn: Mapping[str, Any]) -> str:
    if not drawn["truthLimbs"]:
        return ""
    return "<label class='soft'><input type='checkbox' id='truth'> ground truth (grey)</label>"


def _sure_box(drawn: Mapping[str, Any]) -> str:
    if not any(len(person) > 2 for people in drawn["people"] for person in people):
        return ""
    return (
        "<label class='soft'><input type='checkbox' id='sure' checked> discs: 90 % confidence"
        "</label>"
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
