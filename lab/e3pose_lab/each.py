"""One verb over many recordings, on this machine or on a cluster, a Parquet file for each."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from e3pose import __version__
from e3pose.base.atomic import atomic_file
from e3pose.base.errors import InputError, reason_of
from e3pose_lab.workers import Workers

VERBS = (("evaluate",), ("replay",), ("calibrate", "check"), ("detect",))
FILMS = (".mp4", ".mkv", ".mov", ".avi", ".webm", ".m4v")
CALIBRATION = "calibration.toml"  # beside films
FOUND = "_recordings"  # folder of what detect makes; readers of tables leave out such names
CHILD = (
    "from e3pose.site.run import end_with_parent as end; end()\nfrom e3pose.cli import main; main()"
)
SECONDS = b"e3pose-seconds"  # what it took, in the metadata of a file
PROBLEM_LETTERS = 500


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a verb on a recording.

    Attributes:
        document: its JSON; empty where it failed.
        seconds: that it took.
        problem: why it failed; empty if it did not.
    """

    document: bytes
    seconds: float
    problem: str = ""


@dataclass(frozen=True, slots=True)
class Plan:
    """Recordings without a result, and the time that one takes.

    Attributes:
        to_do: recordings without a result.
        done: how many have one.
        bytes: of the recordings to do.
        seconds: that one took, as the median of those that are done; None before the first.
    """

    to_do: tuple[Path, ...]
    done: int
    bytes: int
    seconds: float | None


def check_words(words: Sequence[str]) -> tuple[str, ...]:
    """Return the words of a verb; raise `InputError` for one that this does not do."""
    known = ", ".join(" ".join(verb) for verb in VERBS)
    if not any(tuple(words[: len(verb)]) == verb for verb in VERBS):
        raise InputError("--verb", repr(" ".join(words)[:80]), f"one of {known}, with its options")
    if words[0] == "detect" and any(
        w.partition("=")[0] in ("--overwrite", "--calibration") for w in words
    ):
        wanted = f"neither: each folder has its {CALIBRATION}, or none"
        raise InputError("--verb", "--overwrite or --calibration", wanted)
    if any(word.partition("=")[0] in ("--json", "--plot", "--report") for word in words):
        raise InputError("--verb", "--json, --plot or --report", "none: results go to DEST")
    return tuple(words)


def result_of(dest: Path, recording: Path, words: Sequence[str]) -> Path:
    """Return the file of a result; another version, option or content is another file."""
    place = recording.resolve()
    about = sorted((p.name, p.stat().st_size, p.stat().st_mtime_ns) for p in _files(place))
    said = json.dumps([str(place), [*words], __version__, about])
    name = "".join(char if char.isalnum() or char in "-_" else "_" for char in place.name)[:60]
    return dest / f"{name}-{hashlib.sha256(said.encode()).hexdigest()[:16]}.parquet"


def make_plan(dest: Path, recordings: Sequence[Path], words: Sequence[str]) -> Plan:
    """Return the plan for recordings, of which some have a result.

    Raises:
        InputError: for a recording that is not there.
    """
    from pyarrow import parquet

    to_do, took_s, size = list[Path](), list[float](), 0
    for recording in recordings:
        if not recording.is_dir():
            raise InputError(str(recording), "no such folder", "a recording")
        path = result_of(dest, recording, words)
        if path.is_file():
            took_s.append(float((parquet.read_schema(path).metadata or {}).get(SECONDS, b"0")))
        else:
            to_do.append(recording)
            size += sum(file.stat().st_size for file in _files(recording))
    middle = sorted(took_s)[len(took_s) // 2] if took_s else None
    return Plan(tuple(to_do), len(took_s), size, middle)


def run_each(
    dest: Path, recordings: Sequence[Path], words: Sequence[str], workers: Workers
) -> Iterator[tuple[Path, str]]:
    """Yield each recording and what is wrong with it, as results are written.

    Args:
        dest: folder of the results, made if it is missing.
        recordings: without a result; at the same place on every worker.
        words: the verb and its options.
        workers: who does the work.

    Raises:
        InputError: when the cluster goes away; what was written stays, and the rest goes on later.
    """
    dest.mkdir(parents=True, exist_ok=True)
    tasks = [
        (str(one.resolve()), str((dest / FOUND / result_of(dest, one, words).stem).resolve()))
        for one in recordings
    ]
    try:
        for place, outcome in workers.as_ready(run_one, tuple(words), tasks):
            recording = recordings[place]
            if not outcome.problem:
                rows = rows_of(json.loads(outcome.document), str(recording))
                write_rows(result_of(dest, recording, words), rows, outcome.seconds)
            yield recording, outcome.problem
    except Exception as error:
        if not type(error).__module__.startswith(("distributed", "tornado", "asyncio")):
            raise
        reason = reason_of(error)[:200]
        raise InputError(
            f"{workers.option}: the cluster went away ({reason}); the same command goes on"
        ) from None


def run_one(words: tuple[str, ...], task: tuple[str, str]) -> Outcome:
    """Run a verb on a recording in a process of its own, which may end as it likes.

    Args:
        words: the verb and its options.
        task: the folder of the recording, or of its films; and where detect is to write one.
    """
    verb = next(verb for verb in VERBS if words[: len(verb)] == verb)
    folder, made = task
    rest, begun_s = list(words[len(verb) :]), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="e3pose-each-") as name:
        path = Path(name) / "result.json"
        shown = ["--json", str(path)]
        if verb == ("detect",):
            said = _detect(Path(folder), Path(made), rest) or _run("info", made, *shown)
        else:
            more = ["--jobs", "1"] if verb == ("evaluate",) and "--jobs" not in words else []
            said = _run(*verb, folder, *rest, *more, *shown)
        took_s = time.monotonic() - begun_s
        if not path.is_file():
            return Outcome(b"", took_s, said or "no result")
        return Outcome(path.read_bytes(), took_s)


def _detect(folder: Path, made: Path, options: Sequence[str]) -> str:
    """Make a recording of the films of a folder, unless it is made; return the error, if any."""
    if made.is_dir():
        return ""
    films = sorted(str(path) for path in folder.iterdir() if path.suffix.lower() in FILMS)
    if not films:
        return f"found no films ({', '.join(FILMS)}), expected one for each camera"
    rig = folder / CALIBRATION
    calibration = ["--calibration", str(rig)] if rig.is_file() else []
    made.parent.mkdir(parents=True, exist_ok=True)
    return _run("detect", *films, str(made), *calibration, *options)


def _run(*words: str) -> str:
    """Run a verb, which ends when this process does, however that comes; return its last error."""
    with subprocess.Popen(
        [sys.executable, "-c", CHILD, *words],
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stderr is not None
        said = process.stderr.read().strip().splitlines()
        code = process.wait()
    if code == 0:
        return ""
    return (said or [f"ended with code {code}"])[-1][:PROBLEM_LETTERS]


def rows_of(document: Any, recording: str) -> list[dict[str, Any]]:
    """Return a verb's JSON as flat rows: its `rows` if it has some, else one; lists as JSON."""
    found = document["rows"] if isinstance(document, dict) and "rows" in document else [document]
    return [
        {"folder": recording}
        | {k: json.dumps(v) if isinstance(v, (dict, list)) else v for k, v in row.items()}
        for row in found
    ]


def write_rows(path: Path, rows: Sequence[dict[str, Any]], seconds: float) -> None:
    """Write rows; numbers and what is missing are float64, so that all files have one schema."""
    import pyarrow
    from pyarrow import parquet

    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: [row.get(name) for row in rows] for name in names}
    table = pyarrow.table({
        name: pyarrow.array([None if v is None else str(v) for v in values], pyarrow.string())
        if any(isinstance(v, str) for v in values)
        else pyarrow.array([None if v is None else float(v) for v in values], pyarrow.float64())
        for name, values in columns.items()
    })  # fmt: skip
    table = table.replace_schema_metadata({SECONDS: f"{seconds:.3f}".encode()})
    with atomic_file(path) as temporary:
        parquet.write_table(table, temporary)


def _files(recording: Path) -> Iterator[Path]:
    for above, _, names in os.walk(recording):
        yield from (Path(above, name) for name in names if not name.startswith("."))
