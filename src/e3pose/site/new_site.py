"""Write a site file with settings that fit this machine."""

from __future__ import annotations

import platform
import re
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

import tomli_w

from e3pose.base.atomic import atomic_folder, check_free
from e3pose.base.errors import InputError
from e3pose.base.quantities import plural, shell, three_digits
from e3pose.base.system import claim_address, num_cores
from e3pose.camera.probe import Probe
from e3pose.detectors.timing import DetectionTimes
from e3pose.energy.profiles import load_profile
from e3pose.model.camera import Rig
from e3pose.model.camera_fields import check_camera_id
from e3pose.recording.calibration import save_rig
from e3pose.settings.resolved import resolve
from e3pose.settings.site_file import SITE_FILE, load_site
from e3pose.settings.sources import is_live, located, place_of, put_away
from e3pose.site.detector_speed import (
    KEPT,
    save_times,
    suggested_deadline_ms,
    suggested_fps,
    workloads_of,
)
from e3pose.site.example import free_port
from e3pose.wire.topics import check_site

RIG_FILE = "rig.toml"
USUAL_PORT = 7447
MOST_FPS = 25.0  # beyond it, poses get no better
LEAST_DEADLINE_MS = 150
PROFILE = "xavier-nx"


@dataclass(frozen=True, slots=True)
class Choice:
    """The choices for a new site.

    Attributes:
        name: of the site.
        probes: by camera, what it sees.
        detector: name of the network, or its file; empty where keypoints are recorded.
        provider: where the network runs.
        threads: of the processor, for each camera.
        num_selected: active cameras per slot.
        times: of detections; None without a detector.
        rig: the calibration; None if it is missing.
        fps: slots per second, if given.
        pace: playback speed of files, if given.
        rotations: by camera, degrees clockwise by which its images are turned for the network.
    """

    name: str
    probes: Mapping[str, Probe]
    detector: str
    provider: str
    threads: int
    num_selected: int
    times: DetectionTimes | None
    rig: Rig | None = None
    fps: float | None = None
    pace: float | None = None
    rotations: Mapping[str, int] = field(default_factory=dict)

    @property
    def files(self) -> bool:
        """Whether all that is seen was recorded before."""
        return not any(is_live(probe.source) for probe in self.probes.values())


def name_sources(words: list[str]) -> dict[str, str]:
    """Return sources by the ids of their cameras.

    `CAMERA=SOURCE` says it outright; a file is named after itself, another source by its number.

    Args:
        words: as typed; files relative to the current folder.

    Raises:
        InputError: when two have one name, or a name is none.
    """
    named: dict[str, str] = {}
    for number, word in enumerate(words, 1):
        camera_id, equals, source = word.partition("=")
        if not equals or "/" in camera_id or ":" in camera_id or Path(word).exists():
            camera_id, source = "", word
        if place_of(source) is not None:
            if source.isdigit() and not Path(source).exists():
                raise InputError("source", repr(source), f"usb:{source} for /dev/video{source}")
            stem = re.sub(r"[^A-Za-z0-9_.-]", "_", Path(place_of(source) or "").stem)[:64]
            camera_id, source = camera_id or stem, located(source, lambda at: Path(at).resolve())
        camera_id = camera_id or f"cam{number}"
        check_camera_id(camera_id)
        if camera_id in named:
            raise InputError("source", f"two cameras {camera_id}", "NAME=SOURCE with other names")
        named[camera_id] = source
    if len(named) < 2:
        raise InputError("SOURCE", plural(len(named), "source"), "two or more: 3D needs them")
    return named


def site_name(folder: Path) -> str:
    """Return the name of a site after its folder."""
    name = re.sub(r"[^A-Za-z0-9_.-]", "-", folder.resolve().name)[:64] or "site"
    return check_site(name)


def threads_for(num_cameras: int, num_selected: int, cores: int) -> int:
    """Return how many threads each network gets where cameras share a machine."""
    return max(1, cores // max(1, min(num_cameras, num_selected)))


def rates(choice: Choice) -> tuple[float, float]:
    """Return slots per second of the scene and the pace that a machine keeps up with.

    Films can be played slower, so that their slots are as many as those of a quick machine; a
    camera that films cannot wait, so its slots are fewer.
    """
    source_fps = min(probe.fps for probe in choice.probes.values())
    wanted = choice.fps or min(source_fps, MOST_FPS)
    if choice.times is None:
        return wanted, choice.pace or 1.0
    reach = suggested_fps(choice.times, choice.num_selected)
    if choice.pace is None and choice.files and reach < wanted:
        return wanted, max(float(f"{reach / wanted:.2g}"), 0.001)
    pace = choice.pace or 1.0
    return choice.fps or min(wanted, float(f"{reach / pace:.3g}")), pace


def write_site(folder: Path, choice: Choice) -> Path:
    """Write a new folder with the site file, and the calibration if there is one.

    Raises:
        InputError: when something stands in the folder.
    """
    check_free(folder)
    with atomic_folder(folder, private=True) as made:
        fill_site(made, choice, folder)
    return folder / SITE_FILE


def fill_site(made: Path, choice: Choice, folder: Path) -> None:
    """Write the files of a site to a folder that is there.

    Args:
        made: the folder.
        choice: what the site is to be made of.
        folder: in which the files will stand, for the commands in their comments.
    """
    if choice.rig is not None:
        save_rig(choice.rig, made / RIG_FILE)
    probes = {
        name: replace(seen, source=put_away(seen.source, made, name))
        for name, seen in choice.probes.items()
    }
    choice = replace(choice, probes=probes)
    path = made / SITE_FILE
    path.write_text(site_text(choice, folder), encoding="utf-8")
    site = resolve(load_site(path), placed=False)  # what was written can be read
    if choice.times is not None:
        save_times(made / KEPT, workloads_of(site), choice.times)


def site_text(choice: Choice, folder: Path) -> str:
    """Return a commented site file.

    Args:
        choice: what it says.
        folder: in which it will stand.
    """
    count, total = choice.num_selected, len(choice.probes)
    profile = load_profile(PROFILE)
    active_w, idle_w = profile.watts("active"), profile.watts("power-saving")
    made = f"{datetime.now():%Y-%m-%d} on {platform.node()}, {plural(num_cores(), 'core')}"
    return "\n".join(
        [
            f"# The site {choice.name}, made by `e3pose init` ({made}).",
            f"# Check it: e3pose check {shell(folder)}    Start it: e3pose up {shell(folder)}",
            "# All keys: docs/reference/site-file.md. Paths are relative to this file.",
            "",
            'format = "e3pose-site"',
            "version = 1",
            "",
            f'name = "{choice.name}"',
            *_calibration(choice, folder),
            _line('# skeleton = "coco17"', "of the poses; by default that of the detector"),
            *_timing(choice),
            _line('lead = "adaptive"', "slots between an order and its slot"),
            _line('state = "state.npz"', "a restarted edge resumes from here"),
            _line(
                f'# budget = "{(active_w + idle_w) / 2:.2g}W"',
                f"of each camera: more than {idle_w:.2g} W idle, {active_w:.3g} W is active",
            ),
            "",
            "[link]",
            "# cameras elsewhere need tls: docs/how-to/live-site.md",
            f'endpoint = "tcp/127.0.0.1:{_port()}"',
            "",
            "[store]",
            _line('path = "live.db"', f"e3pose query {shell(folder)}"),
            'keep = "30d"',
            'max_size = "20GB"',
            "",
            "[loop]",
            _line(f"cameras = {count}", f"of {total} active per slot, on average"),
            _line('# target_error = "40mm"', "or: as few as keep the expected error below this"),
            "",
            "[energy]",
            _line(f'profile = "{PROFILE}"', "what cameras without a meter draw"),
            *(_camera(choice, camera_id) for camera_id in choice.probes),
            "",
        ]
    )


def _line(setting: str, comment: str) -> str:
    return f"{setting:<27} # {comment}"


def _calibration(choice: Choice, folder: Path) -> list[str]:
    setting = f'calibration = "{RIG_FILE}"'
    if choice.rig is not None:
        return [_line(setting, "names and locates the cameras")]
    return [
        _line(setting, "missing, to be made by"),
        f"#   e3pose record {shell(folder)} walk --for 60",
        f"#   e3pose calibrate extrinsics walk {shell(folder / RIG_FILE)} --height 171cm --update",
        "# with the height of the person who walks, which sets the scale",
    ]


def _timing(choice: Choice) -> list[str]:
    """Return the lines of the settings that depend on the machine's speed."""
    fps, pace = rates(choice)
    times = choice.times
    if times is None:
        return [
            _line(f"fps = {fps:g}", "slots per second"),
            _line(f"deadline_ms = {LEAST_DEADLINE_MS}", "for the views of a slot"),
        ]
    alone_ms, all_ms = 1000 * times.alone_s.max(), 1000 * times.together_s.max()
    deadline_ms = max(LEAST_DEADLINE_MS, suggested_deadline_ms(times))
    cameras = plural(choice.num_selected, "camera")
    slower = _line(f"pace = {pace:g}", "films are played as slowly as this machine needs")
    return [
        _line(
            f"fps = {fps:g}",
            f"slots; this machine: {three_digits(times.rate)} detections per second, "
            f"{cameras} per slot",
        ),
        *([slower] if pace != 1 else []),
        _line(
            f"deadline_ms = {deadline_ms}",
            f"a detection takes {alone_ms:.0f} ms, {all_ms:.0f} ms while all cameras detect",
        ),
    ]


def _camera(choice: Choice, camera_id: str) -> str:
    seen = choice.probes[camera_id]
    width, height = seen.image_size
    lines = [
        "",
        "[[camera]]",
        f'id = "{camera_id}"  # {width} x {height}, {seen.rate_words()}',
        f"source = {_quoted(seen.source)}",
    ]
    if degrees := choice.rotations.get(camera_id):
        lines.append(_line(f"rotation = {degrees}", "degrees clockwise make people upright"))
    if choice.detector:
        lines += [
            f"detector = {_quoted(choice.detector)}",
            f'provider = "{choice.provider}"',
            f"threads = {choice.threads}",
        ]
    return "\n".join(lines)


def _quoted(text: str) -> str:
    return tomli_w.dumps({"a": text}).partition("=")[2].strip()


def _port() -> int:
    with socket.socket() as probe_socket:
        claim_address(probe_socket)
        try:
            probe_socket.bind(("127.0.0.1", USUAL_PORT))
        except OSError:
            return free_port()
    return USUAL_PORT
