"""Verbs of other distributions: the lab, which measures and trains, and the hub of many sites.

A site is installed without either. Their packages are named here, the lab's also in
`e3pose.edge.learn.trainer`, and imported nowhere else.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Annotated

from cyclopts import App, Parameter

LAB, HUB = "e3pose_lab", "e3pose_hub"
EXTRAS = {LAB: "lab", HUB: "hub"}  # and the extra that brings each
INSTALLED = {name for name in EXTRAS if importlib.util.find_spec(name) is not None}
# Each verb: its package, `module:name` in that, and its help where that is not installed.
VERBS = {
    "evaluate": (LAB, "cli.evaluating:evaluate", "Compare policies on a recording."),
    "evaluate-predictor": (LAB, "cli.predicting:evaluate_predictor", "Evaluate motion predictors."),
    "reproduce": (LAB, "cli.reproducing:reproduce", "Redo the tables and figures of the paper."),
    "each": (LAB, "cli.eaching:each", "Run a verb over many recordings."),
    "train": (LAB, "cli.training:train", "Train the motion predictor."),
    "learn": (LAB, "cli.learning:learn_app", "Train the predictor online; its versions."),
    "hub": (HUB, "cli:hub_app", "Gather the summaries of many sites."),
}
# Verbs of the lab below one of the product: its module of that name in the lab's `cli` adds them.
BELOW = {
    "import": {
        "shelf": "Import the Shelf sequence.",
        "campus": "Import the Campus sequence.",
        "human36m": "Import a sequence of Human3.6M.",
        "panoptic": "Import a CMU Panoptic sequence.",
        "cmu": "Import CMU motion capture clips.",
        "bvh": "Import motion capture from a BVH file.",
    },
    "calibrate": {"noise": "Measure keypoint noise against detection score."},
}


def other_verb(verb: str) -> str | Callable[..., None]:
    """Return where a verb is, or a function in its place that says what to install."""
    package, place, what = VERBS[verb]
    return f"{package}.{place}" if package in INSTALLED else _absent(what, package)


def with_lab(verb: str, place: str) -> str:
    """Return where an app of verbs is, `module:name`: with those of the lab, if it is installed."""
    return f"{LAB}.cli.{place.rpartition('.')[2]}" if LAB in INSTALLED and verb in BELOW else place


def add_absent(app: App) -> None:
    """Give an app the verbs of a lab that is not installed; they say what to install."""
    if LAB not in INSTALLED:
        for name, what in BELOW[app.name[0]].items():
            app.command(_absent(what, LAB), name=name)


def _absent(what: str, package: str) -> Callable[..., None]:
    """Return a verb that takes anything and fails."""

    def verb(*words: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)]) -> None:
        raise ModuleNotFoundError(name=package)

    verb.__doc__ = f"{what} Not installed (extra `{EXTRAS[package]}`)."
    return verb
