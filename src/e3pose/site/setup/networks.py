"""The step of the network: which detectors are there, how fast they are here, and the site file."""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural, shell, three_digits
from e3pose.base.system import num_cores
from e3pose.camera.orientation import Orientation
from e3pose.detectors import DETECTORS
from e3pose.detectors.chooser import choose_network
from e3pose.detectors.timing import DetectionTimes, Workload, time_detections
from e3pose.detectors.weights import BOXES, is_installed, pull_weights
from e3pose.detectors.weights import networks as known_networks
from e3pose.recording.calibration import load_rig
from e3pose.settings.sources import is_recorded
from e3pose.site.new_site import Choice, fill_site, rates, site_name, threads_for
from e3pose.site.setup.cameras import looked_again, shown_source
from e3pose.site.setup.editing import apply_cameras
from e3pose.site.setup.plan import ChosenCamera, Plan
from e3pose.site.setup.session import SetupSession
from e3pose.site.setup.tasks import Task

NUM_SELECTED = 2  # active cameras per slot, as `e3pose init` has it
DRAWN = "drawn"
NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def networks(setup: SetupSession) -> list[dict[str, Any]]:
    """Return the networks that can be had: title, licence, size, whether installed, and speed."""
    number = len(setup.plan().cameras)
    films = any("films" in camera.source for camera in setup.plan().cameras)
    choice = choose_network(live=True)
    found = [
        {
            "name": model.name,
            "title": model.title,
            "licence": model.licence,
            "mb": round(model.size_bytes / 1e6, 1),
            "installed": is_installed(model.name),
            "usual": model.name in (choice.name, *choice.others),
            "speed": setup.times.get((model.name, number), ""),
        }
        for model in known_networks().values()
        if model.source is not None and model.family != BOXES
    ]
    drawn = {
        "name": DRAWN, "title": "reads the coloured joints of simulated films, no network",
        "licence": "Apache-2.0", "mb": 0.0, "installed": True, "usual": films,
        "speed": setup.times.get((DRAWN, number), ""),
    }  # fmt: skip
    return [drawn, *found] if films else [*found, drawn]


def start_pulling(setup: SetupSession, name: str) -> None:
    """Download a network in the background."""
    known = known_networks().get(name)
    if known is None or known.source is None:
        raise InputError("network", repr(name[:60]), "one that can be downloaded")

    def pull(task: Task) -> None:
        words = f"downloading {name}"
        pull_weights(name, lambda done, total: task.progress(words, done, total))

    setup.start(Task("pull", f"Downloading {name}", f"e3pose models pull {name}"), pull)


def start_timing(setup: SetupSession, name: str) -> None:
    """Measure in the background how fast a network is with all cameras of the plan."""
    check_network(name)
    cameras = _local(setup.plan())

    def measure(task: Task) -> None:
        setup.thumbnails.close()
        task.progress(f"measuring {name} with all cameras at work", 0, 0)
        _timed(setup, name, cameras)

    setup.start(Task("timing", f"Measuring {name}", f"e3pose models bench {name}"), measure)


def start_using(setup: SetupSession, name: str) -> None:
    """Choose a network: measure it, and write the site file, all in the background."""
    check_network(name)
    _local(setup.plan())
    task = Task("site", "Writing the site", init_command(setup, name))
    setup.start(task, lambda running: _use(setup, name, running))


def check_network(name: str) -> None:
    """Raise `InputError` for a network that is not there, with the command that gets it."""
    known = known_networks().get(name)
    if (known is None and name not in DETECTORS) or (known is not None and known.source is None):
        raise InputError("network", repr(name[:60]), "one of the list")
    if known is not None and not is_installed(name):
        raise InputError(f"network {name} is not installed: e3pose models pull {name}")


def _use(setup: SetupSession, name: str, task: Task) -> None:
    setup.thumbnails.close()
    plan = setup.plan()
    cameras = list(plan.cameras)
    for index, camera in enumerate(cameras):
        if camera.source and not is_recorded(camera.source) and not camera.width:
            task.progress("looking at the cameras", index, len(cameras))
            cameras[index] = looked_again(camera)
    plan = setup.change(lambda now: replace(now, cameras=tuple(cameras), detector=name))
    task.progress(f"measuring {name} with all cameras at work", 0, 0)
    choice = _choice(setup, plan, name)
    task.progress("writing the site file", 0, 0)
    if setup.has_site:
        apply_cameras(setup, choice)
    else:
        _fill(setup, choice)
    setup.change(lambda now: replace(now, cameras=tuple(replace(c, was=c.id) for c in now.cameras)))
    fps, pace = rates(choice)
    slow = "" if pace == 1 else f", films played at {pace:g} of their speed"
    task.say(f"{plural(fps, 'slot')} per second{slow}, {NUM_SELECTED} of {len(cameras)} cameras "
            "active in each")  # fmt: skip


def _choice(setup: SetupSession, plan: Plan, name: str) -> Choice:
    cameras = _local(plan)
    return Choice(
        name=setup.site().name if setup.has_site else site_name(setup.folder),
        probes={camera.id: camera.probe for camera in cameras},
        detector=name,
        provider="auto",
        threads=_threads(len(cameras)),
        num_selected=min(NUM_SELECTED, len(cameras)),
        times=_timed(setup, name, cameras),
        rig=load_rig(setup.calibration) if setup.placed() else None,
        rotations={camera.id: camera.rotation for camera in cameras if camera.rotation},
    )


def _local(plan: Plan) -> list[ChosenCamera]:
    """Return the cameras whose programs run here; raise `InputError` for too few."""
    cameras = [c for c in plan.cameras if c.source and not is_recorded(c.source)]
    if len(plan.cameras) < 2:
        found = plural(len(plan.cameras), "camera")
        raise InputError("cameras", found, "two or more: 3D needs them")
    if len(cameras) < len(plan.cameras):
        raise InputError("cameras", "some that play keypoints or run elsewhere",
                         "a network in their own settings")  # fmt: skip
    return cameras


def _threads(number: int) -> int:
    return threads_for(number, min(NUM_SELECTED, number), num_cores())


def _timed(setup: SetupSession, name: str, cameras: list[ChosenCamera]) -> DetectionTimes:
    """Measure a network with all cameras at work, and note its speed in words."""
    workloads = [
        Workload(name, None, "auto", _threads(len(cameras)),
                 Orientation.from_degrees(camera.rotation).size(camera.width or 1280,
                                                                camera.height or 720))
        for camera in cameras
    ]  # fmt: skip
    times = time_detections(workloads)
    setup.times[name, len(cameras)] = speed_words(times, len(cameras))
    return times


def speed_words(times: DetectionTimes, number: int) -> str:
    """Return how fast a network is here: `12 poses a second here with four cameras`."""
    many = NUMBERS[number] if number < len(NUMBERS) else str(number)
    slots = times.reach_fps(min(NUM_SELECTED, number))
    return (
        f"{three_digits(times.rate)} poses a second here with {many} cameras: "
        f"{three_digits(slots)} moments a second, two cameras each"
    )


def _fill(setup: SetupSession, choice: Choice) -> None:
    """Write the files of a new site into its folder, which has the plan already."""
    with tempfile.TemporaryDirectory(prefix=".setup.", dir=setup.folder) as made:
        fill_site(Path(made), choice, Path(setup.name))
        for path in sorted(Path(made).iterdir(), key=lambda p: p.name == "site.toml"):
            os.replace(path, setup.folder / path.name)  # the site file last: it makes the site


def init_command(setup: SetupSession, detector: str) -> str:
    """Return the command line that writes the site file."""
    words = [shell(f"{c.id}={shown_source(setup, c.source)}") for c in setup.plan().cameras]
    turned = [f"{c.id}: {c.rotation}" for c in setup.plan().cameras if c.rotation]
    more = f"  # then rotation = ... in site.toml ({', '.join(turned)})" if turned else ""
    network = f" --detector {detector}" if detector else ""
    return f"e3pose init {shell(setup.name)} {' '.join(words)}{network}{more}"
