"""The step of cameras: find, add, name, turn and remove them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from e3pose.base.errors import InputError
from e3pose.base.masking import masked
from e3pose.camera.probe import Probe, probe, probe_all
from e3pose.camera.webcam import find_devices, lasting
from e3pose.settings.limits import Rotation
from e3pose.settings.sources import is_recorded, place_of, revealed
from e3pose.simulate import SceneSettings
from e3pose.simulate import simulate as run
from e3pose.site.example import make_example
from e3pose.site.setup.discovery import look_around
from e3pose.site.setup.finding import check_typed, find_films, free_name
from e3pose.site.setup.onvif import Login, streams_of
from e3pose.site.setup.plan import ChosenCamera, Plan
from e3pose.site.setup.session import SetupSession
from e3pose.site.setup.tasks import Task
from e3pose.site.simulated_films import FOLDER, write_films
from e3pose.wire.topics import check_site

SIMULATED = "films"  # folder of the stand-in for cameras, after the site's name
SIMULATED_S, SIMULATED_FPS, SIMULATED_SIZE = 30.0, 12.5, (640, 480)
SIMULATED_SEED = 727  # somebody who walks about
MOST_ASKED = 16  # cameras at a time
TURNS: tuple[Rotation, ...] = (0, 90, 180, 270)


def found(setup: SetupSession) -> dict[str, Any]:
    """Return possible cameras: devices, films, and cameras found in the network."""
    used = {camera.source for camera in setup.plan().cameras}
    films = [name for name in find_films(setup.root) if str(setup.root / name) not in used]
    devices = [
        {"source": source, "title": title}
        for source, title in find_devices().items()
        if source not in used
    ]
    return {"devices": devices, "films": films, "network": setup.found}


def start_adding(setup: SetupSession, sources: Sequence[str]) -> None:
    """Try sources in the background, and add the ones that work.

    Raises:
        InputError: for what is no source, or one that is a camera already.
    """
    plan = setup.chosen_plan()
    root = setup.root.resolve()
    asked = [setup.offered.get(source, source) for source in sources]
    checked = [lasting(check_typed(source, root)) for source in asked]
    for source in checked:
        if any(revealed(camera.source) == source for camera in plan.cameras):
            raise InputError(
                "source", repr(masked(source)[:80]), "one that is no camera of the site yet"
            )
    if not checked or len(set(checked)) < len(checked):
        raise InputError("source", "none, or one twice", "sources")
    title = "Looking at " + ("a source" if len(checked) == 1 else f"{len(checked)} sources")
    setup.start(Task("cameras", title), lambda task: _add(setup, checked, task))


def _add(setup: SetupSession, sources: Sequence[str], task: Task) -> None:
    if len(sources) == 1:
        setup.thumbnails.close(sources[0])
    stage = "reading one frame of each, and counting frames of live cameras for three seconds"
    tried = probe_all(
        {source: partial(probe, source) for source in sources},
        lambda done, total: task.progress(stage, done, total),
    )
    problems = []
    for source, seen in tried.items():
        if isinstance(seen, InputError):
            problems.append(str(seen))
            continue
        setup.change(partial(_with, seen))
        if seen.note:
            task.say(seen.note)
        if seen.dark:
            task.say(f"{source}: its picture is dark; is the lens covered?")
        if seen.nominal_fps is not None and seen.fps < seen.nominal_fps:
            task.say(
                f"{source}: announces {seen.nominal_fps:.3g} frames per second and brings "
                f"{seen.fps:.3g}: the site gets no more slots per second"
            )
    if problems:
        raise InputError("; ".join(problems))


def _with(seen: Probe, plan: Plan) -> Plan:
    width, height = seen.image_size
    camera = ChosenCamera(
        free_name(seen.source, plan.cameras), seen.source, 0, width, height, seen.fps,
        seen.nominal_fps or 0.0,
    )  # fmt: skip
    return replace(plan, cameras=(*plan.cameras, camera))


def looked_again(camera: ChosenCamera) -> ChosenCamera:
    """Return a camera with its present picture and rate; raise `InputError` without one."""
    seen = probe(camera.source, camera.id)
    width, height = seen.image_size
    announced = seen.nominal_fps or 0.0
    return replace(camera, width=width, height=height, fps=seen.fps, announced=announced)


def change_camera(
    setup: SetupSession, camera_id: str, name: str | None, rotation: int | None, remove: bool
) -> None:
    """Rename, turn or remove a camera of the plan.

    Raises:
        InputError: for another camera, a name that is none or taken, or another turn.
    """
    setup.tasks.check_free()
    if rotation is not None and rotation not in TURNS:
        raise InputError("rotation", f"{rotation}", "0, 90, 180 or 270 degrees")

    def changed(plan: Plan) -> Plan:
        camera = plan.camera(camera_id)
        if remove:
            setup.thumbnails.close(camera.source)
            return replace(plan, cameras=tuple(c for c in plan.cameras if c.id != camera_id))
        changes: dict[str, Any] = {}
        if name is not None:
            changes["id"] = name.strip()
        if rotation is not None:
            changes["rotation"] = rotation
        return plan.with_camera(camera_id, **changes)

    setup.change(changed)


def start_looking(setup: SetupSession) -> None:
    """Ask the local network for cameras, and each for its streams, in the background."""

    def look(task: Task) -> None:
        task.progress("asking the local network", 0, 0)
        cameras = look_around()
        setup.found = [
            {
                "host": each.host,
                "name": each.name,
                "service": each.service,
                "streams": [],
                "why": "",
            }
            for each in cameras
        ]
        with ThreadPoolExecutor(MOST_ASKED) as pool:
            asked = [pool.submit(_ask_streams, setup, one, Login()) for one in setup.found]
            for done, _ in enumerate(as_completed(asked), 1):
                task.progress("asking each for its streams", done, len(asked))
        if not cameras:
            task.say(
                "No camera answered. ONVIF may be off in the camera, or it is in another network: "
                "paste its address instead."
            )

    setup.start(Task("network-look", "Looking for cameras in the network"), look)


def ask_streams(setup: SetupSession, host: str, user: str, password: str) -> dict[str, Any]:
    """Ask a camera that was found for its streams, with user and password; return them.

    Raises:
        InputError: for a host that was not found, or where the camera refuses.
    """
    for one in setup.found:
        if one["host"] == host:
            if error := _ask_streams(setup, one, Login(user, password)):
                raise error
            return one
    raise InputError("camera", repr(host[:64]), "one that was found: look in the network first")


def _ask_streams(setup: SetupSession, one: dict[str, Any], login: Login) -> InputError | None:
    """Note the streams of a camera that was found, or why there are none."""
    try:
        found = streams_of(one["service"], login)
    except InputError as error:
        one.update(streams=[], why=str(error))
        return error
    setup.offered |= {masked(each.url): each.url for each in found}
    one.update(streams=[{"name": each.name, "source": masked(each.url)} for each in found], why="")
    return None


def simulated_folder(setup: SetupSession) -> Path:
    """Return where the simulated films of a site lie."""
    return setup.root / f"{setup.name}-{SIMULATED}"


def simulate_command(setup: SetupSession) -> str:
    """Return the command line that makes the simulated films."""
    width, height = SIMULATED_SIZE
    return (
        f"e3pose simulate {setup.shown(simulated_folder(setup))} --people 1 --cameras 4 --seconds "
        f"{SIMULATED_S:g} --fps {SIMULATED_FPS:g} --resolution {width}x{height} --seed "
        f"{SIMULATED_SEED} --videos"
    )


def start_simulating(setup: SetupSession) -> None:
    """Make four films of a simulated person, in the background, and add them as cameras."""
    dest = simulated_folder(setup)
    if setup.chosen_plan().cameras:
        raise InputError("cameras", "some already", "a site without cameras, for simulated films")

    def simulate(task: Task) -> None:
        films = dest / FOLDER
        if not films.is_dir():
            settings = SceneSettings(
                people=1, cameras=4, seconds=SIMULATED_S, fps=SIMULATED_FPS,
                image_size=SIMULATED_SIZE,
            )  # fmt: skip
            scene = "simulating a person who walks"
            recording = run(
                settings, SIMULATED_SEED, lambda p: task.progress(scene, round(100 * p), 100)
            )
            words = "drawing four films"
            write_films(recording, dest, lambda p: task.progress(words, round(100 * p), 100))
        _add(setup, [str(path) for path in sorted(films.glob("*.mp4"))], task)
        setup.change(lambda plan: replace(plan, detector=plan.detector or "drawn"))

    setup.start(Task("cameras", "Making simulated films", simulate_command(setup)), simulate)


def make_example_site(setup: SetupSession, name: str) -> None:
    """Make a finished site that plays a simulated scene, and turn to it."""
    setup.tasks.check_free()
    make_example(setup.root / check_site(name))
    setup.choose(name)


def thumbnail_of(setup: SetupSession, camera_id: str) -> dict[str, Any]:
    """Return the newest picture of a camera that no program of the site has."""
    camera = setup.plan().camera(camera_id)
    if not camera.source:
        return {"jpeg": None, "size": (0, 0), "fps": None, "why": "it runs on its own machine"}
    if is_recorded(camera.source):
        return {"jpeg": None, "size": (0, 0), "fps": None, "why": "it plays keypoints, no images"}
    return setup.thumbnails.look(camera.source, camera.rotation).body()


def shown_source(setup: SetupSession, source: str) -> str:
    """Return a source as a person types it in the root."""
    place = place_of(source) if source else None
    if place is None:
        return masked(source)
    prefix = source[: len(source) - len(place)]
    return f"{prefix}{setup.shown(Path(place))}"
