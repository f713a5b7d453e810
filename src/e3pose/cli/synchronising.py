"""`e3pose sync`: by how much the films of a recording are shifted in time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter

from e3pose.cli.output import JsonFile, is_stdout, write_json, wrote
from e3pose.cli.progress import stage_progress
from e3pose.errors import InputError

if TYPE_CHECKING:
    from e3pose.calibrate.synchronise import Synchrony
    from e3pose.recording import Recording


def sync(
    recording: Path,
    dest: Path | None = None,
    /,
    *,
    calibration: Path | None = None,
    max_shift: float = 10.0,
    seconds: float = 60.0,
    noise: str | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json_output: JsonFile = None,
) -> None:
    """Synchronise the cameras of a recording by the motion of the people in it.

    Example: `e3pose sync walk walk-in-step`

    Cameras that did not start together, or that deliver frames with a constant delay, are found
    from the people that they see at the same time; half a minute gives about a quarter of a frame.
    It works with and without a calibration. The command prints the offsets for `e3pose detect`
    and `e3pose calibrate extrinsics`, and the `delay_ms` of live cameras.

    Parameters
    ----------
    recording
        Recording folder, from `e3pose detect` or `e3pose record`.
    dest
        Write the synchronised recording here: each view in the slot in which it was taken.
    calibration
        Calibration file to use instead of the recording's own.
    max_shift
        Maximum difference between the start times, in seconds.
    seconds
        Use this many seconds from the start of the recording.
    noise
        Keypoint noise model, as in `e3pose replay`.
    overwrite
        Replace DEST if it exists.
    json_output
        Write the result here as JSON; - is standard output, which then contains nothing else.
    """
    from dataclasses import replace

    from e3pose.calibrate.recordings import first_seconds
    from e3pose.calibrate.synchronise import synchronise, with_offsets
    from e3pose.files.atomic import check_free
    from e3pose.model.noises import detector_of, load_noise
    from e3pose.recording import load_recording, save_recording
    from e3pose.recording.calibration import load_rig

    if not 0 < max_shift <= 600:
        raise InputError(f"--max-shift: found {max_shift:g}, expected more than 0, at most 600 s")
    if not 0 < seconds <= 3600:
        raise InputError(f"--seconds: found {seconds:g}, expected more than 0, at most 3600")
    if dest is not None:
        check_free(dest, overwrite)
    loaded = load_recording(recording)
    if len(loaded.rig) < 2:
        raise InputError(f"{recording}: has one camera, expected at least two")
    used = first_seconds(loaded, seconds + max_shift)
    if calibration is not None:
        rig = load_rig(calibration)
        used = replace(used, rig=rig.subset([rig.index(name) for name in used.rig.camera_ids]))
    with stage_progress() as (_, progress):
        found = synchronise(used, load_noise(noise or detector_of(loaded)), max_shift, progress)
    if dest is not None:
        save_recording(with_offsets(loaded, found.offsets_s), dest, overwrite)
    write_json(json_output, _values(loaded, found))
    if is_stdout(json_output):
        return
    for name, offset_s, sure_s in zip(
        loaded.rig.camera_ids, found.offsets_s, found.sure_s, strict=True
    ):
        sure = "" if np.isnan(sure_s) else f", pairs agree to {1000 * sure_s:.0f} ms"
        frames = offset_s * loaded.fps
        print(f"{name}: began at {offset_s:+.4f} s ({frames:+.2f} slots){sure}")
    options = " ".join(
        f"--offset {name}={offset_s:.4f}"
        for name, offset_s in zip(loaded.rig.camera_ids, found.offsets_s, strict=True)
    )
    print(f"Options of e3pose detect and e3pose calibrate extrinsics: {options}")
    delays = ", ".join(
        f"{name} {delay_ms:.0f}"
        for name, delay_ms in zip(loaded.rig.camera_ids, found.delays_ms, strict=True)
    )
    print(f"In a live site, add to the delay_ms of the cameras: {delays}")
    if dest is not None:
        wrote(dest, "each view in the slot in which it was taken")


def _values(recording: Recording, found: Synchrony) -> dict[str, object]:
    names = recording.rig.camera_ids
    return {
        "offsets_s": dict(zip(names, found.offsets_s.tolist(), strict=True)),
        "delays_ms": dict(zip(names, found.delays_ms.tolist(), strict=True)),
        "agreement_s": {
            name: None if np.isnan(value) else float(value)
            for name, value in zip(names, found.sure_s, strict=True)
        },
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
