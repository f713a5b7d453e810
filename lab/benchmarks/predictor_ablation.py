"""What every change to the paper's motion predictor is worth, from the published one on.

    python lab/benchmarks/predictor_ablation.py OUT --mocap cmu_mocap_train_30fps.npz --steps 2000

Trains one network a row, all on the same motion for the same number of steps, and prints the mean
error in mm on clips that none learned from. The paper's expanded data need cameras: simulated
detectors of five cameras look at CMU motion capture and at simulated people, and every combination
of the cameras estimates them. What is in OUT already is not made or trained again.
"""

from __future__ import annotations

import argparse
import hashlib
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CLIPS = (
    "01_01", "01_02", "01_03", "01_04", "01_05", "01_08", "01_09", "01_10", "01_11", "01_12",
    "02_01", "02_03", "02_05", "02_06", "02_08", "02_10",
)  # fmt: skip
HELD_OUT = ("01_06", "01_14", "02_02", "02_07")
SCENES = (("ring", 711), ("meeting", 712), ("crossing", 713))
SECONDS, FPS = 45.0, 30.0
LEADS = (1, 3, 5, 10, 15)


@dataclass(frozen=True, slots=True)
class Variant:
    """A row of the table.

    Attributes:
        about: what is new in it.
        published: fields of `NetworkSettings` that differ from the paper's.
        loss: of `TrainSettings`.
        target: `estimates` is the expanded data with what all cameras say as target,
            `least-occluded` with what the three with the least occlusion say, `truth` motion spoilt
            at random.
        variety: what windows are made of recorded motion, see `windows.Variety`.
    """

    about: str
    parts: dict[str, Any]
    loss: Any = "relative"
    target: str = "estimates"
    variety: Any = "bodies"


PLACES = {"displaces": False}
CONTEXT = {**PLACES, "context": True}
MOVES = {**CONTEXT, "moves": True}
SMOOTHS = {**MOVES, "smooths": True}
EXPERTS = {**SMOOTHS, "experts": 10}
VARIANTS = {
    "literal": Variant("the paper's network, eq. (6), its expanded training set as it is",
                       PLACES, "squared", variety="none"),
    "displaced": Variant("the same, with displacements from the regressor", {}, "squared",
                         variety="none"),
    "paper": Variant("+ error relative to a simple predictor's, other rates and paces: "
                     "`attention-lstm-paper`", {}, variety="motion"),
    "live": Variant("the same, at what the three cameras with the least occlusion say: "
                    "`e3pose train --published`", {}, target="least-occluded", variety="motion"),
    "published": Variant("places, eq. (6), expanded data of other rates, paces and bodies",
                         PLACES, "squared"),
    "relative": Variant("error relative to a simple predictor's in place of eq. (6)", PLACES),
    "context": Variant("+ motions, gaps, speed, slot length, roughness as inputs", CONTEXT),
    "moves": Variant("+ a decoder that moves joints on, and states its error", MOVES),
    "smooths": Variant("+ motions smoothed over the history", SMOOTHS),
    "experts": Variant("+ experts for noise", EXPERTS),
    "truth": Variant("true motion, spoilt at random, in place of expanded data", EXPERTS,
                     target="truth"),
}  # fmt: skip


def recordings(out: Path, mocap: Path) -> tuple[list[Any], list[Any]]:
    """Return what is learned from and what is held out; made once, and kept in `out`."""
    from e3pose.recording import load_recording, save_recording
    from e3pose.recording.datasets.motion import import_cmu
    from e3pose.simulate import SceneSettings, simulate
    from e3pose_lab.train.watched import watched

    found: list[list[Any]] = [[], []]
    for side, clips in enumerate((CLIPS, HELD_OUT)):
        for number, clip in enumerate(clips):
            place = out / "recordings" / clip
            if not place.exists():
                recording = import_cmu(mocap, clip)
                save_recording(watched(recording, 700 + number), place)
            found[side].append(load_recording(place))
    for scene, seed in SCENES:
        place = out / "recordings" / scene
        if not place.exists():
            settings = SceneSettings(scene=scene, people=6, seconds=SECONDS, fps=FPS, cameras=5)
            save_recording(simulate(settings, seed), place)
        found[0].append(load_recording(place))
    return found[0], found[1]


def clips_of(
    recording: Any, target: Any, shortest: int, place: Path, combinations: int | None = None
) -> list[Any]:
    """Return the clips that a recording teaches; kept in `place`, for the fusing takes minutes.

    Of each slot, so many combinations of cameras are fused; all without a number.
    """
    from e3pose_lab.train.estimates import EstimateSettings
    from e3pose_lab.train.training_clips import ClipSettings, training_clips
    from e3pose_lab.train.windows import Clip
    from e3pose_lab.workers import Workers

    path = place / f"{recording.name.replace(' ', '-')}-{target}.npz"
    if not path.exists():
        settings = ClipSettings(target=target)
        if combinations is not None:
            settings = replace(settings, estimates=EstimateSettings(combinations=combinations))
        made = training_clips(recording, shortest, settings, Workers())
        arrays: dict[str, Any] = {}
        for number, clip in enumerate(made):
            arrays[f"{number}.joints_m"] = clip.joints_m
            if clip.errors_m is not None:
                arrays[f"{number}.errors_m"] = clip.errors_m
        place.mkdir(parents=True, exist_ok=True)
        np.savez(path, names=np.array([clip.name for clip in made]), **arrays)
        print(path.name, flush=True)
    with np.load(path, allow_pickle=False) as known:
        return [
            Clip(
                str(name), known[f"{number}.joints_m"], recording.fps,
                errors_m=known.get(f"{number}.errors_m"),
            )
            for number, name in enumerate(known["names"])
        ]  # fmt: skip


class Lessons:
    """Clips to learn from and groups held out, by target."""

    def __init__(self, out: Path, mocap: Path, shortest: int, combinations: int | None) -> None:
        self.recordings = recordings(out, mocap)
        self.place = out / f"clips{combinations or ''}"
        self.shortest, self.combinations = shortest, combinations

    def of(self, target: str) -> Any:
        """Return the clips, and the named groups of those held out."""
        from e3pose_lab.train.clips import gather

        return gather(
            *self.recordings, 0.0, self.shortest,
            lambda recording, shortest: clips_of(
                recording, target, shortest, self.place, self.combinations
            ),
        )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("out", type=Path)
    parser.add_argument("--mocap", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--batch", type=int, default=32)
    parser.add_argument("--minutes", type=float, default=math.inf, help="of learning, at most")
    parser.add_argument("--train-only", action="store_true", help="print no table")
    parser.add_argument("--only", help="rows, comma-separated; NAME=STEPS for other steps")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--combinations", type=int, help="of cameras that are fused per slot; default: all"
    )
    parser.add_argument("--start", type=Path, help="weights to go on from, at half the rate")
    options = parser.parse_args()
    import torch

    from e3pose.base.bounded import read_bytes
    from e3pose_lab.train.attention_lstm import TrainSettings, train
    from e3pose_lab.train.network import NetworkSettings
    from e3pose_lab.train.validation import examine, make_exams
    from e3pose_lab.train.weights import network_of

    torch.set_num_threads(1)
    usual = TrainSettings(
        network=NetworkSettings(dropout=0.3),
        batch=options.batch,
        seed=options.seed,
        minutes=options.minutes,
    )
    slots, leads = usual.network.history_slots, usual.num_leads
    known = Lessons(options.out, options.mocap, slots + leads, options.combinations)
    asked = [text.partition("=") for text in (options.only or ",".join(VARIANTS)).split(",")]
    rows = []
    for name, _, number in asked:
        variant, steps = VARIANTS[name], int(number or options.steps)
        place = options.out / f"{name}-{steps}x{options.batch}-{options.seed}"
        rows.append(
            (f"{variant.about} ({steps} batches of {options.batch})", place / "attention-lstm.onnx")
        )
        if not rows[-1][1].exists():
            network = replace(usual.network.as_published(), **variant.parts)
            settings = replace(
                usual, network=network, loss=variant.loss, steps=steps, variety=variant.variety
            )
            start = None
            if options.start is not None:
                content = read_bytes(options.start, 2**26)
                start, _ = network_of(content, str(options.start))
                digest = hashlib.sha256(content).hexdigest()[:12]
                settings = replace(
                    settings, learning_rate=settings.learning_rate / 2,
                    started_from=f"{options.start.name}, sha256 {digest}",
                )  # fmt: skip
            learned, held_out = known.of(variant.target)
            train(learned, held_out, place, settings, start=start)
            print(rows[-1][1], flush=True)
    if options.train_only:
        return
    exams = [
        exam
        for target in ("truth", "estimates")
        for exam in make_exams(known.of(target)[1], slots, leads)
        if "slots per second" not in exam.name
    ]
    for exam in exams:
        print(f"\n| {exam.name} | {' | '.join(map(str, LEADS))} |\n|---|{'---|' * len(LEADS)}")
        for about, path in rows:
            network, _ = network_of(read_bytes(path, 2**26), str(path))
            (mark,) = examine(network, [exam])
            report(about, mark.error_m)
        for title, error in zip(("zero", "constant", "damped"), exam.simple_m, strict=True):
            report(f"{title} velocity", error)


def report(title: str, error_m: Floats) -> None:
    """Print a row: mean errors in mm at `LEADS`."""
    print(f"| {title} | " + " | ".join(f"{1000 * error_m[n - 1]:.1f}" for n in LEADS) + " |")


if __name__ == "__main__":
    main()
