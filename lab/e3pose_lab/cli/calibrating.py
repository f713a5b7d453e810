"""`e3pose calibrate noise`: how far off a detector's keypoints are."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from e3pose.base.atomic import write_file
from e3pose.base.errors import InputError
from e3pose.cli.calibrating import calibrate_app
from e3pose.cli.options import Flag, check_outputs
from e3pose.cli.output import wrote
from e3pose.cli.placed import load_placed
from e3pose.cli.progress import stage_progress
from e3pose.evaluate.columns import table_console
from e3pose.model.noises import detector_of, encode_noise, load_noise_file
from e3pose.model.slot_record import SlotRecord
from e3pose_lab.evaluate.drawing import check_svg

MAX_SECONDS = 3600.0


@calibrate_app.command
def noise(
    recording: Path,
    /,
    *,
    out: Path | None = None,
    plot: Path | None = None,
    seconds: float = 120.0,
    other_rigs: Flag = False,
    detector: str | None = None,
) -> None:
    """Measure keypoint noise against detection score, without labels.

    Example: `e3pose calibrate noise walk --out my-noise.toml`

    Then: `e3pose replay other-walk --noise my-noise.toml`

    The command tracks people with all cameras, smooths each track over all cameras but one, and
    compares that camera's keypoints with the result (leave-one-out). It needs at least three
    cameras with overlapping views. The error is about 10 % with five cameras and 20 % with three.

    Parameters
    ----------
    recording
        Recording folder.
    out
        Write the noise model (.toml) here, for --noise.
    plot
        Write a plot (.svg) here.
    seconds
        Use this many seconds from the start of the recording.
    other_rigs
        Remove constant offsets per camera, which come from calibration errors. Use it for a model
        that serves other rigs too.
    detector
        Detector name in the model. Default: the recording's.
    """
    from e3pose_lab.noise.calibrate import calibrate_noise
    from e3pose_lab.noise.report import as_file, draw_noise, print_noise

    _check(seconds, detector)
    if plot is not None:
        check_svg("--plot", plot)
    check_outputs(recording, {"--out": out, "--plot": plot})
    source = load_placed(recording)
    shipped = load_noise_file(detector_of(source))
    slots = min(source.num_slots, round(seconds * source.fps))
    with stage_progress() as progress:

        def tracked(records: Iterable[SlotRecord]) -> Iterator[SlotRecord]:
            for done, record in enumerate(records, 1):
                yield record
                progress("tracking people", done, slots)

        calibrated = calibrate_noise(
            source,
            seconds=seconds,
            without_shifts=other_rigs,
            replayed=tracked,
            progress=progress,
        )
    file = as_file(
        calibrated, source.rig, detector or shipped.detector, f"{source.name}: {source.source}"
    )
    correlations = calibrated.measured.autocorrelation
    if out is not None:
        write_file(out, encode_noise(file))
        wrote(out)
    if plot is not None:
        draw_noise(plot, file, correlations, shipped)
        wrote(plot)
    console = table_console(160)
    learned = dict(zip(source.rig.camera_ids, calibrated.learned.tolist(), strict=True))
    print_noise(file, correlations, console, learned, shipped.detector)


def _check(seconds: float, detector: str | None) -> None:
    if not 0 < seconds <= MAX_SECONDS:
        raise InputError(f"--seconds: found {seconds:g}, expected more than 0, at most 3600")
    if detector is not None and not (0 < len(detector) <= 200 and detector.isprintable()):
        raise InputError(f"--detector: found {detector[:40]!r}, expected 1 to 200 characters")
