"""`e3pose reconstruct`: from films to the best 3D and the files of other tools, verb by verb."""

from __future__ import annotations

import csv
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from cyclopts import Group, Parameter

from e3pose import __version__
from e3pose.base.atomic import atomic_file, write_file
from e3pose.base.bounded import decode_json, read_bytes, read_toml
from e3pose.base.errors import Exit, InputError, exit_code
from e3pose.base.quantities import duration_s, plural, shell
from e3pose.base.system import num_cores
from e3pose.base.table import read_table
from e3pose.camera.source import Source, open_sources
from e3pose.cli.app import app
from e3pose.cli.network import ready_network
from e3pose.cli.options import OUTPUT, Flag, Whole, warn
from e3pose.cli.progress import Overall, overall
from e3pose.detectors import AUTO
from e3pose.evaluate.columns import print_tables, table_console
from e3pose.recording import load_recording
from e3pose.recording.calibration import load_calibration
from e3pose.recording.pairing import name_videos, pair_videos
from e3pose.recording.videos import chapters_of

FORMAT, VERSION = "e3pose-reconstruct", 1
STATE = "reconstruct.toml"  # in the folder of results: the options, commands, and what they read
MAX_BYTES = 2**20
FILMS = (".mp4", ".mkv", ".mov", ".avi", ".webm", ".m4v", ".mts", ".mpg")
MAX_TITLE = 120
# Seconds that steps take, for the bar: of a frame in the network, of a view in a replay, of others.
DETECT_S, VIEW_S, STEP_S = 0.05, 0.004, 2.0
SOLVE = """import opensim, sys
for tool, file in zip(sys.argv[1::2], sys.argv[2::2]):
    getattr(opensim, tool)(file).run()
"""
ABOUT = {
    "report.html": "open this first: how good it is, 3D player, films with skeletons",
    "poses.parquet": "3D poses, metres, z up",
    "poses*.trc, poses.c3d": "markers for OpenSim, Mokka, Visual3D",
    "poses*.mot, angles.csv": "joint angles",
    "poses.glb": "skeletons for Blender",
    "recording": "calibration and 2D keypoints, for `e3pose replay`",
    STATE: "what made this: e3pose reconstruct FILE --out OTHER repeats it",
}


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Options:
    """The videos to reconstruct, and how."""

    out: Annotated[Path, Parameter(group=OUTPUT)] = Path("reconstruction")
    """Folder of the results."""
    calibration: Path | None = None
    """Calibration file of the cameras. Without it, they are calibrated from the people."""
    height: str | None = None
    """Mean height of the people, such as 171cm: the scale of a calibration from people."""
    people: Whole | None = None
    """How many people there are: others are left out, and each keeps one number over all gaps."""
    sync: Literal["auto", "sound", "people", "none"] = "auto"
    """How to find the time between films: by sound, by the people, or none because they began
    together. Default: by sound if all films have sound, otherwise by the people if there is no
    calibration, otherwise none."""
    trim: str | None = None
    """Part of the films to use, such as 3s:40s."""
    model: str = AUTO
    """2D pose network, as in `e3pose detect`."""
    threads: Whole | None = None
    """CPU threads of the network. Default: all cores."""
    as_stored: Flag = False
    """Ignore the turn that films ask players for, if the calibration was made without it."""
    until: Annotated[Literal["detect", "calibrate", "poses", "export"], Parameter(group=OUTPUT)] = (
        "export"
    )
    """Last step to run."""
    opensim: Annotated[Path | None, Parameter(group=OUTPUT)] = None
    """OpenSim model (.osim) to scale to each person, with inverse kinematics. Without the package
    opensim only the set-up files are written."""


OPTIONS = Options()


def reconstruct(*films: str | Path, **options: Any) -> dict[str, Any]:
    """Make 3D poses, joint angles and a report of films, as `e3pose reconstruct` does.

    Returns the figures of `e3pose replay --json`, with `doubts` where nobody should trust the
    poses; empty if no poses were asked for.

    Args:
        films: of the same scene, a film or folder of images for each camera; or the one
            `reconstruct.toml` of an earlier reconstruction.
        options: those of the command, `height="171cm"`, `out="walk3d"` and so on.

    Raises:
        InputError: when the films cannot be reconstructed, with the reason.
    """
    asked = read_table(Options, {k: _plain(v) for k, v in options.items() if v is not None})
    try:
        return _reconstruct([str(film) for film in films], asked)
    except SystemExit as ended:
        raise InputError("reconstruct", f"exit code {ended.code}", "poses; see above") from None


def reconstruct_films(
    *films: str,
    options: Options = OPTIONS,
    jobs: Annotated[Whole | None, Parameter(group=Group("Trials"))] = None,
    cluster: Annotated[str | None, Parameter(group=Group("Trials"))] = None,
) -> None:
    """Make 3D poses, joint angles and a report from films, for one trial or many.

    Example: `e3pose reconstruct cam1.mp4 cam2.mp4 cam3.mp4 --calibration calibration.toml`

    Example: `e3pose reconstruct phone1.mp4 phone2.mp4 phone3.mp4 --height 171cm`

    Example: `e3pose reconstruct TRIALS --calibration calibration.toml`

    It finds the time between the films, detects people, calibrates from them where there is no
    calibration, estimates poses from all cameras, smooths them, checks them with each camera held
    out in turn, and writes TRC, C3D, MOT, CSV and glTF. Each step prints its command, and is
    skipped the next time unless its inputs changed. `reconstruct.toml` in the results repeats all:
    `e3pose reconstruct RESULTS/reconstruct.toml --out again`.

    Parameters
    ----------
    films
        Films of the same scene, paired with cameras as in `e3pose detect`. Or one folder with a
        folder of films for each trial: all of one calibration, that of the first trial without
        --calibration, and one table at the end.
    jobs
        Trials at a time. Default: as many as there are processor cores.
    cluster
        Address of a Dask scheduler for the trials, such as tcp://host:8786; all machines see the
        films at the same place.
    """
    trials = _trials(films)
    if trials:
        sys.exit(_run_trials(trials, options, jobs or num_cores(), cluster))
    if jobs is not None or cluster is not None:
        raise InputError("--jobs and --cluster", "films", "a folder with a folder for each trial")
    _conclude(_reconstruct(films, options), options.out)


def _reconstruct(films: Sequence[str], options: Options) -> dict[str, Any]:
    if len(films) == 1 and Path(films[0]).suffix == ".toml":
        films, options = _repeated(Path(films[0]), options)
    known = None if options.calibration is None else load_calibration(options.calibration)
    if len(films) < (3 if known is None else 2):
        wanted = "three cameras or more without --calibration, of two with it"
        raise InputError("FILM...", f"{len(films)}", f"films of {wanted}")
    paths = name_videos(films) if known is None else pair_videos(films, known.rig)
    placed = known is not None and known.rig.placed
    if placed and options.height is not None:
        raise InputError("--height", "beside --calibration", "one of them")
    if options.opensim is not None and not options.opensim.is_file():
        raise InputError("--opensim", f"no file {options.opensim}", "an OpenSim model, .osim")
    sources = open_sources(paths, None, None, options.as_stored)
    options = replace(options, model=ready_network(options.model, live=False))
    options.out.mkdir(parents=True, exist_ok=True)
    steps = Steps(options, paths)
    views = sum(source.num_frames for source in sources.values())
    expected = dict.fromkeys(("sync", "detect", "calibrate", "poses", "export"), STEP_S)
    expected |= {"detect": DETECT_S * views, "poses": STEP_S + VIEW_S * views * (1 + len(paths))}
    with overall("reconstruct", expected) as steps.bar:
        return _run(steps, paths, sources, placed)


def _run(
    steps: Steps, paths: Mapping[str, Path], sources: Mapping[str, Source], placed: bool
) -> dict[str, Any]:
    options, out = steps.options, steps.options.out
    recording, offsets = out / "recording", _by_sound(steps, paths, sources)
    _detect(steps, paths, recording, [*_trimmed(options.trim, sources), *offsets])
    if not offsets and (options.sync == "people" or (options.sync == "auto" and not placed)):
        keypoints, recording = recording / "keypoints", out / "recording-in-step"
        steps.run("sync", ["sync", out / "recording", recording], [keypoints], recording)
    elif not offsets:
        print("sync: the films are taken to have begun together (--sync people finds the time)")
    rig = recording / "calibration.toml"
    if options.until != "detect" and not placed:
        rig = out / "calibration.toml"
        words = ["calibrate", "extrinsics", recording, rig, "--update"]
        words += [] if options.height is None else ["--height", options.height]
        steps.run("calibrate", words, [recording / "keypoints"], rig)
    if options.until not in ("poses", "export"):
        return {}
    _results(steps, recording, rig)
    return decode_json(dict[str, Any], read_bytes(out / "figures.json", MAX_BYTES), out, "figures")


@dataclass(eq=False)
class Steps:
    """Runs commands whose inputs have changed since they ran last.

    Attributes:
        options: asked for.
        paths: camera id to film.
        bar: over all steps.
    """

    options: Options
    paths: Mapping[str, Path]
    bar: Overall | None = None
    _done: list[dict[str, Any]] = field(default_factory=list)
    _before: list[dict[str, Any]] = field(default_factory=list)
    _changed: bool = False

    def __post_init__(self) -> None:
        path = self.options.out / STATE
        if path.exists():
            self._before = [dict(step) for step in _state(path).get("step", [])]

    def run(
        self,
        name: str,
        words: Sequence[object],
        reads: Sequence[Path],
        makes: Path,
        parts: int = 1,
    ) -> None:
        """Run a command unless it ran before on the same files, and its result is there.

        `parts` is how many bars it shows.

        Raises:
            SystemExit: with its exit code if it failed.
        """
        if self.bar is not None:
            self.bar.begin(name, parts)
        texts = [str(word) for word in words]
        command = " ".join(["e3pose", *map(shell, texts)])
        inputs = {str(path): _stamp(path) for path in reads}
        step = {"name": name, "command": command, "inputs": inputs}
        old = self._before[len(self._done)] if len(self._done) < len(self._before) else None
        changed_before = self._changed
        self._changed |= old != step or not makes.exists()
        self._done.append(step)
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
        except InputError:  # not done, and the steps after it are as they were if it is left out
            self._done.pop()
            self._changed = changed_before
            raise
        asked = {k: _plain(v) for k, v in asdict(self.options).items() if v not in (None, False)}
        del asked["out"]
        films = {name: str(path.absolute()) for name, path in self.paths.items()}
        table = {
            "format": FORMAT,
            "version": VERSION,
            "e3pose": __version__,
            "asked": asked,
            "films": films,
            "bytes": {film: _bytes(Path(film)) for film in films.values()},
            "step": self._done,
        }
        write_file(self.options.out / STATE, tomli_w.dumps(table))


def _plain(value: Any) -> Any:
    return str(value.absolute()) if isinstance(value, Path) else value


def _state(path: Path) -> dict[str, Any]:
    found = read_toml(path, MAX_BYTES)
    if found.get("format") != FORMAT or found.get("version") != VERSION:
        raise InputError(f"{path}: expected format {FORMAT!r}, version {VERSION}")
    return found


def _repeated(path: Path, options: Options) -> tuple[list[str], Options]:
    """Return films and options of a reconstruction, to make it again in another folder."""
    if replace(options, out=OPTIONS.out) != OPTIONS:
        raise InputError(str(path), "beside other options", "--out alone")
    found = _state(path)
    for film, size in found.get("bytes", {}).items():
        if (now := _bytes(Path(film))) != size:
            raise InputError(film, f"{now} bytes", f"{size}, as when {path} was written")
    if found.get("e3pose") != __version__:
        warn(f"{path} was written by e3pose {found.get('e3pose')}: results may differ")
    films = [f"{name}={film}" for name, film in found.get("films", {}).items()]
    return films, replace(read_table(Options, found.get("asked", {})), out=options.out)


def _bytes(path: Path) -> int:
    return int(_stamp(path).partition(" ")[0])


def _by_sound(steps: Steps, paths: Mapping[str, Path], sources: Mapping[str, Source]) -> list[str]:
    """Return the options for when each film began by its sound; none where that is not wanted."""
    sync = steps.options.sync
    if sync not in ("sound", "auto") or (sync == "auto" and not _have_sound(sources)):
        return []
    result = steps.options.out / "sync.json"
    try:
        steps.run("sync", ["sync", *_named(paths), "--json", result], _files(paths), result)
    except InputError as error:
        if sync == "sound" or exit_code(error) == Exit.FAULT:
            raise
        print(f"sync: {error}")
        return []
    found = decode_json(dict[str, Any], read_bytes(result, MAX_BYTES), result, "offsets")
    return [f"--offset={name}={seconds:.4f}" for name, seconds in found["offsets_s"].items()]


def _detect(
    steps: Steps, paths: Mapping[str, Path], recording: Path, more: Sequence[object]
) -> None:
    options, files = steps.options, _files(paths)
    names = ", ".join(file.name for file in files)
    if len(names) > MAX_TITLE:
        names = f"{files[0].name} to {files[-1].name}, {plural(len(files), 'film')}"
    folders = {file.absolute().parent.name for file in files}
    title = f"{folders.pop()}: {names}" if len(folders) == 1 else names
    words = ["detect", *_named(paths), recording, "--model", options.model, *more]
    words += ["--name", title] + ["--as-stored"] * options.as_stored
    words += [] if options.threads is None else ["--threads", options.threads]
    if options.calibration is not None:
        words, files = [*words, "--calibration", options.calibration], [*files, options.calibration]
    steps.run("detect", words, files, recording)


def _results(steps: Steps, recording: Path, rig: Path) -> None:
    """Replay with all cameras and later slots, and write the files of other tools."""
    out, cameras = steps.options.out, len(load_recording(recording).rig)
    poses = out / "poses.parquet"
    words = ["replay", recording, "--cameras", "all", "--smooth", "rts", "--poses", poses,
             "--report", out / "report.html", "--json", out / "figures.json"]  # fmt: skip
    words += ["--hold-out", "each"] if cameras > 2 else []
    words += [] if steps.options.people is None else ["--people", steps.options.people]
    steps.run("poses", words, [recording / "keypoints", rig], poses, parts=1 + (cameras > 2))
    if steps.options.until != "export":
        return
    for suffix in ("trc", "mot", "glb", "c3d"):
        dest = out / f"poses.{suffix}"
        try:
            steps.run("export", ["export", poses, dest], [poses], _made(dest)[0])
        except InputError as error:  # such as more frames than the format can hold
            if exit_code(error) == Exit.FAULT:
                raise
            warn(f"{out}: left out {dest.name}: {error}")
        for path in _made(dest):  # an older one: of other films, or of people who are not in these
            if path.exists() and path.stat().st_mtime_ns < poses.stat().st_mtime_ns:
                path.unlink()
    angles = out / "angles.csv"
    steps.run("export", ["export", poses, angles, "--angles"], [poses], angles)
    if (model := steps.options.opensim) is not None:
        folder = out / "opensim"
        folder.mkdir(exist_ok=True)
        words = ["export", poses, folder / "poses.trc", "--names", "pose2sim", "--fill", "300ms",
                 "--osim", model]  # fmt: skip
        steps.run("export", words, [poses, model], _made(folder / "poses.trc")[0])
        _solve(folder)


def _made(dest: Path) -> list[Path]:
    """Return the files of an export: those of each person if they are there, and the one."""
    return [*dest.parent.glob(f"{dest.stem}-track*{dest.suffix}"), dest]


def _solve(folder: Path) -> None:
    """Scale the model to each person and solve inverse kinematics, in a process of its own."""
    tools = [("ScaleTool", path.name) for path in sorted(folder.glob("*-scale.xml"))]
    tools += [("InverseKinematicsTool", path.name) for path in sorted(folder.glob("*-ik.xml"))]
    if find_spec("opensim") is None:
        print(f"opensim is not installed (pip install opensim): {folder} has the set-ups of its "
              "tools, for opensim-cmd run-tool FILE or its window")  # fmt: skip
        return
    words, log = [word for tool in tools for word in tool], folder / "opensim.log"
    command = [sys.executable, "-c", SOLVE, *words]
    with log.open("w") as file:
        ended = subprocess.run(command, cwd=folder, stdout=file, stderr=file)
    if ended.returncode:
        warn(f"opensim ended with code {ended.returncode}: {log}")
    else:
        print(f"opensim: scaled models (*-scaled.osim) and angles (*-ik.mot) in {folder}")


def _named(paths: Mapping[str, Path]) -> list[object]:
    return [f"{name}={path}" for name, path in paths.items()]


def _files(paths: Mapping[str, Path]) -> list[Path]:
    return [chapter for path in paths.values() for chapter in chapters_of(path)]


def _stamp(path: Path) -> str:
    """Return a value that differs if a file, or a file of a folder, has changed."""
    files = [
        f for each in chapters_of(path) for f in (each.rglob("*") if each.is_dir() else [each])
    ]
    try:
        stats = [file.stat() for file in sorted(files) if not file.is_dir()]
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


def _held_out_mm(figures: Mapping[str, Any]) -> float | None:
    return figures.get("held_out", {}).get("mean", {}).get("median_mm")  # type: ignore[no-any-return]


def _conclude(figures: Mapping[str, Any], out: Path) -> None:
    """Say how good it is, and where everything is."""
    if (held_out_mm := _held_out_mm(figures)) is not None:
        print(f"Cameras that took no part: joints are {held_out_mm:.0f} mm off across their rays")
    red = "\033[31m{}\033[0m" if sys.stdout.isatty() else "{}"
    for doubt in figures.get("doubts", ()):
        print(red.format(f"Do not trust this: {doubt}"))
    print(f"Wrote {out}:")
    if figures:
        print("\n".join(f"  {name}: {what}" for name, what in ABOUT.items()))


def _trials(films: Sequence[str]) -> dict[str, list[str]]:
    """Return the films of each trial, by name, where there is one folder of such folders."""
    folder = Path(films[0]) if len(films) == 1 else Path()
    found: dict[str, list[str]] = {}
    for trial in sorted(folder.iterdir()) if len(films) == 1 and folder.is_dir() else ():
        if trial.is_dir():
            names = sorted(str(p) for p in trial.iterdir() if p.suffix.lower() in FILMS)
            found |= {trial.name: names} if len(names) > 1 else {}
    return found


def _run_trials(
    trials: Mapping[str, list[str]], options: Options, jobs: int, cluster: str | None
) -> Exit:
    """Reconstruct trials side by side, and print a table of them; `NO` if one failed."""
    options = replace(options, model=ready_network(options.model, live=False))
    rest, rows = dict(trials), {}
    if options.calibration is None:
        first = next(iter(rest))
        print(f"calibrating all trials by {first}, the first (--calibration names another)")
        rows[first] = _trial(first, rest.pop(first), options)
        calibration = options.out / first / "calibration.toml"
        options = replace(options, calibration=calibration, height=None)
        if not calibration.is_file():
            raise InputError(first, rows[first]["problem"], "a trial that can be calibrated")
    if options.threads is None and jobs > 1:
        options = replace(options, threads=max(1, num_cores() // min(jobs, len(trials))))
    from joblib import Parallel, delayed, parallel_config

    with ExitStack() as running:
        if cluster is not None:
            from distributed import Client

            running.enter_context(Client(cluster))
        backend = "loky" if cluster is None else "dask"
        running.enter_context(parallel_config(backend, n_jobs=jobs))
        tasks = [delayed(_trial)(name, films, options) for name, films in rest.items()]
        rows |= zip(rest, Parallel(batch_size=1)(tasks), strict=True)
    columns = {head: [row[head] for row in rows.values()] for head in next(iter(rows.values()))}
    print_tables(table_console(), {"trial": list(rows)}, columns, left=("trial", "problem"))
    with atomic_file(options.out / "trials.csv") as path, path.open("w", newline="") as file:
        table = csv.DictWriter(file, ["trial", *columns], lineterminator="\n")
        table.writeheader()
        table.writerows({"trial": name, **row} for name, row in rows.items())
    print(f"Wrote {options.out}: a folder for each trial, and trials.csv")
    failed = any(row["problem"].startswith("failed") for row in rows.values())
    return Exit.NO if failed else Exit.DONE


def _trial(name: str, films: Sequence[str], options: Options) -> dict[str, str]:
    """Reconstruct a trial; return its row of the table. What it says goes to a file."""
    out = options.out / name
    out.mkdir(parents=True, exist_ok=True)
    problem, figures = "", dict[str, Any]()
    with (out / "log.txt").open("w", encoding="utf-8") as log:
        try:
            with redirect_stdout(log), redirect_stderr(log):
                figures = _reconstruct(films, replace(options, out=out))
            problem = " ".join(figures.get("doubts", ()))
        except InputError as error:
            problem = f"failed: {error}"
        except SystemExit as ended:
            problem = f"failed: exit code {ended.code}: {out / 'log.txt'}"
    held_out_mm = _held_out_mm(figures)
    return {
        "films": str(len(films)),
        "slots": str(figures.get("slots", "-")),
        "people": str(figures.get("identities", "-")),
        "held-out mm": "-" if held_out_mm is None else f"{held_out_mm:.0f}",
        "problem": problem,
    }
