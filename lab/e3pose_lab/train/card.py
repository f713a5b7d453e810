"""The model card: what a network was trained on, how, and how good it is where it never was."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from e3pose.predict.normalise import COMMON_JOINTS
from e3pose_lab.train.validation import Marks
from e3pose_lab.train.windows import Clip

LEADS = (1, 2, 3, 5, 8, 10, 15)
SIMPLE = ("zero velocity", "constant velocity", "damped velocity")

SPOILT = "with and without an estimator's noise and gaps"
MADE: Mapping[object, str] = {  # what windows are made of recorded motion, see `windows.Variety`
    "bodies": f"at a random frame rate, pace, size and side, {SPOILT}",
    "motion": f"at a random frame rate, pace and side, {SPOILT}",
    "none": "as it was recorded",
}


def model_card(
    settings: Mapping[str, object],
    steps: int,
    training: Sequence[Clip],
    validation: Sequence[Clip],
    marks: Sequence[Marks],
) -> str:
    """Return the card as Markdown."""
    made = MADE[settings.get("variety", "bodies")]
    lines = [
        "# Attention-LSTM predictor: model card",
        "",
        "Predicts where a person's joints will be some slots ahead. It is trained for poses of "
        "people in metres with z up, at 5 to 60 slots per second.",
        "",
        f"- joints: {', '.join(name.replace('_', ' ') for name in COMMON_JOINTS)}; "
        "others are carried with the nearest",
        *(f"- {name.replace('_', ' ')}: {value}" for name, value in settings.items()),
        f"- steps trained: {steps}",
        "",
        "## Data",
        "",
        f"Learned from (seconds of motion; every window {made}):",
        "",
        *_seconds(training),
        "",
        "Validated on, never learned from:",
        "",
        *_seconds(validation),
        "",
        "## Figures",
        "",
        "Mean error in mm on motion that was never learned from. Noisy: histories with 35 mm of "
        "noise per joint, most of it lasting 0.1 s and 2.5 s, and 20 % of the joints missing. "
        "These figures also chose the step at which training stopped.",
    ]
    scored = sorted({clip.name.split(",")[0] for clip in training if clip.scored})
    note = f" (learned from scored slots of {', '.join(scored)})" if scored else ""
    for mark in marks:
        leads = [lead for lead in LEADS if lead <= len(mark.error_m)]
        rows = [("attention-LSTM", mark.error_m), *zip(SIMPLE, mark.simple_m, strict=True)]
        lines += [
            "",
            f"### {mark.name}{note}",
            "",
            "| lead | " + " | ".join(map(str, leads)) + " |",
            "|---|" + "---|" * len(leads),
            *(
                f"| {name} | " + " | ".join(f"{1000 * row[n - 1]:.1f}" for n in leads) + " |"
                for name, row in rows
            ),
        ]
    lines += [
        "",
        "Expected errors are put right by a curve per lead, fitted on the same motion.",
        "",
    ]
    return "\n".join(lines)


def _seconds(clips: Sequence[Clip]) -> list[str]:
    """Return a line for every recording: how much of it there is in `clips`, and of what kind."""
    seconds: Counter[str] = Counter()
    for clip in clips:
        name = clip.name.split(",")[0]
        if clip.errors_m is not None:
            name += ", replayed" if clip.replayed else ", as its cameras estimate it"
        name += ", scored slots too" if clip.scored else ""
        seconds[name] += round(len(clip.joints_m) / clip.fps)
    return [f"- {name}: {number} s" for name, number in seconds.items()]
