"""Hostile videos and tables, one by one: what each is, what verbs say, how long and how large.

    python lab/benchmarks/hostile_inputs.py           # try all and print a table
    python lab/benchmarks/hostile_inputs.py videos    # or one kind of them: videos, tables

An input holds if every verb that is given it either uses it or ends with code 2 and one line, in
bounded time and memory. `make attack` tries them all too.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from hostile_tables import TABLES, make_tables, try_bombs, try_table
from hostile_trials import Trial
from hostile_videos import VIDEOS, try_video


def try_all(kind: str = "", init: bool = True) -> Iterator[Trial]:
    """Try everything, or all of one kind, with `e3pose init` or without."""
    with tempfile.TemporaryDirectory(prefix="e3pose-hostile-") as name:
        folder = Path(name)
        if kind in ("", "videos"):
            for video, (file, make) in VIDEOS.items():
                place = folder / "video"
                place.mkdir()
                make(place / file)
                yield from try_video(place / file, video, init)
                shutil.rmtree(place)
        if kind in ("", "tables"):
            for path, words in make_tables(folder).values():
                good = path.read_bytes()
                for table in TABLES:
                    yield try_table(table, path, words, good)
            yield from try_bombs(folder)


def main() -> None:
    """Print the table; end with 1 if something did not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", nargs="?", default="", choices=["", "videos", "tables"])
    failed = 0
    for trial in try_all(parser.parse_args().kind):
        failed += not trial.held
        said = " ".join(trial.said.split())[-150:]
        print(
            f"{'held' if trial.held else 'FAILED':6} | {trial.name:40} | {trial.verb:7} | "
            f"{trial.code:2} | {trial.took_s:5.1f} s | {trial.grown_mb:5.0f} MB | {said}",
            flush=True,
        )
    print(f"{failed} failed")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
