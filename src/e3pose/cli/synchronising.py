"""`e3pose sync`: by how much videos are shifted in time, from their sound or their people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from e3pose.base.arrays import Floats
from e3pose.base.atomic import check_free
from e3pose.base.errors import InputError
from e3pose.base.quantities import check_within
from e3pose.calibrate.recordings import first_seconds
from e3pose.camera.provenance import load_provenance, save_provenance
from e3pose.camera.source import open_video
from e3pose.cli.options import Flag, warn
from e3pose.cli.output import JsonFile, is_stdout, write_json, wrote
from e3pose.cli.progress import stage_progress
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import Recording, load_recording, save_recording
from e3pose.recording.calibration import load_rig
from e3pose.recording.pairing import name_videos

if TYPE_CHECKING:
    from e3pose.calibrate.synchronise import Synchrony


ENOUGH_S = 8.0  # of people, to solve a calibration on the way
MOST_APART = 0.5  # slots between pairs of cameras


def sync(
    *paths: str,
    calibration: Path | None = None,
    max_shift: float = 10.0,
    seconds: float = 60.0,
    noise: str | None = None,
    overwrite: Flag = False,
    json_output: JsonFile = None,
) -> None:
    """Synchronise videos by their sound, or a recording by the motion of the people in it.

    Examples: `e3pose sync cam1.mp4 cam2.mp4 cam3.mp4`, `e3pose sync walk walk-in-step`

    Videos that recorded the same sounds need nothing else: three claps give about 10 ms, because
    sound takes 3 ms per metre.

    In a recording, cameras that did not start together, or that deliver frames with a constant
    delay, are found from the people that they see at the same time; half a minute of walking gives
    about a quarter of a frame. It works with and without a calibration. The command prints the
    offsets for `e3pose detect` and `e3pose calibrate extrinsics`, and the `delay_ms` of live
    cameras.

    Parameters
    ----------
    paths
        VIDEO VIDEO...: videos with sound. Or RECORDING DEST: a recording folder, from `e3pose
        detect` or `e3pose record`, and optionally where to write the synchronised recording, each
        view in the slot in which it was taken.
    calibration
        With a recording: calibration file to use instead of its own.
    max_shift
        Maximum difference between the start times, in seconds.
    seconds
        Use this many seconds from the start.
    noise
        With a recording: keypoint noise model, as in `e3pose replay`.
    overwrite
        Replace DEST if it exists.
    json_output
        Write the result here as JSON; - is standard output, which then contains nothing else.
    """
    check_within("--max-shift", max_shift, 1e-3, 600)
    check_within("--seconds", seconds, 1e-3, 3600)
    if not paths:
        raise InputError("PATH: found none, expected videos with sound, or a recording")
    if Path(paths[0]).is_dir() or (len(paths) == 1 and "=" not in paths[0]):
        _by_people(paths, calibration, max_shift, seconds, noise, overwrite, json_output)
        return
    if calibration is not None or noise is not None or overwrite:
        raise InputError("--calibration, --noise, --overwrite: expected only with a recording")
    _by_sound(paths, max_shift, seconds, json_output)


def _by_sound(
    paths: Sequence[str], max_shift: float, seconds: float, json_output: Path | None
) -> None:
    from e3pose.calibrate.synchronise import RATE, shifts_by_sound

    videos = {name: open_video(path) for name, path in name_videos(paths).items()}
    if len(videos) < 2:
        raise InputError("VIDEO...: found one video, expected at least two")
    sounds = {}
    for name, video in videos.items():
        sound = video.sound(RATE, seconds + max_shift)
        if sound is None or not sound.any():
            raise InputError(
                f"{video.path}: has no sound, expected videos that recorded the same sounds; from "
                "people: e3pose detect, then e3pose sync RECORDING"
            )
        sounds[name] = sound
    found = shifts_by_sound(sounds, max_shift)
    offsets_s = dict(zip(videos, found.offsets_s.tolist(), strict=True))
    agreement_s = _or_none(videos, found.sure_s)
    write_json(json_output, {"offsets_s": offsets_s, "agreement_s": agreement_s})
    if not is_stdout(json_output):
        rates = [video.rate for video in videos.values()]
        print("\n".join(_lines(list(videos), found.offsets_s, found.sure_s, rates, "frames")))


def _by_people(
    paths: Sequence[str],
    calibration: Path | None,
    max_shift: float,
    seconds: float,
    noise: str | None,
    overwrite: bool,
    json_output: Path | None,
) -> None:
    from e3pose.calibrate.synchronise import synchronise, with_offsets

    if len(paths) > 2:
        raise InputError(f"RECORDING DEST: found {len(paths)} paths, expected one or two")
    recording, dest = Path(paths[0]), Path(paths[1]) if len(paths) > 1 else None
    if dest is not None:
        check_free(dest, overwrite)
    loaded = load_recording(recording)
    if len(loaded.rig) < 2:
        raise InputError(f"{recording}: has one camera, expected at least two")
    used = first_seconds(loaded, seconds + max_shift)
    if calibration is not None:
        rig = load_rig(calibration)
        used = replace(used, rig=rig.subset([rig.index(name) for name in used.rig.camera_ids]))
    with stage_progress() as progress:
        found = synchronise(used, load_noise(noise or detector_of(loaded)), max_shift, progress)
    if dest is not None:
        save_recording(with_offsets(loaded, found.offsets_s), dest, overwrite)
        noted = load_provenance(recording)
        later_s = dict(
            zip(loaded.rig.camera_ids, found.offsets_s - found.offsets_s.min(), strict=True)
        )
        starts_s = {
            name: noted.video_starts_s.get(name, 0.0) - float(later_s[name])
            for name in loaded.videos
        }
        save_provenance(dest, noted.settings, starts_s, noted.rotations, noted.as_stored)
    write_json(json_output, _values(loaded, found))
    if is_stdout(json_output):
        return
    names = loaded.rig.camera_ids
    warn(_doubt(used, found))
    rates = [loaded.fps] * len(names)
    print("\n".join(_lines(names, found.offsets_s, found.sure_s, rates, "slots")))
    delays = ", ".join(
        f"{name} {delay_ms:.0f}"
        for name, delay_ms in zip(loaded.rig.camera_ids, found.delays_ms, strict=True)
    )
    print(f"In a live site, add to the delay_ms of the cameras: {delays}")
    if dest is not None:
        wrote(dest, "each view in the slot in which it was taken")


def _doubt(used: Recording, found: Synchrony) -> str:
    """Return why offsets may be wrong, and what to record; empty if nothing says so."""
    seconds = used.num_slots / used.fps
    record = "record a person who walks through the room for half a minute"
    if not used.rig.placed and seconds < ENOUGH_S:
        return (
            f"{seconds:.1f} s of people without a calibration are too little to trust these "
            f"offsets: {record}, pass --calibration, or sync the videos by their sound"
        )
    apart = float(np.nanmax([0.0, *found.sure_s])) * used.fps
    if apart > MOST_APART:
        return (
            f"pairs of cameras disagree by up to {apart:.1f} slots, so that these offsets are "
            f"unsure: {record}"
        )
    return ""


def _lines(
    names: Sequence[str], offsets_s: Floats, sure_s: Floats, rates: Sequence[float], unit: str
) -> list[str]:
    lines = []
    for name, offset_s, own_s, rate in zip(names, offsets_s, sure_s, rates, strict=True):
        sure = "" if np.isnan(own_s) else f", pairs agree to {1000 * own_s:.0f} ms"
        lines.append(f"{name}: began at {offset_s:+.4f} s ({offset_s * rate:+.2f} {unit}){sure}")
    given = zip(names, offsets_s, strict=True)
    options = " ".join(f"--offset {name}={offset_s:.4f}" for name, offset_s in given)
    return [*lines, f"Options of e3pose detect and e3pose calibrate extrinsics: {options}"]


def _or_none(names: Iterable[str], sure_s: Floats) -> dict[str, float | None]:
    given = zip(names, sure_s.tolist(), strict=True)
    return {name: None if np.isnan(value) else value for name, value in given}


def _values(recording: Recording, found: Synchrony) -> dict[str, object]:
    names = recording.rig.camera_ids
    return {
        "offsets_s": dict(zip(names, found.offsets_s.tolist(), strict=True)),
        "delays_ms": dict(zip(names, found.delays_ms.tolist(), strict=True)),
        "agreement_s": _or_none(names, found.sure_s),
        "pairs": [
            {
                "first": names[pair.first],
                "second": names[pair.second],
                "shift_s": pair.slots / recording.fps,
                "by_geometry": pair.by_geometry,
            }
            for pair in found.pairs
        ],
    }
