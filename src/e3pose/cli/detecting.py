"""`e3pose detect`: find people in videos and write a recording."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

from cyclopts import Group, Parameter

from e3pose.base.atomic import check_free
from e3pose.base.errors import InputError, exit_code
from e3pose.base.quantities import plural, shell
from e3pose.camera.detect import DetectReport, DetectSettings, detect_videos, partial_folder
from e3pose.cli.network import ready_network
from e3pose.cli.options import OUTPUT, Flag, Whole, as_typed
from e3pose.cli.placed import warn_of_problems
from e3pose.cli.progress import bar
from e3pose.detectors import (
    AUTO,
    DETECTORS,
    Detector,
    identify,
    is_network,
    make_detector,
    side_by_side,
)
from e3pose.detectors.weights import find_weights, networks
from e3pose.detectors.weights.fetch import file_sha256
from e3pose.recording import load_recording
from e3pose.recording.calibration import load_calibration
from e3pose.settings.limits import Rotation
from e3pose.settings.loop import WHOLE_EVERY

# What errors call a setting, and the option that sets it.
OPTIONS = {"feedback": "--feedback", "offset": "--offset", "rotation": "--rotation"}


@Parameter(name="*", group=Group("Network", sort_key=1))
@dataclass(frozen=True, kw_only=True)
class NetworkOptions:
    """The network to run."""

    model: str = AUTO
    """A name from `e3pose models list`, the path of an .onnx or .pb file, a folder with the two
    files of a top-down detector, or your own detector as module:Name. `auto` takes the best that
    is installed, else downloads one."""
    family: str | None = None
    """With a model path: the detector that runs it. Default: from the model's inputs and
    outputs."""
    provider: Literal["auto", "tensorrt", "cuda", "openvino", "coreml", "cpu"] = "auto"
    """Execution provider of the network. `auto` takes the fastest available."""
    threads: Whole | None = None
    """CPU threads of the network. Default: all cores."""
    feedback: Flag = False
    """Detect where people are expected, by what all cameras found before, and enlarge or shrink
    that part of the image to the size the network finds people best at. Needs --calibration."""
    whole_every: Whole = WHOLE_EVERY
    """With --feedback, detect in the whole image once in this many frames."""


@Parameter(name="*", group=Group("Frames", sort_key=2))
@dataclass(frozen=True, kw_only=True)
class FrameOptions:
    """The frames of the videos to use."""

    fps: float | None = None
    """Slots per second. Default: the common frame rate of the videos; image folders need it."""
    every: Whole = 1
    """Keep every N-th slot only."""
    start: float = 0.0
    """Skip this many seconds at the start."""
    max_slots: Whole | None = None
    """Stop after this many slots."""
    offset: Annotated[list[str] | None, Parameter(negative="")] = None
    """CAMERA=SECONDS: capture time of that camera's first frame, for cameras that did not start
    together; repeatable."""
    rotation: Annotated[list[str] | None, Parameter(negative="")] = None
    """CAMERA=DEGREES: 0, 90, 180 or 270 clockwise, by which that camera's images are turned for
    the detector so that people are upright; repeatable. Keypoints stay in pixels of the video.
    Default: what a Caliscope calibration says, else 0."""
    as_stored: Flag = False
    """Ignore the turn that videos ask players for, if the calibration was made without it."""

    def rotations(self, calibration: Path | None) -> dict[str, int]:
        """Return the rotations of these options and of a calibration file."""
        given = camera_rotations(self.rotation or [])
        if calibration is None:
            return given
        known = load_calibration(calibration).rotations
        if used := {name: known[name] for name in known if name not in given}:
            listed = ", ".join(f"{name} {degrees} degrees" for name, degrees in used.items())
            print(f"images are turned for the detector, as {calibration} says: {listed}")
        return {**known, **given}


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True, kw_only=True)
class CopyOptions:
    """The use of the videos and of an earlier recording."""

    link_videos: Flag = False
    """Link the videos into the recording. Default: store their paths."""
    copy_videos: Flag = False
    """Copy the videos into the recording."""
    overwrite: Flag = False
    """Replace the recording at DEST, and partial work with other settings."""
    name: str | None = None
    """Name of the recording, the title of its pages. Default: that of DEST."""


NETWORK, FRAMES, COPY = NetworkOptions(), FrameOptions(), CopyOptions()


def detect(
    *paths: Annotated[str, Parameter(name="VIDEO... DEST")],
    calibration: Path | None = None,
    network: NetworkOptions = NETWORK,
    frames: FrameOptions = FRAMES,
    output: CopyOptions = COPY,
) -> None:
    """Detect people in videos and write a recording.

    Example: `e3pose detect cam1.mp4 cam2.mp4 walk --calibration rig.toml`

    A folder of numbered images stands for a video: `e3pose detect shelf/Camera* found --fps 25`.

    Chapters of one camera: `e3pose detect cam0=GX010001.MP4+GX020001.MP4 cam1=b.mp4 walk`.

    Each slot takes the frame of each camera that is nearest in time, at most half a slot away. You
    can interrupt the command: DEST.partial keeps the work, and the same command resumes it.

    Parameters
    ----------
    paths
        The videos or image folders, then the recording folder to create. A name that contains a
        camera id belongs to that camera; CAMERA=FILE assigns it explicitly.
    calibration
        Calibration file of the rig, in any supported format, or lenses only, from
        `e3pose calibrate intrinsics`. Without it, cameras are named after their videos, and
        `e3pose calibrate extrinsics` finds lenses and positions from the people.
    """
    if len(paths) < 2:
        given = plural(len(paths), "path")
        raise InputError(f"VIDEO... DEST: found {given}, expected videos, then the folder to write")
    if output.link_videos and output.copy_videos:
        raise InputError("--link-videos and --copy-videos: found both, expected at most one")
    *videos, last = paths
    dest = Path(last)
    if dest.is_file():
        raise InputError("DEST", f"the file {dest}", "a folder to create, after the videos")
    rotations = frames.rotations(calibration)
    settings = DetectSettings(
        fps=frames.fps,
        every=frames.every,
        start_s=frames.start,
        max_slots=frames.max_slots,
        rotations=rotations,
        offsets_s=camera_seconds(frames.offset or []),
        as_stored=frames.as_stored,
        keep_videos="link" if output.link_videos else "copy" if output.copy_videos else "refer",
        overwrite=output.overwrite,
        name=output.name,
        feedback=network.feedback,
        whole_every=network.whole_every,
        threads=network.threads,
    )
    check_free(dest, output.overwrite)
    known = None if calibration is None else load_calibration(calibration)
    rig = None if known is None else known.rig
    detector, name = _detector(network)
    with _resumable(dest), as_typed(OPTIONS), bar("detecting", transient=False) as progress:
        report = detect_videos(videos, rig, detector, dest, settings, name, progress)
    _print(dest, report)
    for note in () if known is None else known.notes:
        print(f"  {note}")
    if rig is None or not rig.placed:
        which = ", ".join(rig.unplaced if rig else ()) or "cameras"
        command = f"e3pose calibrate extrinsics {shell(dest)} rig.toml --height 171cm --update"
        print(f"  {which} not placed: {command}")
    else:
        warn_of_problems(load_recording(dest), dest)


def _detector(asked: NetworkOptions) -> tuple[Detector, str]:
    """Load the detector; also say which weights it runs: others do not continue its work."""
    model, family, known = ready_network(asked.model, live=False), asked.family, networks()
    named = model in known or model in DETECTORS
    if named and family is not None:
        raise InputError(f"--family: found {family!r} with --model {model}, expected a path")
    name, file = (model, None) if family is None else (family, Path(model))

    def load(threads: int | None) -> Detector:
        return make_detector(name, file, asked.provider, threads)

    with as_typed({"detector": "--model" if family is None else "--family"}):
        # With feedback one look follows the other, on all threads.
        detector = load(asked.threads) if asked.feedback else side_by_side(load, asked.threads)
    if named:
        if model not in known or known[model].source is None:
            return detector, model
        return detector, " ".join([model, *_checksums(find_weights(model))])
    path = Path(model)
    if family is None and not is_network(path):  # one's own
        return detector, model
    return detector, " ".join([family or identify(path), *_checksums(path)])


def _checksums(path: Path) -> list[str]:
    files = sorted(path.glob("*.onnx")) if path.is_dir() else [path]
    return [file_sha256(file)[:16] for file in files]


def camera_seconds(words: Sequence[str]) -> dict[str, float]:
    """Read words of --offset such as `cam1=0.25`; raise `InputError` if one is not so."""
    offsets: dict[str, float] = {}
    for word in words:
        camera_id, equals, seconds = word.rpartition("=")
        try:
            offsets[camera_id] = float(seconds)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--offset: found {word!r}, expected CAMERA=SECONDS")
    return offsets


def camera_rotations(words: Sequence[str]) -> dict[str, int]:
    """Read words of --rotation such as `cam1=90`; raise `InputError` if one is not so."""
    found: dict[str, int] = {}
    for word in words:
        camera_id, _, degrees = word.rpartition("=")
        angle = int(degrees) if degrees.isascii() and degrees.isdigit() else None
        if not camera_id or angle not in get_args(Rotation):
            raise InputError("--rotation", repr(word[:80]), "CAMERA=DEGREES with 0, 90, 180 or 270")
        found[camera_id] = int(degrees)
    return found


@contextmanager
def _resumable(dest: Path) -> Iterator[None]:
    """On the way out of an interrupted run, say how to go on."""
    try:
        yield
    except BaseException as error:
        kept = partial_folder(dest).is_dir() and not isinstance(error, InputError)
        hint = f"; {partial_folder(dest)} keeps the work, run the same command to resume"
        if isinstance(error, KeyboardInterrupt):
            print(f"e3pose: interrupted{hint if kept else ''}", file=sys.stderr)
            raise SystemExit(exit_code(error)) from None
        if kept:
            print(f"e3pose: stopped{hint}", file=sys.stderr)
        raise


def _print(dest: Path, report: DetectReport) -> None:
    print(f"Wrote {dest}: {plural(report.num_slots, 'slot')} at {report.fps:g} per second")
    for camera_id, camera in report.cameras.items():
        lost = report.num_slots - camera.frames
        notes = [f"{plural(lost, 'slot')} without a frame"] if lost else []
        notes += [camera.damage] if camera.damage else []
        tail = "; " + "; ".join(notes) if notes else ""
        people = plural(camera.people, "person", "people")
        print(f"  {camera_id}: {plural(camera.frames, 'frame')}, {people} detected{tail}")
    if report.without_video:
        print(f"  skipped, no video: {', '.join(report.without_video)}")
    if report.resumed_slots:
        print(f"  frames done before the interruption: {report.resumed_slots}")
