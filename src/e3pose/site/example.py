"""Write an example site: cameras that play a recording, and an edge."""

from __future__ import annotations

import random
import socket
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import tomli_w

from e3pose.base.atomic import atomic_folder
from e3pose.base.errors import InputError
from e3pose.base.quantities import shell
from e3pose.model.camera import Rig
from e3pose.recording import Recording, ViewSeries, save_recording
from e3pose.recording.calibration import save_rig
from e3pose.settings.site_file import SITE_FILE
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate

SCENE = SceneSettings(people=3, seconds=15.0, cameras=4)
STORE_FILE = "live.db"
PORTS = range(12_000, 20_000)  # systems give higher ones to outgoing connections
TRIES = 100


@dataclass(frozen=True, slots=True)
class Example:
    """The parts of a site on this machine.

    Attributes:
        name: of the site.
        sources: camera id to what it sees, relative to the site file.
        fps: slots per second of the scene.
        skeleton: of the detectors.
        cameras: how many to wake per slot.
        pace: how fast what was recorded is played.
        deadline_ms: how long after a slot its views are waited for.
        camera: further keys of every camera's table.
        comment: lines to begin the site file with.
        loop: further keys of the loop's table.
    """

    name: str
    sources: Mapping[str, str]
    fps: float
    skeleton: str
    cameras: int = 2
    pace: float = 1.0
    deadline_ms: float = 150.0
    camera: Mapping[str, Any] = field(default_factory=dict)
    comment: str = ""
    loop: Mapping[str, Any] = field(default_factory=dict)


def write_example(folder: Path, example: Example, rig: Rig) -> Path:
    """Write `site.toml` and the calibration to a folder; return the site file.

    The edge will listen on a port of loopback that is free now, in plain tcp.

    Args:
        folder: to write to; its other files stay.
        example: what to write.
        rig: the cameras.
    """
    folder.mkdir(parents=True, exist_ok=True)
    save_rig(rig, folder / "rig.toml")
    table = {
        "format": "e3pose-site",
        "version": 1,
        "name": example.name,
        "calibration": "rig.toml",
        "skeleton": example.skeleton,
        "fps": example.fps,
        "pace": example.pace,
        "deadline_ms": example.deadline_ms,
        "link": {"endpoint": f"tcp/127.0.0.1:{free_port()}"},
        "store": {"path": STORE_FILE},
        "loop": {"cameras": example.cameras, **example.loop},
        "camera": [
            {"id": camera_id, "source": example.sources[camera_id], **example.camera}
            for camera_id in rig.camera_ids
        ],
    }
    comment = "".join(f"# {line}\n" for line in example.comment.splitlines())
    path = folder / SITE_FILE
    path.write_text(comment + tomli_w.dumps(table), encoding="utf-8")
    return path


def write_recorded(folder: Path, recording: Recording, name: str = "example") -> Path:
    """Write a site whose cameras play the keypoints of a recording; return the site file."""
    save_recording(recording, folder / "recording")
    example = Example(
        name=name,
        sources=dict.fromkeys(recording.rig.camera_ids, "recorded:recording"),
        fps=recording.fps,
        skeleton=recording.skeleton.name,
        cameras=min(2, len(recording.rig)),
        comment=(
            "A site on one machine, whose cameras play a recording in a loop.\n"
            "Run it with `e3pose up site.toml`. Keys: docs/reference/site-file.md."
        ),
    )
    return write_example(folder, example, recording.rig)


def make_example(folder: Path) -> Path:
    """Make a folder with a site whose four cameras play a simulated scene; return the site file.

    Raises:
        InputError: when the folder has something in it.
    """
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise InputError(
            f"{folder}: is there already, expected a new folder; run the site in it with "
            f"`e3pose up {shell(folder)}`, without --example"
        )
    with atomic_folder(folder, private=True) as made:
        write_recorded(made, there_and_back(simulate(SCENE, 0)))
    return folder / SITE_FILE


def there_and_back(recording: Recording) -> Recording:
    """Return a recording, then itself backwards: played in a loop, nobody jumps."""
    order = [*range(recording.num_slots), *range(recording.num_slots - 2, 0, -1)]
    views = []
    for series in recording.views:
        found = [
            (slot, view) for slot, at in enumerate(order) if (view := series.view(at)) is not None
        ]
        slots = [slot for slot, _ in found]
        times_s = [slot * recording.interval_s for slot in slots]
        joints = len(recording.skeleton)
        views.append(ViewSeries.from_views([view for _, view in found], slots, times_s, joints))
    return replace(recording, num_slots=len(order), views=tuple(views), truth=None)


def free_port() -> int:
    """Return a free port of loopback.

    A port that the system chooses could be given to an outgoing connection before the edge of a
    new site listens there.

    Raises:
        InputError: when none of many is free.
    """
    for port in random.sample(PORTS, TRIES):
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
    raise InputError("ports of 127.0.0.1", f"none free in {PORTS[0]} to {PORTS[-1]}", "one")
