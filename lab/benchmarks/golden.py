"""Record what the loop does, bit by bit, and compare another version with it.

    python lab/benchmarks/golden.py --write golden.json
    python lab/benchmarks/golden.py --against golden.json

For changes that must not move a figure. Digests are of one machine, one numba and one numpy: write
and compare on the same. Shelf takes part where `E3POSE_SHARED` names a folder that has it.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

SCENES = ("two-rooms", "ring", "dying-cameras")
POLICIES = ("information", "round-robin", "e3pose")
PIPELINES = ("memory", "paper")
WRONG = (
    ("replay", "nowhere"),
    ("replay", "SCENE", "--policy", "nobody"),
    ("replay", "SCENE", "--cameras", "99"),
    ("replay", "SCENE", "--lead", "0"),
    ("info", "nowhere"),
    ("evaluate", "SCENE", "--policies", "all,nobody"),
    ("check", "nowhere.toml"),
    ("query", "nowhere.db"),
    ("simulate", "--scene", "moon", "somewhere"),
    ("import", "shelf", "nowhere.npz", "somewhere"),
)


def run(*words: str, cwd: Path) -> tuple[int, str]:
    """Run `e3pose` and return its exit code and what it said on standard error."""
    done = subprocess.run(
        [sys.executable, "-m", "e3pose", *words],
        cwd=cwd,
        capture_output=True,
        text=True,
        env={**os.environ, "NO_COLOR": "1", "COLUMNS": "200"},
    )
    return done.returncode, done.stderr.strip()


def recordings(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield names and folders of what is replayed."""
    for scene in SCENES:
        place = folder / scene
        words = ("--scene", scene, "--fps", "12.5", "--seconds", "8", "--seed", "701")
        code, error = run("simulate", str(place), *words, cwd=folder)
        if code:
            raise SystemExit(error)
        yield scene, place
    shared = os.environ.get("E3POSE_SHARED")
    if shared:
        place = folder / "shelf"
        code, error = run(
            "import", "shelf", f"{shared}/data/shelf/shelf.npz", str(place), cwd=folder
        )
        if code:
            raise SystemExit(error)
        yield "shelf", place


def digests(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield what was run and the digest of what it left behind."""
    scene = folder / SCENES[0]
    for name, recording in recordings(folder):
        # A kernel that was compiled in this process rounds otherwise than one from disk.
        for pipeline in PIPELINES if recording == scene else ():
            run("replay", str(scene), "--pipeline", pipeline, "--cameras", "2", cwd=folder)
        for pipeline in PIPELINES:
            for policy in POLICIES:
                out = folder / f"{name}-{pipeline}-{policy}"
                poses, figures = out.with_suffix(".csv"), out.with_suffix(".json")
                code, error = run(
                    "replay", str(recording), "--pipeline", pipeline, "--policy", policy,
                    "--cameras", "2", "--lead", "4",
                    "--poses", str(poses), "--json", str(figures), cwd=folder,
                )  # fmt: skip
                yield f"{out.name}: exit", f"{code} {error if code else ''}"
                for path in (poses, figures):
                    yield path.name, digest(path) if path.exists() else "not written"
    for words in WRONG:
        code, error = run(*(w.replace("SCENE", str(scene)) for w in words), cwd=folder)
        yield " ".join(words), f"{code} {error.replace(str(folder), 'FOLDER')}"


def digest(path: Path) -> str:
    """Return a digest of a file; of JSON without its times, which differ from run to run.

    The format and the version of figures are left out: files of before have none.
    """
    if path.suffix == ".json":
        figures = json.loads(path.read_text())
        for name in ("format", "version"):
            figures.pop(name, None)
        settings = figures.get("settings", {})
        # Under its earlier name, so that digests of before still compare.
        figures["settings"] = {"bad_day" if k == "faults" else k: v for k, v in settings.items()}
        return hashlib.sha256(json.dumps(timeless(figures)).encode()).hexdigest()
    return hashlib.sha256(path.read_bytes()).hexdigest()


def timeless(found: object) -> object:
    """Leave out what the clock measured."""
    if isinstance(found, dict):
        return {k: timeless(v) for k, v in found.items() if "stage" not in k and "time" not in k}
    return [timeless(v) for v in found] if isinstance(found, list) else found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    group = parser.add_mutually_exclusive_group(required=True)
    group.add_argument("--write", type=Path)
    group.add_argument("--against", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = dict(digests(Path(folder)))
    if arguments.write:
        arguments.write.write_text(json.dumps(found, indent=1) + "\n")
        return
    known = json.loads(arguments.against.read_text())
    moved = [name for name in sorted({*known, *found}) if known.get(name) != found.get(name)]
    for name in moved:
        print(f"{name}\n  was {known.get(name)}\n  is  {found.get(name)}")
    print(f"{len(found)} compared, {len(moved)} moved")
    sys.exit(bool(moved))


if __name__ == "__main__":
    main()
