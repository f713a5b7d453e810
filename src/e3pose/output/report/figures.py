"""Charts of the report as Plotly figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from e3pose.energy.saving import whole
from e3pose.evaluate.figures import Energy

INK = "#1f2937"
PALE = "#e6e9ee"
LOST = "#b91c1c"
BLIND = "#d97706"
FONT = {"family": "system-ui, sans-serif", "size": 13, "color": "#374151"}
# What a camera did: asleep, awake, ordered while no view came, blind (the codes of `scene.py`).
STATE_COLOURS = [
    [0, PALE], [1 / 8, PALE], [1 / 8, INK], [3 / 8, INK], [3 / 8, LOST], [7 / 8, LOST],
    [7 / 8, BLIND], [1, BLIND],
]  # fmt: skip
# One hue each, light to dark, so that they read without colour vision too.
OCCLUSION_COLOURS = [[0, "#f4f1ee"], [0.5, "#d9905a"], [1, "#7c2d12"]]
GAIN_COLOURS = [[0, "#f0f5f1"], [0.5, "#66b08a"], [1, "#0b4f31"]]
DEFICIT_COLOURS = [[0, "#f0f2f8"], [0.5, "#7b8fd0"], [1, "#1e2f7a"]]
STATE_WORDS = {0: "idle", 1: "active", 2: "selected, view lost"}
HEAD_PX = 34  # above each strip, for its title
FOOT_PX = 44  # below the last, for the time axis
GAPS_UNTIL = 160  # slots that are still wide enough for a gap between them


def strips(scene: Mapping[str, Any]) -> dict[str, Any]:
    """Draw cameras over time: selection, expected information if anybody worked it out, predicted
    occlusion, deficit; one axis of time for all.
    """
    cameras: Sequence[str] = scene["cameras"]
    row_px = 22 if len(cameras) <= 8 else 13
    strip_px = row_px * len(cameras)
    rows = [
        ("Active cameras", "states", STATE_COLOURS, 4.0, ""),
        ("Predicted occlusion, overlap of people", "occlusion",
         OCCLUSION_COLOURS, max(0.05, _highest(scene["occlusion"])), ".2f"),
        ("Energy deficit, slots beyond the budget", "deficit",
         DEFICIT_COLOURS, max(1.0, _highest(scene["deficit"])), ".1f"),
    ]  # fmt: skip
    if "gain" in scene:
        title = "Expected information gain, nats per joint"
        rows.insert(1, (title, "gain", GAIN_COLOURS, max(0.1, _highest(scene["gain"])), ".2f"))
    height = len(rows) * (HEAD_PX + strip_px) + FOOT_PX
    inner = height - FOOT_PX
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {
        "height": height,
        "margin": {"l": 110, "r": 70, "t": 0, "b": FOOT_PX},
        "font": FONT,
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "annotations": [],
        "xaxis": {
            "title": {"text": "slot", "standoff": 6},
            "fixedrange": True,
            "showgrid": False,
            "zeroline": False,
            "range": _slot_range(scene),
            "anchor": f"y{len(rows)}",
            "exponentformat": "none",
        },
    }
    for index, (title, key, colours, highest, digits) in enumerate(rows):
        top = 1 - (index * (HEAD_PX + strip_px) + HEAD_PX) / inner
        axis = "" if index == 0 else str(index + 1)
        layout[f"yaxis{axis}"] = {
            "domain": [max(0.0, top - strip_px / inner), top],
            "autorange": "reversed",
            "fixedrange": True,
            "type": "category",
            "showgrid": False,
            "ticks": "",
            "automargin": False,
        }
        layout["annotations"].append(
            {
                "text": title, "x": 0, "y": top, "xref": "paper", "yref": "paper",
                "xanchor": "left", "yanchor": "bottom", "yshift": 3, "showarrow": False,
                "font": {"size": 14, "color": INK},
            }
        )  # fmt: skip
        trace = {
            "type": "heatmap",
            "x": scene["slots"],
            "y": [_short(camera) for camera in cameras],
            "z": scene[key],
            "yaxis": f"y{axis}",
            "xgap": 1 if len(scene["slots"]) <= GAPS_UNTIL else 0,
            "ygap": 2,
            "colorscale": colours,
            "zmin": 0,
            "zmax": highest,
            "hovertemplate": f"%{{y}}, slot %{{x}}: %{{z:{digits}}}<extra></extra>",
            "colorbar": {
                "y": top - strip_px / inner / 2, "len": max(strip_px, 50), "lenmode": "pixels",
                "thickness": 10, "x": 1.01, "nticks": 3, "outlinewidth": 0, "ypad": 0,
            },
        }  # fmt: skip
        if key == "states":
            trace["showscale"] = False
            trace["text"] = _state_words(scene)
            trace["hovertemplate"] = "%{y}, slot %{x}: %{text}<extra></extra>"
        data.append(trace)
    return {"data": data, "layout": layout}


def _state_words(scene: Mapping[str, Any]) -> list[list[str]]:
    """Return in words what each camera did in each slot."""
    return [
        [
            STATE_WORDS.get(int(state), f"blind slot, {scene['blind'].get(slot, '')}")
            for slot, state in zip(scene["slots"], row, strict=True)
        ]
        for row in scene["states"]
    ]


def energy_bars(energy: Energy, cameras: Mapping[str, str]) -> dict[str, Any]:
    """Draw joules spent per camera, titles by id, against always awake."""
    each = [energy.cameras[camera] for camera in cameras]
    spent = [one.energy_j for one in each]
    full = [one.energy_j * one.active_watts / one.mean_watts for one in each]
    saved = [100 * (1 - one.mean_watts / one.active_watts) for one in each]
    names = [_short(title) for title in cameras.values()]
    bars = [
        {
            "type": "bar", "orientation": "h", "y": names, "x": full, "name": "always active",
            "marker": {"color": PALE},
            "hovertemplate": "%{y}: %{x:.1f} J<extra>always active</extra>",
        },
        {
            "type": "bar", "orientation": "h", "y": names, "x": spent, "name": "in this run",
            "marker": {"color": INK}, "width": 0.45,
            "text": [f"−{whole(percent)} %" for percent in saved], "textposition": "inside",
            "constraintext": "none",
            "insidetextanchor": "end", "insidetextfont": {"color": "#fff", "size": 12},
            "hovertemplate": "%{y}: %{x:.1f} J<extra>in this run</extra>",
        },
    ]  # fmt: skip
    return {"data": bars, "layout": _bar_layout(len(cameras), "energy of the whole camera, J")}


def duty_bars(
    duty: Sequence[float], budget: float | None, cameras: Sequence[str]
) -> dict[str, Any]:
    """Draw the share of slots each camera was awake, with the budget as a line if there is one."""
    names = [_short(camera) for camera in cameras]
    shares = [100 * share for share in duty]
    bars = [
        {
            "type": "bar", "orientation": "h", "y": names, "x": [100.0] * len(names),
            "marker": {"color": PALE}, "hoverinfo": "skip", "name": "all slots",
        },
        {
            "type": "bar", "orientation": "h", "y": names, "x": shares, "width": 0.45,
            "marker": {"color": INK}, "text": [f"{share:.0f} %" for share in shares],
            "textposition": "auto", "name": "active", "textfont": {"size": 12},
            "constraintext": "none",
            "hovertemplate": "%{y}: active in %{x:.1f} % of the slots<extra></extra>",
        },
    ]  # fmt: skip
    layout = _bar_layout(len(cameras), "share of slots active, %")
    layout["xaxis"]["range"] = [0, 101]
    if budget is not None:
        line = {"color": LOST, "width": 2, "dash": "dash"}
        layout["shapes"] = [
            {"type": "line", "x0": 100 * budget, "x1": 100 * budget, "y0": 0, "y1": 1,
             "yref": "paper", "line": line}
        ]  # fmt: skip
        layout["annotations"] = [
            {
                "text": f"budget {100 * budget:.0f} %", "x": 100 * budget, "y": 1,
                "yref": "paper", "yanchor": "bottom", "showarrow": False,
                "font": {"color": LOST, "size": 12},
            }
        ]  # fmt: skip
    return {"data": bars, "layout": layout}


def _bar_layout(num_cameras: int, title: str) -> dict[str, Any]:
    row_px = 34 if num_cameras <= 8 else 20
    return {
        "height": 24 + row_px * num_cameras + 48,
        "margin": {"l": 110, "r": 24, "t": 24, "b": 48},
        "font": FONT,
        "barmode": "overlay",
        "bargap": 0.25,
        "showlegend": False,
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "xaxis": {
            "title": {"text": title, "standoff": 8},
            "fixedrange": True,
            "gridcolor": PALE,
            "zeroline": False,
            "rangemode": "tozero",
        },
        "yaxis": {"autorange": "reversed", "fixedrange": True, "type": "category"},
    }


def _highest(rows: Sequence[Sequence[float | None]]) -> float:
    return max((v for row in rows for v in row if v is not None), default=0.0)


def _short(camera_id: str) -> str:
    """Return a camera's name in the width there is; the id itself is at most 64 characters."""
    return camera_id if len(camera_id) <= 14 else f"{camera_id[:6]}…{camera_id[-7:]}"


def _slot_range(scene: Mapping[str, Any]) -> list[float]:
    slots, half = scene["slots"], scene["stride"] / 2
    return [slots[0] - half, slots[-1] + half] if slots else [0, 1]
