"""`e3pose reconstruct`: from films to the best 3D and the files of other tools, verb by verb."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import tomli_w
from cyclopts import Group, Parameter

from e3pose import __version__
from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_bytes, read_toml
from e3pose.base.errors import InputError
from e3pose.base.quantities import duration_s, shell
from e3pose.camera.source import Source, open_sources
from e3pose.cli.app import app
from e3pose.cli.options import Flag
from e3pose.detectors.chooser import AUTO
from e3pose.recording import load_recording
from e3pose.recording.calibration import load_calibration
from e3pose.recording.pairing import name_videos, pair_videos
from e3pose.recording.videos import chapters_of

FORMAT, VERSION = "e3pose-reconstruct", 1
STATE = "reconstruct.toml"  # in the folder of results: the commands, and what they read
MAX_BYTES = 2**20
DOUBTFUL_MM = 80.0  # across the rays of cameras that took no part: twice what is usual
ABOUT = {
    "report.html": "open this first: 3D player, films with skeletons, figures",
    "poses.parquet": "3D poses, metres, z up",
    "poses*.trc, poses.c3d": "markers for OpenSim, Mokka, Visual3D",
    "poses*.mot, angles.csv": "joint angles",
    "poses.glb": "skeletons for Blender",
    "recording": "calibration and 2D keypoints, for `e3pose replay`",
    STATE: "the commands that made this",
}


@dataclass(eq=False)
class Steps:
    """Runs commands whose inputs have changed since they ran last.

    Attributes:
        folder: of the results.
    """

    folder: Path
    done: list[dict[str, Any]] = field(default_factory=list)
    _before: list[dict[str, Any]] = field(default_factory=list)
    _changed: bool = False

    def __post_init__(self) -> None:
        path = self.folder / STATE
        if path.exists():
            found = read_toml(path, MAX_BYTES)
            if found.get("format") != FORMAT or found.get("version") != VERSION:
                raise InputError(f"{path}: expected format {FORMAT!r}, version {VERSION}")
            self._before = [dict(step) for step in found.get("step", [])]

    def run(self, name: str, words: Sequence[object], reads: Sequence[Path], makes: Path) -> None:
        """Run a command unless it ran before on the same files, and its result is there.

        Raises:
            SystemExit: with its exit code if it failed.
        """
        texts = [str(word) for word in words]
        command = " ".join(["e3pose", *map(shell, texts)])
        inputs = {str(path): _stamp(path) for path in reads}
        step = {"name": name, "command": command, "inputs": inputs}
        old = self._before[len(self.done)] if len(self.done) < len(self._before) else None
        self._changed |= old != step or not makes.exists()
        self.done.append(step)
        if not self._changed:
            print(f"{name}: unchanged", flush=True)
            return
        print(f"{name}: {command}", flush=True)
        if makes.is_dir():
            texts.append("--overwrite")
        try:
            app(texts, exit_on_error=False, print_error=False)
        except SystemExit as ended:
            if ended.code not in (None, 0):
                raise
        self._save()

    def _save(self) -> None:
        table = {"format": FORMAT, "version": VERSION, "e3pose": __version__, "step": self.done}
        write_file(self.folder / STATE, tomli_w.dumps(table))


def reconstruct(
    *films: str,
    out: Path = Path("reconstruction"),
    calibration: Path | None = None,
    height: str | None = None,
    sync: Literal["auto", "sound", "people", "none"] = "auto",
    trim: str | None = None,
    model: str = AUTO,
    until: Annotated[
        Literal["detect", "calibrate", "poses", "export"], Parameter(group=Group("Output"))
    ] = "export",
    as_stored: Flag = False,
) -> None:
    """Make 3D poses, joint angles and a report of films: all cameras, smoothed, all files.

    Example: `e3pose reconstruct cam1.mp4 cam2.mp4 cam3.mp4 --calibration calibration.toml`

    Example: `e3pose reconstruct phone1.mp4 phone2.mp4 phone3.mp4 --height 171cm`

    It finds the time between the films, detects people, calibrates from them where there is no
    calibration, replays with all cameras and all later slots, judges itself by cameras that take no
    part, and writes TRC, C3D, MOT, CSV and glTF. Each step prints its command, and is left out the
    next time if nothing it reads has changed.

    Parameters
    ----------
    films
        Films of the same scene, paired with cameras as in `e3pose detect`.
    out
        Folder of the results.
    calibration
        Calibration file of the cameras. Without it, they are calibrated from the people.
    height
        Mean height of the people, such as 171cm: the scale of a calibration from people.
    sync
        How to find the time between films: by sound, by the people, or none because they began
        together. Default: sound where all films have the same, else people where there is no
        calibration, else none.
    trim
        Part of the films to use, such as 3s:40s.
    model
        2D pose network, as in `e3pose detect`.
    until
        Last step to run.
    as_stored
        Ignore the turn that films ask players for, if the calibration was made without it.
    """
    known = None if calibration is None else load_calibration(calibration)
    if len(films) < (3 if known is None else 2):
        wanted = "three cameras or more without --calibration, of two with it"
        raise InputError("FILM...", f"{len(films)}", f"films of {wanted}")
    paths = name_videos(films) if known is None else pair_videos(films, known.rig)
    if known is not None and height is not None:
        raise InputError("--height", "beside --calibration", "one of them")
    out.mkdir(parents=True, exist_ok=True)
    sources = open_sources(paths, None, None, as_stored)
    steps = Steps(out)
    options: list[object] = ["--model", model, *_trimmed(trim, sources)]
    options += ["--as-stored"] * as_stored
    recording, offsets = out / "recording", _by_sound(steps, paths, sources, sync)
    options += [f"--offset={offset}" for offset in offsets]
    _detect(steps, paths, recording, calibration, options)
    if not offsets and (sync == "people" or (sync == "auto" and known is None)):
        keypoints, recording = recording / "keypoints", out / "recording-in-step"
        steps.run("sync", ["sync", out / "recording", recording], [keypoints], recording)
    elif not offsets:
        print("sync: the films are taken to have begun together (--sync people finds the time)")
    rig = recording / "calibration.toml"
    if until != "detect" and known is None:
        rig = out / "calibration.toml"
        words = ["calibrate", "extrinsics", recording, rig, "--update"]
        words += [] if height is None else ["--height", height]
        steps.run("calibrate", words, [recording / "keypoints"], rig)
    if until in ("poses", "export"):
        _results(steps, recording, rig, export=until == "export")


def _by_sound(
    steps: Steps, paths: Mapping[str, Path], sources: Mapping[str, Source], sync: str
) -> list[str]:
    """Return `CAMERA=SECONDS` of each film by its sound; nothing where that is not wanted."""
    if sync not in ("sound", "auto") or (sync == "auto" and not _have_sound(sources)):
        return []
    result = steps.folder / "sync.json"
    words = ["sync", *_named(paths), "--json", result]
    try:
        steps.run("sync", words, _files(paths), result)
    except InputError as error:
        if sync == "sound":
            raise
        print(f"sync: {error}")
        return []
    found = msgspec.json.decode(read_bytes(result, MAX_BYTES))["offsets_s"]
    return [f"{name}={seconds:.4f}" for name, seconds in found.items()]


def _detect(
    steps: Steps,
    paths: Mapping[str, Path],
    recording: Path,
    calibration: Path | None,
    options: Sequence[object],
) -> None:
    words, reads = ["detect", *_named(paths), recording, *options], _files(paths)
    if calibration is not None:
        words, reads = [*words, "--calibration", calibration], [*reads, calibration]
    steps.run("detect", words, reads, recording)


def _results(steps: Steps, recording: Path, rig: Path, export: bool) -> None:
    """Replay with all cameras and later slots, write the files of other tools, and conclude."""
    out = steps.folder
    poses, figures = out / "poses.parquet", out / "figures.json"
    words = ["replay", recording, "--cameras", "all", "--smooth", "rts", "--poses", poses,
             "--report", out / "report.html", "--json", figures]  # fmt: skip
    if len(load_recording(recording).rig) > 2:
        words += ["--hold-out", "each"]
    steps.run("poses", words, [recording / "keypoints", rig], poses)
    if export:
        for suffix in ("trc", "mot", "glb", *(["c3d"] if find_spec("ezc3d") else [])):
            steps.run("export", ["export", poses, out / f"poses.{suffix}"], [poses], poses)
        angles = out / "angles.csv"
        steps.run("export", ["export", poses, angles, "--angles"], [poses], angles)
    _conclude(out, figures)


def _named(paths: Mapping[str, Path]) -> list[object]:
    return [f"{name}={path}" for name, path in paths.items()]


def _files(paths: Mapping[str, Path]) -> list[Path]:
    return [chapter for path in paths.values() for chapter in chapters_of(path)]


def _stamp(path: Path) -> str:
    """Return what tells whether a file or the files of a folder have changed."""
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    try:
        stats = [file.stat() for file in files if not file.is_dir()]
    except OSError as error:
        raise InputError(str(path), error.strerror or "unreadable", "a file") from None
    newest = max((stat.st_mtime_ns for stat in stats), default=0)
    return f"{sum(stat.st_size for stat in stats)} bytes, {newest}"


def _have_sound(sources: Mapping[str, Source]) -> bool:
    for source in sources.values():
        sound = getattr(source, "sound", lambda rate, seconds: None)(8000, 1.0)
        if sound is None or not sound.any():
            return False
    return True


def _trimmed(trim: str | None, sources: Mapping[str, Source]) -> list[str]:
    """Return the options of detect for a part such as `3s:40s`, `3s:` or `:40s`."""
    if trim is None:
        return []
    begin, colon, end = trim.partition(":")
    try:
        begin_s = duration_s(begin) if begin.strip("0s.") else 0.0
        end_s = duration_s(end) if end else None
    except InputError:
        colon, begin_s, end_s = "", 0.0, None
    if not colon or (end_s is not None and end_s <= begin_s):
        raise InputError("--trim", repr(trim[:40]), "a part such as 3s:40s")
    fps = min(source.rate for source in sources.values())
    slots = [] if end_s is None else ["--max-slots", str(max(1, round((end_s - begin_s) * fps)))]
    return ["--start", f"{begin_s:g}", *slots]


def _conclude(out: Path, figures: Path) -> None:
    """Say how good it is, and where everything is."""
    found = msgspec.json.decode(read_bytes(figures, MAX_BYTES))
    median_mm = ((found.get("held_out") or {}).get("mean") or {}).get("median_mm")
    if median_mm is not None:
        print(f"Cameras that took no part: joints are {median_mm:.0f} mm off across their rays")
        if median_mm > DOUBTFUL_MM:
            red = "\033[31m{}\033[0m" if sys.stdout.isatty() else "{}"
            print(red.format("Do not trust this: check calibration and synchronisation with "
                             f"e3pose info {shell(out / 'recording')}"))  # fmt: skip
    print(f"Wrote {out}:")
    print("\n".join(f"  {name}: {what}" for name, what in ABOUT.items()))
