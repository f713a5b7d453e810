"""`e3pose replay`: one policy over one recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from e3pose.cli.fault_options import FaultOptions
from e3pose.cli.options import (
    GOAL,
    OUTPUT,
    EnergyOptions,
    LoopOptions,
    as_typed,
    check_outputs,
    options_of,
    warn,
)
from e3pose.cli.output import JsonFile, is_stdout, write_json, wrote
from e3pose.cli.smoothing import SmoothOptions
from e3pose.cli.storing import StoreOptions
from e3pose.errors import InputError

if TYPE_CHECKING:
    from e3pose.estimate.base import People, Posterior

LOOP, ENERGY, FAULTS, STORE = LoopOptions(), EnergyOptions(), FaultOptions(), StoreOptions()
SMOOTH = SmoothOptions()


def replay(
    recording: Path,
    /,
    *,
    policy: str | None = None,
    cameras: Annotated[float | None, Parameter(alias="-C", group=GOAL)] = None,
    loop: LoopOptions = LOOP,
    energy: EnergyOptions = ENERGY,
    faults: FaultOptions = FAULTS,
    store: StoreOptions = STORE,
    smooth: SmoothOptions = SMOOTH,
    detector: str | None = None,
    poses: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    report: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json_file: Annotated[JsonFile, Parameter(group=OUTPUT)] = None,
) -> None:
    """Replay a recording through the live pipeline, which sees only the views it selects.

    Example: `e3pose replay shelf --cameras 2 --poses poses.parquet --report report.html`

    Set one goal: cameras per slot (`--cameras 2`), accuracy (`--target-error 40mm`) or battery
    life (`--lifetime 6h --battery-wh 50`). A lifetime also combines with either of the others.

    With `--smooth`, poses, report and figures also use later slots; the selection is unchanged.

    The command prints accuracy (if the recording has truth), camera use and energy saved.

    Parameters
    ----------
    recording
        Recording folder.
    policy
        Camera selection: all, random, round-robin, independent, central-2d, e3pose-mv, e3pose,
        information. Default: set by --pipeline.
    cameras
        Cameras per slot C; a mean such as 1.5 is allowed. Default: 2, and 3 with --pipeline paper.
    detector
        Detect anew in the recording's videos with this one: a name from `e3pose models list`, or
        the path of a network. Default: the recording's keypoints; with feedback, its detector.
    poses
        Write the 3D poses here (.parquet or .csv).
    report
        Write a report page here (.html): 3D player, camera selection, energy.
    json_file
        Write the figures here as JSON; - is standard output.
    """
    from e3pose.cli.placed import load_placed
    from e3pose.cli.progress import track_progress
    from e3pose.cli.storing import stored
    from e3pose.evaluate.detect_again import open_pixels
    from e3pose.evaluate.figures import as_json
    from e3pose.evaluate.poses_table import check_poses_path, write_poses
    from e3pose.evaluate.replay import replay as run_replay
    from e3pose.evaluate.summary import summarise
    from e3pose.evaluate.tables import print_summary
    from e3pose.settings.parts import noise_warning

    if poses is not None:
        check_poses_path(poses)
    if report is not None and report.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--report: found {str(report)!r}, expected a name ending in .html")
    if store.store is not None or store.keep or store.max_size:
        store.retention()
    smoothing = smooth.settings()
    if store.store is not None and smoothing.method is not None:
        raise InputError(
            "--store: found with --smooth, expected one of them; smooth later with e3pose export"
        )
    outputs = {"--poses": poses, "--json": json_file, "--report": report}
    check_outputs(recording, {"--store": store.file(), **outputs})
    source = faults.downsampled(load_placed(recording))
    posteriors: list[Posterior] = []

    def keep_posterior(people: People) -> None:
        if smoothing.method == "rts" and people.posterior is not None:
            posteriors.append(people.posterior)

    asked = loop.settings(policy, cameras)
    with as_typed(options_of(LoopOptions, EnergyOptions, more=("cameras", "policy", "detector"))):
        plan = energy.settings().plan(source.rig.camera_ids, source.interval_s, source.battery_wh)
        settings = replace(
            asked.for_rig(len(source.rig), plan),
            foresees=report is not None and loop.pipeline != "paper",
            faults=faults.day(source, plan.watts),
        )
        anew = settings.feedback or detector is not None
        feedback = settings.feedback
        look = open_pixels(source, recording, detector, feedback=feedback) if anew else None
        replayed = run_replay(source, settings, publish=keep_posterior, look=look)
    slots = stored(
        replayed,
        store,
        source,
        f"replay {settings.row_name}",
        plan.profiles,
        plan.idle_mode,
    )
    records = list(track_progress(slots, source.num_slots, "replay"))
    if smoothing.method is not None:
        from e3pose.evaluate.smoothed import smooth_poses, smooth_records

        if posteriors:
            records = smooth_records(records, posteriors, source.skeleton)
        else:
            records = smooth_poses(records, source.skeleton, source.interval_s, smoothing)
    warn(noise_warning(source, settings))  # beside the figures; an error before them is one line
    summary = summarise(
        source,
        settings,
        records,
        plan.profiles,
        idle_mode=plan.idle_mode,
        battery_wh=plan.battery_wh,
    )
    notes = () if look is None else (look.words(),)
    summary = replace(summary, smooth=smoothing.method, notes=(*summary.notes, *notes))
    if poses is not None:
        write_poses(records, source.skeleton, poses)
    if report is not None:
        from e3pose.report import write_report

        write_report(source, records, summary, report)
    if is_stdout(json_file):
        write_json(json_file, as_json(summary))
        return
    print_summary(summary)
    for note in notes:
        print(note)
    for path in (poses, report, store.file()):
        wrote(path)
    write_json(json_file, as_json(summary))
