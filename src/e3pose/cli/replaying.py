"""`e3pose replay`: one policy over one recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def replay(
    recording: Path,
    *,
    pipeline: str = "paper",
    policy: str = "e3pose",
    cameras: Annotated[int | None, Parameter(alias="-C")] = None,
    budget: Annotated[float | None, Parameter(alias="-E")] = None,
    quality_weight: Annotated[float, Parameter(alias="-V")] = 1.0,
    lead: int = 1,
    seed: int = 0,
    phase: int = 0,
    warmup: int = 10,
    predictor: str | None = None,
    reject_outliers: bool = False,
    occlusion_limit: float = 0.1,
    round_trip_ms: float = 50.0,
    profile: str = "xavier-nx",
    poses: Path | None = None,
    report: Path | None = None,
    json_file: Annotated[Path | None, Parameter(name="--json")] = None,
) -> None:
    """Run a recording through the system, letting it see only the cameras it selects.

    Example: `e3pose replay shelf --policy e3pose --cameras 3 --poses poses.parquet`

    Prints accuracy (where the recording has truth), what every camera did, and the energy saved.

    Parameters
    ----------
    recording
        Folder made by `e3pose detect`, `e3pose import` or `e3pose simulate`.
    pipeline
        The estimator: `paper` matches and triangulates every slot by itself.
    policy
        Who decides: all, random, round-robin, independent, central-2d, e3pose-mv, e3pose.
    cameras
        C, how many cameras detect in a slot; 3 unless the rig has fewer.
    budget
        E, the share of slots in which a camera may be active, from C/N to 1; C/N + 0.2 by default.
    quality_weight
        V: larger prefers clear views, smaller prefers even batteries.
    lead
        tau, how many slots ahead the cameras are told.
    seed
        Of random choices.
    phase
        Which camera comes first in turns and ties.
    warmup
        M, slots at the start in which every camera detects.
    predictor
        What foresees the poses: constant-velocity. By default the policy's own.
    reject_outliers
        Leave out views that disagree with the others.
    occlusion_limit
        The threshold of the policy `independent`.
    round_trip_ms
        The delay that the policy `central-2d` waits for in every decision.
    profile
        Power profile of the cameras: xavier-nx, tx2, generic, or a TOML file.
    poses
        Write the 3D poses here, `.parquet` or `.csv`.
    report
        Write a page to look at here, `.html`: the skeletons in 3D, selection, energy.
    json_file
        Write the figures here.
    """
    from e3pose.atomic import atomic_file
    from e3pose.cli.progress import track_progress
    from e3pose.energy import load_profile
    from e3pose.evaluate.poses_table import check_poses_path, write_poses
    from e3pose.evaluate.replay import ReplaySettings
    from e3pose.evaluate.replay import replay as run_replay
    from e3pose.evaluate.report import print_summary
    from e3pose.evaluate.summary import summarise
    from e3pose.recording import load_recording

    if poses is not None:
        check_poses_path(poses)
    device = load_profile(profile)
    source = load_recording(recording)
    settings = ReplaySettings(
        pipeline=pipeline,
        policy=policy,
        num_selected=min(3, len(source.rig)) if cameras is None else cameras,
        budget=budget,
        quality_weight=quality_weight,
        lead_slots=lead,
        warmup_slots=warmup,
        predictor=predictor,
        reject_outliers=reject_outliers,
        seed=seed,
        phase=phase,
        occlusion_limit=occlusion_limit,
        round_trip_s=round_trip_ms / 1000,
    )
    records = list(track_progress(run_replay(source, settings), source.num_slots, "replay"))
    summary = summarise(source, settings, records, device)
    if poses is not None:
        write_poses(records, source.skeleton, poses)
    if json_file is not None:
        with atomic_file(json_file) as temporary:
            temporary.write_text(json.dumps(summary, indent=2) + "\n")
    if report is not None:
        from e3pose.report import write_report

        write_report(source, records, summary, report)
    print_summary(summary)
