"""Hostile tables: what is done to files of a site and a recording, and the verbs that read them."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pyarrow
from numpy.lib import format as npy
from pyarrow import parquet

import hostile_videos
from e3pose.model import noises
from e3pose.recording import save_recording
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate
from e3pose.site.example import write_recorded
from hostile_trials import Trial, tried

SHIPPED_NOISE = Path(noises.__file__).with_name("openpose-thin.toml")
MARK = "\ufeff"
TABLES: dict[str, Callable[[bytes], bytes]] = {
    "as it is": lambda good: good,
    "empty": lambda good: b"",
    "byte order mark": lambda good: MARK.encode() + good,
    "byte order mark, twice": lambda good: 2 * MARK.encode() + good,
    "UTF-16": lambda good: good.decode().encode("utf-16"),
    "not UTF-8": lambda good: good + b'x = "\xff\xfe"\n',
    "NUL bytes": lambda good: good.replace(b"\n", b"\0\n", 1),
    "NUL in text": lambda good: b'x = "a\\u0000b"\n' + good,
    "100 MB": lambda good: good + b"#" * 100_000_000,
    "1 MB of keys": lambda good: b"".join(b"k%d=1\n" % i for i in range(80_000)) + good,
    "10000 lists, each in the last": lambda good: b"x = " + deep(b"[", b"]") + b"\n" + good,
    "10000 tables, each in the last": lambda good: b"x = " + deep(b"{a=", b"}") + b"\n" + good,
    "a key of 10000 parts": lambda good: b".".join([b"a"] * 10_000) + b" = 1\n" + good,
    "a heading of 10000 parts": lambda good: good + b"\n[" + b".".join([b"a"] * 10_000) + b"]\n",
    "1000 headings of 90 parts": lambda good: good + headings(1000, 90),
    "key twice": lambda good: first_line(good) + b"\n" + good,
    "table twice": lambda good: good + b"\n[zz]\n[zz]\n",
    "numbers: nan": lambda good: numbers(good, b"nan"),
    "numbers: inf": lambda good: numbers(good, b"inf"),
    "numbers: -1e308": lambda good: numbers(good, b"-1e308"),
    "numbers: 1e-308": lambda good: numbers(good, b"1e-308"),
    "numbers: 2^63": lambda good: numbers(good, b"9223372036854775808"),
    "numbers: 10^300": lambda good: numbers(good, b"1" + b"0" * 300),
    "numbers: 10^5000": lambda good: numbers(good, b"1" + b"0" * 5000),
    "numbers: true": lambda good: numbers(good, b"true"),
    "numbers: text": lambda good: numbers(good, b'"7"'),
    "numbers: a date": lambda good: numbers(good, b"2026-11-23T10:00:00Z"),
    "numbers: lists": lambda good: numbers(good, b"[[]]"),
    "numbers: a table": lambda good: numbers(good, b"{a = 1}"),
    "texts: a number": lambda good: texts(good, b"5"),
    "texts: empty": lambda good: texts(good, b'""'),
    "texts: 1 MB": lambda good: texts(good, b'"' + b"x" * 1000 + b'"'),
    "texts: control codes": lambda good: texts(good, b'"\\u001b[2J"'),
    "texts: ../..": lambda good: texts(good, b'"../../../etc/passwd"'),
    "texts: a table": lambda good: texts(good, b"{a = 1}"),
}  # fmt: skip


def deep(opened: bytes, closed: bytes) -> bytes:
    """Return a number in ten thousand lists or tables."""
    return opened * 10_000 + b"1" + closed * 10_000


def headings(count: int, parts: int) -> bytes:
    """Return headings of tables with so many parts each."""
    return b"".join(b"\n[" + b".".join([b"a%d" % i] * parts) + b"]\n" for i in range(count))


def first_line(good: bytes) -> bytes:
    """Return the first line that gives a key."""
    return next(line for line in good.splitlines() if b"=" in line)


def numbers(good: bytes, put: bytes) -> bytes:
    """Return a table whose last number is another value."""
    return _replaced(good, put, rb"^(\s*|.* = )-?\d[\d.e+-]*(,?)$")


def texts(good: bytes, put: bytes) -> bytes:
    """Return a table whose last text is another value."""
    return _replaced(good, put, rb"^(.* = )\".*\"()$")


def _replaced(good: bytes, put: bytes, value: bytes) -> bytes:
    last = list(re.finditer(value, good, re.MULTILINE))[-1]
    return good[: last.start()] + last[1] + put + last[2] + good[last.end() :]


def make_tables(folder: Path) -> dict[str, tuple[Path, list[str]]]:
    """Return a file of each kind, and the verb that reads it."""
    recording = simulate(SceneSettings(people=1, seconds=0.6, cameras=3, fps=10), seed=0)
    save_recording(recording, folder / "rec")
    write_recorded(folder / "site", recording, "lab")
    (folder / "noise.toml").write_bytes(SHIPPED_NOISE.read_bytes())
    rec, site = folder / "rec", folder / "site"
    replay = ["replay", str(rec), "--pipeline", "paper", "--policy", "all"]
    camera = folder / "camera.toml"
    camera.write_text(
        'format = "e3pose-camera"\nversion = 1\nsite = "lab"\ncamera = "cam0"\n'
        f'endpoint = "tcp/127.0.0.1:1"\nsource = "recorded:{folder / "none"}"\npace = 1.0\n'
    )
    return {
        "site.toml": (site / "site.toml", ["check", str(site), "--timeout", "0"]),
        "rig.toml": (rec / "calibration.toml", ["info", str(rec)]),
        "recording.toml": (rec / "recording.toml", ["info", str(rec)]),
        "noise.toml": (folder / "noise.toml", [*replay, "--noise", str(folder / "noise.toml")]),
        "camera.toml": (camera, ["camera", str(camera)]),
    }


def parquet_of(path: Path, names: str, rows: int = 10_000_000) -> None:
    """Write columns of zeros, which a file of a megabyte holds by the gigabyte."""
    zeros = pyarrow.array(np.zeros(rows))
    columns = {name: zeros for name in names.split()}
    if "joint" in columns:
        columns["joint"] = pyarrow.DictionaryArray.from_arrays(np.zeros(rows, np.int8), ["nose"])
    parquet.write_table(pyarrow.table(columns), path, compression="zstd")


def points_of(path: Path) -> None:
    """Write an array that says that it has 1.6 GB, in an archive of some bytes."""
    header = io.BytesIO()
    npy.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (10**8, 2)}
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("cam0.npy", header.getvalue())


def pictures_of(folder: Path) -> None:
    """Write a JPEG that goes over its picture 400 times."""
    grey = np.full((2000, 2000, 3), 128, np.uint8)
    coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    scan = coded[coded.rindex(b"\xff\xda") : -2]
    folder.mkdir()
    (folder / "1.jpg").write_bytes(coded[:-2] + 400 * scan + coded[-2:])


# What is small and unpacks to much, or takes long: how it is made, and the verb that reads it.
# `$` stands for it, `~` for the folder.
BOMBS: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "Parquet of other columns, 1.2 GB": (
        "a.parquet", lambda p: parquet_of(p, "a b c d e f g h i j k l m n o"), "export $ ~/x.trc",
    ),
    "Parquet of 50 million rows": (
        "b.parquet", lambda p: parquet_of(p, "slot track joint time x y z", 50_000_000),
        "export $ ~/x.trc",
    ),
    "points of 1.6 GB": (
        "a.npz", points_of,
        "calibrate extrinsics $ ~/x.toml --intrinsics ~/rec/calibration.toml",
    ),
    "JPEG of 400 scans": (
        "jpegs", pictures_of, f"detect $ ~/x --model {hostile_videos.__file__}:Nobody --fps 5",
    ),
}  # fmt: skip


def try_bombs(folder: Path) -> Iterator[Trial]:
    """Give each to its verb, in a folder with a recording `rec`."""
    for name, (file, make, words) in BOMBS.items():
        make(folder / file)
        words = words.replace("$", str(folder / file)).replace("~", str(folder))
        yield tried(name, words.split()[0], words.split())


def try_table(name: str, path: Path, words: list[str], good: bytes) -> Trial:
    """Give a table that is broken in one way to the verb that reads it."""
    path.write_bytes(TABLES[name](good))
    try:
        return tried(f"{path.name}: {name}", words[0], words)
    finally:
        path.write_bytes(good)
