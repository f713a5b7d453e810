"""`e3pose sync`: by how much the films of a recording are shifted in time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter

from e3pose.cli.progress import stage_progress
from e3pose.errors import InputError

if TYPE_CHECKING:
    from e3pose.calibrate.synchronise import Synchrony
    from e3pose.recording import Recording


def sync(
    recording: Path,
    dest: Path | None = None,
    *,
    calibration: Path | None = None,
    max_shift: float = 10.0,
    seconds: float = 60.0,
    noise: str | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json_output: Annotated[bool, Parameter(name="--json", negative="")] = False,
) -> None:
    """Synchronise the cameras of a recording by the motion of the people in it.

    Example: `e3pose sync walk walk-in-step`

    Works with and without a calibration, to about a quarter of a frame where people are seen by
    pairs of cameras for half a minute. Run `e3pose detect` again with the offsets that it prints,
    or let it write the recording anew.

    Parameters
    ----------
    recording
        The films' people, from `e3pose detect`.
    dest
        Write the recording here, each view in the slot in which it was taken.
    calibration
        Where the cameras stand, in the place of the recording's own.
    max_shift
        The films began at most so many seconds apart.
    seconds
        How much of the recording to use, from its start.
    noise
        How far off its detector's keypoints are, as for `e3pose replay`.
    overwrite
        Replace DEST if it exists.
    json_output
        Print JSON in the place of lines.
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
    if json_output:
        print(json.dumps(_values(loaded, found), indent=2))
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
    print(f"for e3pose detect and e3pose calibrate extrinsics: {options}")
    delays = ", ".join(
        f"{name} {delay_ms:.0f}"
        for name, delay_ms in zip(loaded.rig.camera_ids, found.delays_ms, strict=True)
    )
    print(f"for cameras of a live site, to add to their delay_ms: {delays}")
    if dest is not None:
        print(f"{dest}: written with the views in the slots in which they were taken")


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
