"""`e3pose init`: a site for the cameras and the machine that there are."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from rich.console import Console

from e3pose.base.atomic import check_free
from e3pose.base.errors import InputError
from e3pose.base.masking import masked
from e3pose.base.plugins import beside
from e3pose.base.quantities import plural, shell, three_digits
from e3pose.base.system import num_cores
from e3pose.camera.orientation import Orientation
from e3pose.camera.probe import Probe, probe, probe_all
from e3pose.camera.webcam import crowded_hubs, find_devices, lasting
from e3pose.cli.network import ready_network
from e3pose.cli.options import Whole, ask, warn
from e3pose.cli.progress import stage_progress
from e3pose.detectors import AUTO, DETECTORS
from e3pose.detectors.timing import DetectionTimes, Workload, time_detections
from e3pose.detectors.weights import find_weights, networks
from e3pose.recording.calibration import load_calibration, load_rig
from e3pose.recording.calibration.world import require_placed
from e3pose.settings.site_file import load_site
from e3pose.site.check.finding import report
from e3pose.site.check.sources import compare_rates
from e3pose.site.detector_speed import speed_problems
from e3pose.site.new_site import (
    RIG_FILE,
    Choice,
    name_sources,
    rates,
    site_name,
    threads_for,
    write_site,
)
from e3pose.wire.topics import check_site

if TYPE_CHECKING:
    from e3pose.model.camera import Rig


def init(
    folder: Path,
    /,
    *sources: Annotated[str, Parameter(name="SOURCE")],
    detector: str = AUTO,
    provider: Literal["auto", "tensorrt", "cuda", "openvino", "coreml", "cpu"] = "auto",
    threads: Whole | None = None,
    cameras: Whole | None = None,
    calibration: Path | None = None,
    name: str | None = None,
    fps: float | None = None,
    pace: float | None = None,
) -> None:
    """Create a site for your cameras whose settings fit this machine.

    Example: `e3pose init room usb:by-id/NAME usb:2 rtsp://10.0.0.7/stream`

    Reads one frame of each source, measures the frame rate of live sources for three seconds and
    the speed of the network with all cameras at work, and writes a commented site folder with the
    slots per second, threads and deadline that fit. It says what is missing, and the command for
    it.

    Parameters
    ----------
    folder
        The folder to create.
    sources
        What the cameras see: a webcam as `e3pose init room` alone lists it, usb:0, rtsp://...,
        http://..., a video. NAME=SOURCE names a camera. Webcams given by number are saved under the
        names that they keep. Default: the webcams of this machine; on a terminal you are asked.
    detector
        2D pose network: a name from `e3pose models list`, a network file, or module:Name.
        `auto` takes the best that is installed, else downloads one.
    provider
        Execution provider of the network.
    threads
        CPU threads of each network. Default: the cores, shared among the cameras of a slot.
    cameras
        Active cameras per slot. Default: 2.
    calibration
        Calibration file of the cameras, in any supported format.
    name
        Site name. Default: the folder's.
    fps
        Slots per second. Default: what this machine reaches, at most 25.
    pace
        Playback speed of videos. Default: as slow as this machine needs to follow them.
    """
    check_free(folder, None)
    given = name_sources(list(sources) or _asked())
    named = {camera_id: lasting(source) for camera_id, source in given.items()}
    rig = None if calibration is None else _rig(calibration, named)
    rotations = {} if calibration is None else load_calibration(calibration).rotations
    count = min(2 if cameras is None else cameras, len(named))
    if count < 1:
        raise InputError(f"--cameras: found {cameras}, expected 1 to {len(named)}")
    network = _network(detector)
    cores = num_cores()
    each = threads or threads_for(len(named), count, cores)
    probes = _probed(named, rig)
    times = _measured(network, provider, each, probes, rotations)
    choice = Choice(
        name=site_name(folder) if name is None else check_site(name),
        probes=probes,
        detector=network,
        provider=provider,
        threads=each,
        num_selected=count,
        times=times,
        rig=rig,
        fps=fps,
        pace=pace,
        rotations=rotations,
    )
    path = write_site(folder, choice)
    _report(choice, folder, path)


def _asked() -> list[str]:
    """Return the cameras of this machine; on a terminal, the ones that the user chooses."""
    devices = find_devices()
    for source, title in devices.items():
        print(f"found {source}: {title}")
    if not sys.stdin.isatty():
        if len(devices) < 2:
            raise InputError(
                f"SOURCE: found {plural(len(devices), 'camera')} on this machine, expected two or "
                "more sources: usb:0, rtsp://HOST/PATH, http://HOST/PATH or a video; `e3pose "
                "setup` finds cameras and phones, `e3pose simulate films --videos` makes films"
            )
        return list(devices)
    return _answers(list(devices))


def _answers(devices: list[str]) -> list[str]:
    ended = InputError("SOURCE: the input ended, expected an empty line after the last source")
    chosen = []
    for source in devices:
        if ask(f"use {source}? [Y/n] ", ended).strip().lower() in ("", "y", "yes"):
            chosen.append(source)
    another = "another source (rtsp://..., http://..., a video; empty to go on): "
    while word := ask(another, ended).strip():
        chosen.append(word)
    return chosen


def _rig(path: Path, named: dict[str, str]) -> Rig:
    rig = load_rig(path)
    require_placed(rig, path)
    for camera_id in named:
        if camera_id not in rig.camera_ids:
            known = ", ".join(rig.camera_ids)
            raise InputError(
                f"SOURCE: found camera {camera_id}, expected one of {known}, as the calibration "
                f"names them: {rig.camera_ids[0]}=SOURCE"
            )
    return rig.subset([rig.index(camera_id) for camera_id in rig.camera_ids if camera_id in named])


def _network(asked: str) -> str:
    """Return the network to use; raise `InputError` with the command that installs one."""
    asked = ready_network(asked, live=True)
    known = networks().get(asked)
    if known is not None and known.source is not None:
        find_weights(asked)  # or the error that says how to get them
    if known is not None or asked in DETECTORS:
        return asked
    path = Path(asked)
    return str(path.resolve()) if path.is_file() else beside(asked, Path())


def _probed(named: dict[str, str], rig: Rig | None) -> dict[str, Probe]:
    sizes = {} if rig is None else {seen.camera_id: seen.image_size for seen in rig.cameras}
    asked = {name: (source, sizes.get(name), None) for name, source in named.items()}
    for crowd, problem in crowded_hubs(asked):
        warn(f"cameras {', '.join(crowd)} {problem}")
    with stage_progress() as advance:
        tried = probe_all(
            {name: partial(probe, source, size=sizes.get(name)) for name, source in named.items()},
            partial(advance, "counting frames"),
        )
    found = {}
    for camera_id, seen in tried.items():
        if isinstance(seen, InputError):
            raise InputError(f"camera {camera_id}: {seen}")
        found[camera_id] = seen
        width, height = seen.image_size
        print(f"{camera_id}: {masked(named[camera_id])}, {width} x {height} at {seen.rate_words()}")
        for doubt in seen.doubts():
            warn(f"camera {camera_id}: {doubt}")
        if rig is not None:
            expected = rig.cameras[rig.index(camera_id)].image_size
            if seen.image_size != expected:
                raise InputError(
                    f"camera {camera_id}: found images of {width} x {height}, expected "
                    f"{expected[0]} x {expected[1]} as in the calibration"
                )
    return found


def _measured(
    network: str,
    provider: str,
    threads: int,
    probes: dict[str, Probe],
    rotations: Mapping[str, int],
) -> DetectionTimes:
    orientations = {name: Orientation.from_degrees(rotations.get(name, 0)) for name in probes}
    workloads = [
        Workload(network, None, provider, threads, orientations[name].size(*seen.image_size))
        for name, seen in probes.items()
    ]
    with Console(stderr=True).status(f"measuring {network}"):
        times = time_detections(workloads)
    alone_ms, all_ms = 1000 * times.alone_s.max(), 1000 * times.together_s.max()
    print(
        f"{network}, {plural(threads, 'thread')} each: {alone_ms:.3g} ms per detection, "
        f"{all_ms:.3g} ms while all {len(workloads)} cameras detect, "
        f"{three_digits(times.rate)} per second"
    )
    return times


def _report(choice: Choice, folder: Path, path: Path) -> None:
    fps, pace = rates(choice)
    slots = f"{fps:g} slots per second"
    if pace != 1:
        slots += f" of films that are played at {pace:g} of their speed"
    of = f"{choice.num_selected} of {len(choice.probes)} cameras active in each"
    print(f"Wrote {path}: {slots}, {of}")

    report(compare_rates(choice.probes, fps), warn)
    if choice.fps or choice.pace:
        assert choice.times is not None
        report(speed_problems(load_site(path), choice.times, choice.num_selected), warn)
    if choice.rig is None:
        print("Missing: the calibration. Let somebody walk through the room, then")
        print(f"  e3pose record {shell(folder)} walk --for 60")
        rig = shell(folder / RIG_FILE)
        print(f"  e3pose calibrate extrinsics walk {rig} --height 171cm --update")
        print("with the height of that person, which sets the scale.")
    print(f"Check it: e3pose check {shell(folder)}. Start it: e3pose up {shell(folder)}")
