"""Verbs of the lab, which measures, reproduces and trains, and of the hub of many sites.

A site is installed without either. Their packages are named here, the lab's also in
`e3pose.edge.learn.trainer`, and imported nowhere else.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Annotated

from cyclopts import App, Parameter

LAB, HUB = "e3pose_lab", "e3pose_hub"
INSTALLED = importlib.util.find_spec(LAB) is not None
# Each verb as `module:name` in the lab's `cli`, and what help says of it without the lab.
LAB_VERBS = {
    "evaluate": ("evaluating:evaluate", "Compare policies on a recording."),
    "evaluate-predictor": ("predicting:evaluate_predictor", "Evaluate motion predictors."),
    "reproduce": ("reproducing:reproduce", "Redo the tables and figures of the paper."),
    "each": ("eaching:each", "Run a verb over many recordings."),
    "train": ("training:train", "Train the motion predictor."),
    "learn": ("learning:learn_app", "Train the predictor online; its versions."),
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


def lab_verb(verb: str) -> str | Callable[..., None]:
    """Return where a verb of the lab is, or a function in its place that says what to install."""
    place, what = LAB_VERBS[verb]
    return f"{LAB}.cli.{place}" if INSTALLED else _absent(what)


def with_lab(verb: str, place: str) -> str:
    """Return where an app of verbs is, `module:name`: with those of the lab, if it is installed."""
    return f"{LAB}.cli.{place.rpartition('.')[2]}" if INSTALLED and verb in BELOW else place


def add_absent(app: App) -> None:
    """Give an app the verbs of a lab that is not installed; they say what to install."""
    if not INSTALLED:
        for name, what in BELOW[app.name[0]].items():
            app.command(_absent(what), name=name)


def hub_verb() -> str | Callable[..., None]:
    """Return where the verbs of the hub are, or a function in their place."""
    if importlib.util.find_spec(HUB) is not None:
        return f"{HUB}.cli:hub_app"
    return _absent("Gather the summaries of many sites.", HUB, "hub")


def _absent(what: str, package: str = LAB, extra: str = "lab") -> Callable[..., None]:
    """Return a verb that takes anything and fails."""

    def verb(*words: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)]) -> None:
        raise ModuleNotFoundError(name=package)

    verb.__doc__ = f"{what} Not installed: pip install 'e3pose[{extra}]'."
    return verb
