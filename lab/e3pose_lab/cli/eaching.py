"""`e3pose each`: one verb over many recordings, on this machine or on a cluster."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.base.errors import Exit
from e3pose.cli.options import Flag, Whole


def each(
    dest: Path,
    recording: Annotated[list[Path], Parameter(negative="")],
    /,
    *,
    verb: str,
    jobs: Whole = -1,
    cluster: str | None = None,
    plan: Flag = False,
) -> None:
    """Run evaluate, replay, calibrate check or detect over many recordings; results as Parquet.

    Example: `e3pose each results recordings/* --verb "evaluate --policies all,information"`

    Example: `e3pose each results recordings/* --verb "calibrate check" --cluster tcp://head:8786`

    Example: `e3pose each results films/* --verb "detect --model movenet-multipose"`

    DEST gets a file per recording, which pandas.read_parquet("results") reads as one table. A
    command that was killed goes on the next time: what has a result is left out, unless recording,
    options or version changed. Exits with code 1 if a recording failed; it is tried again then.

    Parameters
    ----------
    dest
        Folder of the results.
    recording
        Recording folders, at the same place on all machines of a cluster; for detect folders with
        a film for each camera, and their calibration.toml if there is one. It writes recordings
        below DEST/_recordings, which is then at the same place, too.
    verb
        evaluate, replay, calibrate check or detect with its options, in quotes.
    jobs
        Parallel processes on this machine. Default: one per processor core.
    cluster
        Address of a Dask scheduler, such as tcp://host:8786, or local. Use only a cluster you
        trust.
    plan
        Only say how many recordings, bytes and hours are to do.
    """
    from e3pose.base.quantities import plural
    from e3pose.cli.progress import track_progress
    from e3pose_lab.each import check_words, make_plan, run_each
    from e3pose_lab.workers import Workers

    words = check_words(shlex.split(verb))
    workers = Workers(jobs, cluster, "--cluster")
    found = make_plan(dest, recording, words)
    to_do, size = plural(len(found.to_do), "recording"), found.bytes / 1e9
    hours = "hours unknown before the first result"
    if found.seconds is not None:
        hours = f"{found.seconds * len(found.to_do) / 3600:.2f} hours of one worker"
    print(f"To do: {to_do}, {size:.2f} GB, {hours}; done: {found.done}")
    if plan or not found.to_do:
        return
    failed = 0
    results = run_each(dest, found.to_do, words, workers)
    for one, problem in track_progress(results, len(found.to_do), "each"):
        if problem:
            failed += 1
            print(f"{one}: {problem}", file=sys.stderr)
    print(f"Wrote {dest}: {plural(len(found.to_do) - failed, 'result')}, {failed} failed")
    if failed:
        sys.exit(Exit.NO)
