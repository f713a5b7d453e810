"""The program that makes the files of one wish: `python -m e3pose.site.keep.making FOLDER SITE`.

It reads the wish as JSON from standard input and says on standard output, a line of JSON each, how
far it is, and at the end what it made or why not. A process of its own keeps the page answering,
and can be ended whatever it does. The files are those of `e3pose export` and `e3pose report`.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural
from e3pose.base.system import stand_back
from e3pose.estimate.smooth import SmoothSettings, smoothed
from e3pose.output.exports import ExportSettings, export
from e3pose.output.exports.source import Asked, take_from_store
from e3pose.output.report.stored import write_stretch
from e3pose.settings.resolved import resolve_site
from e3pose.site.keep.mcap import write_mcap
from e3pose.site.keep.wish import Wish
from e3pose.store import Store

SAY_S = 0.2  # between two lines about how far it is
Say = Callable[[str, float | None], None]


def make(wish: Wish, site_file: Path, folder: Path, say: Say) -> tuple[list[str], str]:
    """Make the files of a wish in a folder; return their names and a note.

    Args:
        wish: what is wanted.
        site_file: of the site.
        folder: that the files are made in.
        say: called with what is being done, and how much of it is, [0, 1]; None if unknown.

    Raises:
        InputError: when nothing is stored, or the form cannot hold it.
        OSError: when the disk takes no more.
    """
    site = resolve_site(site_file)
    if site.store is None:
        raise InputError("the site stores nothing: add [store] to its site file")
    smoothing = SmoothSettings("rts" if wish.smooth else None)
    dest = folder / wish.file_name
    say("reading", None)
    if wish.form == "report":
        store = Store(site.store.place)
        slots = write_stretch(site, store, dest, wish.start_ns, wish.end_ns, smoothing)
        return [dest.name], plural(slots, "slot")
    if wish.form == "mcap":
        return [dest.name], write_mcap(wish, site, dest, say)
    return _exported(wish, str(site.store.place), site.name, dest, smoothing, say)


def _exported(
    wish: Wish, place: str, site: str, dest: Path, smoothing: Any, say: Say
) -> tuple[list[str], str]:

    def progress(items: Iterable[Any], total: int, label: str) -> Iterator[Any]:
        for done, item in enumerate(items):
            say(label, done / max(total, 1))
            yield item

    asked = Asked(wish.start_ns, wish.end_ns, wish.tracks, site, wish.run)
    take = take_from_store(place, asked)
    if smoothing.method is not None:
        motions: list[Any] = []
        for motion in progress(take.motions, len(take.motions), "smoothing"):
            motions += smoothed(replace(take, motions=(motion,)), smoothing).motions
        take = replace(take, motions=tuple(motions))
    settings = ExportSettings(progress=progress)
    made = list(export(take, dest, wish.form, settings))
    notes = [note for _, note in made if note]
    return [path.name for path, _ in made], notes[0] if len(set(notes)) == 1 else ""


def main(arguments: list[str]) -> int:
    """Make what standard input asks for; return the exit code."""
    folder, site_file = Path(arguments[0]), Path(arguments[1])
    stand_back()
    wish = Wish(**{**(told := json.load(sys.stdin)), "tracks": tuple(told["tracks"])})
    said_s = [0.0]

    def say(doing: str, share: float | None) -> None:
        if time.monotonic() - said_s[0] >= SAY_S:
            said_s[0] = time.monotonic()
            print(json.dumps({"doing": doing, "share": share}), flush=True)

    try:
        names, note = make(wish, site_file, folder, say)
    except InputError as error:
        print(json.dumps({"problem": str(error.elsewhere())}), flush=True)
        return 1
    except ModuleNotFoundError as error:
        problem = (
            f"{error.name} is not installed on the machine of the page: see pip install e3pose"
        )
        print(json.dumps({"problem": problem}), flush=True)
        return 1
    except OSError as error:
        print(json.dumps({"problem": (error.strerror or str(error)).lower()}), flush=True)
        return 1
    except MemoryError:
        print(json.dumps({"problem": "more than fits into memory: a shorter time"}), flush=True)
        return 1
    print(json.dumps({"files": names, "note": note}), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
