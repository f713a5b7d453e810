"""`e3pose calibrate extrinsics --only`: a camera that was knocked, placed anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from e3pose.base.atomic import write_file
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural, shell
from e3pose.calibrate.recordings import last_seconds
from e3pose.cli.calibrating_lenses import toml_path
from e3pose.cli.output import is_stdout, write_json
from e3pose.model.noises import detector_of, load_noise
from e3pose.recording import Recording, load_recording
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.recording.writer import PARTIAL, as_far_as_written
from e3pose.settings.site_file import load_site

if TYPE_CHECKING:
    from e3pose.model.camera import Rig


ENOUGH_S = 20.0  # of views by the camera


def place_again(
    paths: Sequence[str], camera_id: str, seconds: float, noise: str | None, json_path: Path | None
) -> None:
    """Place one camera of a site or a recording anew, and write the calibration.

    Args:
        paths: the site or the recording, and where to write if not to the site's own file.
        camera_id: which camera.
        seconds: how much to use, from the end.
        noise: name or file of the noise model; by default the detector's.
        json_path: where to write the result as JSON; `-` is standard output.
    """
    from e3pose.calibrate.people_places import place_one

    if not 1 <= len(paths) <= 2:
        given = plural(len(paths), "path")
        raise InputError(f"--only: found {given}, expected SITE, or a recording and DEST")
    source = Path(paths[0])
    if (source / "recording.toml").is_file():
        if len(paths) < 2:
            raise InputError("--only: found a recording alone, expected the file to write after it")
        whole, dest = load_recording(source), toml_path(paths[1])
        recording, rig = last_seconds(whole, seconds), whole.rig
        if not rig.placed:
            raise InputError(f"{source}: has no calibration, expected the one from before --only")
    else:
        recording, rig, own = _of_site(source, camera_id, seconds)
        dest = toml_path(paths[1]) if len(paths) == 2 else own
    found = place_one(recording, load_noise(noise or detector_of(recording)), rig, camera_id)
    kept = _set_aside(dest)
    save_rig(found.rig, dest)
    values = {
        "camera": camera_id,
        "turned_deg": found.degrees,
        "moved_m": found.metres,
        "reprojection_error_px": found.error_px,
        "inliers": found.inliers,
        "joints": found.points,
    }
    write_json(json_path, values)
    if is_stdout(json_path):
        return
    print(
        f"{camera_id}: turned by {found.degrees:.2f} degrees, moved by {1000 * found.metres:.0f} "
        f"mm; {found.error_px:.1f} px, {100 * (1 - found.inliers):.0f} % outliers of {found.points}"
    )
    before = f"; the previous file is {kept}" if kept else ""
    print(f"Wrote {dest}: the other cameras as they were{before}")
    if len(paths) == 1:
        print("Restart the edge to use it.")


def _of_site(path: Path, camera_id: str, seconds: float) -> tuple[Recording, Rig, Path]:
    """Return a site's newest recording, its calibration and the file of that."""
    site = load_site(path)
    own = site.calibration
    rig = load_rig(own)
    folder = site.record.path
    rig.index(camera_id)
    recording, longest_s = _newest(folder, camera_id, seconds)
    if recording is None and longest_s > 0:
        raise InputError(
            str(folder),
            f"{longest_s:.0f} s of what {camera_id} saw",
            f"{ENOUGH_S:.0f} s; if the site runs, try again in a while",
        )
    if recording is None:
        raise InputError(
            f"{folder}: found no recording of {ENOUGH_S:.0f} s, expected what the cameras saw "
            'since: set record = "keypoints" in [[camera]] of the site file, or stop the edge and '
            f"run e3pose record {shell(path)} walk --for 60"
        )
    rig = rig.subset([rig.index(name) for name in recording.rig.camera_ids])
    return replace(recording, rig=rig), rig, toml_path(str(own))


def _newest(folder: Path, camera_id: str, seconds: float) -> tuple[Recording | None, float]:
    """Return the end of the newest recording in a folder, the one that is being written first.

    None where the camera was active too seldom in all of them, and for how many seconds at most.
    """
    longest_s = 0.0
    parts = folder.iterdir() if folder.is_dir() else ()
    for part in sorted(parts, key=lambda part: part.name.removesuffix(PARTIAL), reverse=True):
        found = None
        if part.name.endswith(PARTIAL):
            with as_far_as_written(part) as copy:
                found = None if copy is None else load_recording(copy)
        elif (part / "recording.toml").is_file():
            found = load_recording(part)
        if found is None or camera_id not in found.rig.camera_ids:
            continue
        looked_s = len(found.views[found.rig.index(camera_id)].slots) / found.fps
        longest_s = max(longest_s, looked_s)
        if looked_s >= ENOUGH_S:
            return last_seconds(found, seconds), longest_s
    return None, longest_s


def _set_aside(dest: Path) -> Path | None:
    """Keep the file that is about to be replaced beside it."""
    if not dest.is_file():
        return None
    kept = dest.with_name(f"{dest.stem}.before{dest.suffix}")
    write_file(kept, dest.read_bytes())
    return kept
