"""What predictors are worth on the filter's own tracks, and what steering the filter by one is.

E3POSE_SHARED=... python lab/benchmarks/predictor_in_the_loop.py

People move as motion capture that the shipped weights never saw, before a ring of five cameras with
simulated detections; cameras take turns. First table: error in mm by slots ahead, from the tracks
of the filter with its memory, against the truth. Second: the error of the estimates themselves,
alone and steered by the learned predictor.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from e3pose_lab.datasets import shared_folder

Floats = NDArray[np.float64]

CLIPS = ("01_06", "01_14", "02_02", "02_07")  # held out of training, as the model card says
PARTS = ((1878, 2347), (4036, 4456))  # of the Panoptic sequence, likewise
LEADS = (1, 2, 4, 6, 10, 15)
SIMPLE = ("zero-velocity", "constant-velocity", "damped-velocity")
NETWORK = "attention-lstm"
BEGUN = 15  # slots before predictions count
SAME_M = 0.3
BODY = slice(5, 17)  # COCO-17 without the face, which motion capture lacks


def with_face(joints_m: Floats, capture_m: Floats) -> Floats:
    """Return COCO-17 joints whose face is made up from neck and head of CMU-31."""
    from e3pose.model.skeleton import CMU31
    from e3pose_lab.datasets.bvh import face_of

    top, below = (capture_m[..., CMU31.index(n), :] for n in ("top_head", "upper_neck"))
    face = joints_m.copy()
    face[..., :5, :] = face_of(below, top, joints_m[..., 5, :] - joints_m[..., 6, :])
    return np.asarray(face)


def captured(shared: Path) -> Iterator[tuple[str, Floats]]:
    """Yield names and `(num_slots, 17, 3)` motion at 30 Hz."""
    from e3pose.model.skeleton import CMU31, COCO17, PANOPTIC19, convert
    from e3pose_lab.datasets.motion import import_cmu

    for clip in CLIPS:
        truth = import_cmu(shared / "data/cmu_mocap/cmu_mocap_train_30fps.npz", clip).truth
        assert truth is not None
        bones = truth.joints_m[:, 0]
        joints, _ = convert(bones, np.ones(bones.shape[:2]), CMU31, COCO17)
        yield "CMU", with_face(joints, bones)
    with np.load(shared / "data/panoptic/171026_pose3_train.npz") as file:
        whole = file["joints19_cm"].astype(np.float64)[..., [0, 2, 1]] * [0.01, 0.01, -0.01]
    for first, end in PARTS:
        part = whole[first:end]
        joints, _ = convert(part, np.ones(part.shape[:2]), PANOPTIC19, COCO17)
        yield "Panoptic", joints


def seen(joints_m: Floats, fps: float, detector: Any = None) -> Any:
    """Return a recording of one person who moves so, before a ring of cameras."""
    from e3pose.model.skeleton import COCO17
    from e3pose.recording import Recording, Truth
    from e3pose.simulate import DetectorSettings
    from e3pose.simulate.detections import detect_people
    from e3pose.simulate.guesses import OUTPUTS
    from e3pose.simulate.scenes import SCENES
    from e3pose.simulate.situations import draw_fields
    from e3pose_lab.datasets.motion import default_ring

    hips = joints_m[:, 11]
    rig = default_ring(hips)
    middle = np.append((hips[:, :2].min(axis=0) + hips[:, :2].max(axis=0)) / 2, 0.0)
    seeds = np.random.SeedSequence(len(joints_m)).spawn(len(rig))
    fields = draw_fields(np.random.default_rng(len(joints_m)), 1, OUTPUTS)
    views = tuple(
        detect_people(
            camera, (joints_m - middle)[:, None], middle, SCENES["ring"], 4.2, fps,
            detector or DetectorSettings(), seed, fields,
        )
        for camera, seed in zip(rig.cameras, seeds, strict=True)
    )  # fmt: skip
    truth = Truth(COCO17, ("person1",), joints_m[:, None])
    return Recording("motion", rig, fps, len(joints_m), COCO17, views, truth=truth)


def run(
    recording: Any, cameras: int, predictor: str
) -> tuple[dict[str, list[Floats]], list[float]]:
    """Return errors `(num_leads, num_joints)` by predictor, slot by slot, and of the estimates."""
    from e3pose.evaluate.replay import ReplaySettings, make_pipeline, selected_views
    from e3pose.pipeline import initial_state, step
    from e3pose.predict import make_predictor

    settings = ReplaySettings(
        policy="round-robin", num_selected=cameras, predictor=predictor, phase=1
    )
    pipeline = make_pipeline(recording, settings)
    predictors = {name: make_predictor(name) for name in (*SIMPLE, NETWORK)}
    truth, dt = recording.truth.joints_m[:, 0], recording.interval_s
    state, online = initial_state(pipeline), np.ones(len(recording.rig), dtype=bool)
    found: dict[str, list[Floats]] = {name: [] for name in ("filter", *predictors)}
    estimates: list[float] = []
    published: list[Any] = []
    for slot in range(recording.num_slots):
        views = selected_views(recording, slot, state.selections[0])
        state, _ = step(pipeline, state, views, online, published.append)
        people = published.pop()
        apart = np.linalg.norm(people.poses.joints_m - truth[slot], axis=-1)[:, BODY].mean(axis=1)
        if slot < BEGUN or not (apart < SAME_M).any():
            continue
        row = int(apart.argmin())
        estimates.append(1000 * float(apart[row]))
        if predictor == NETWORK or slot + LEADS[-1] >= len(truth):
            continue
        future = truth[[slot + lead for lead in LEADS]][:, BODY]
        outlooks = [pipeline.estimator.outlook(state.memory, lead * dt) for lead in LEADS]
        own = [
            o.joints_m[np.flatnonzero(o.track_ids == people.track_ids[row])[0]] for o in outlooks
        ]
        expected = {"filter": np.stack(own)}
        for name, each in predictors.items():
            said = each.predict(people.history_m, dt, LEADS[-1]).joints_m
            expected[name] = said[[lead - 1 for lead in LEADS], row]
        for name, joints in expected.items():
            found[name].append(1000 * np.linalg.norm(joints[:, BODY] - future, axis=-1))
    return found, estimates


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--cameras", type=int, nargs="+", default=(1, 2, 4))
    options = parser.parse_args()
    motions = list(captured(shared_folder()))
    print(f"| motion, slots per second, cameras | predictor | {' | '.join(map(str, LEADS))} |")
    print("|---" * (len(LEADS) + 2) + "|")
    alone: dict[tuple[str, int, int], tuple[float, float]] = {}
    for kind in ("CMU", "Panoptic"):
        for every in (1, 2):
            fps = 30 // every
            recordings = [seen(m[::every], fps) for name, m in motions if name == kind]
            for cameras in options.cameras:
                plain = [run(each, cameras, "zero-velocity") for each in recordings]
                steered = [run(each, cameras, NETWORK) for each in recordings]
                errors = [np.mean(np.concatenate([e for _, e in x])) for x in (plain, steered)]
                alone[kind, fps, cameras] = (float(errors[0]), float(errors[1]))
                for name in plain[0][0]:
                    mean = np.mean([e for found, _ in plain for e in found[name]], axis=(0, 2))
                    cells = " | ".join(f"{value:.1f}" for value in mean)
                    print(f"| {kind}, {fps}, {cameras} | {name} | {cells} |", flush=True)
    print("\n| motion, slots per second, cameras | estimate | steered |\n|---|---|---|")
    for (kind, fps, cameras), (before, after) in alone.items():
        print(f"| {kind}, {fps}, {cameras} | {before:.1f} | {after:.1f} |")


if __name__ == "__main__":
    main()
