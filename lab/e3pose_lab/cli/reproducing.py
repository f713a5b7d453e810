"""`e3pose reproduce`: the tables and figures of the paper."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from e3pose.cli.options import Flag, Whole, as_typed


def reproduce(
    dest: Path = Path("reproduced"),
    /,
    *,
    quick: Flag = False,
    data: Annotated[Path | None, Parameter(env_var="E3POSE_DATA")] = None,
    only: str | None = None,
    seeds: Whole | None = None,
    jobs: Whole = -1,
    cluster: str | None = None,
) -> None:
    """Redo the tables and figures of the paper, with the paper's own figures beside.

    Example: `e3pose reproduce reproduced --data data --quick`

    Writes DEST/report.html, and each figure as SVG and each table as CSV. Results are kept in
    DEST/results: the same command resumes an interrupted run and computes only what changed. The
    report says why an item failed. Exits with code 1 then, and if a headline figure leaves its
    margin.

    Parameters
    ----------
    dest
        Output folder.
    quick
        Few seeds and slots: some minutes instead of half an hour and more.
    data
        Folder with shelf/, pizza/ and panoptic/. Items without their data are skipped, and the
        report says where to get it.
    only
        Comma-separated items to compute, such as table-1,best-subsets.
    seeds
        Seeds of each item, at most. Default: 5 to 20, as the item says.
    jobs
        Parallel processes on this machine. Default: one per processor core.
    cluster
        Address of a Dask scheduler, such as tcp://host:8786, or local. The results are the same.
        Use only a cluster you trust.
    """
    from e3pose.base.errors import Exit, InputError
    from e3pose_lab.reproduce.items import ITEMS
    from e3pose_lab.reproduce.job import reproduce as run
    from e3pose_lab.reproduce.sources import load_sources
    from e3pose_lab.reproduce.time_left import tracked
    from e3pose_lab.workers import Workers

    items = ITEMS
    if only is not None:
        names = [name.strip() for name in only.split(",")]
        known = {item.key: item for item in ITEMS}
        for name in names:
            if name not in known:
                raise InputError("--only", repr(name[:40]), f"items of {', '.join(known)}")
        items = tuple(known[name] for name in dict.fromkeys(names))
    if seeds is not None and seeds < 1:
        raise InputError("--seeds", f"{seeds}", "at least 1")
    workers = Workers(jobs, cluster, "--cluster")
    with as_typed({"data": "--data"}):
        sources = load_sources(data)
    outcome = run(
        dest,
        sources,
        workers,
        quick=quick,
        most_seeds=seeds,
        items=items,
        track=lambda results, pieces: tracked(results, pieces, workers.processes),
    )
    for title, reason in outcome.skipped:
        print(f"Skipped {title}: {reason}")
    print(f"Wrote {outcome.page}")
    for headline in outcome.wrong:
        print(
            f"e3pose: {headline.name}: found {headline.value:.2f}, expected "
            f"{headline.low:g} to {headline.high:g}",
            file=sys.stderr,
        )
    if outcome.wrong or outcome.failed:
        sys.exit(Exit.NO)
