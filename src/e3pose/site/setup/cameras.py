"""The step of cameras: find, add, name, turn and remove them; a phone is shown a code to scan.

Possible sources are devices of this machine, films in a folder, typed addresses, and ONVIF cameras
in the local network by WS-Discovery. One question goes to the multicast address of WS-Discovery
1.0; cameras answer with their name and the address of their service, which `onvif.streams_of` asks
for their streams.
"""

from __future__ import annotations

import os
import re
import socket
import time
import uuid
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from e3pose.base.errors import InputError
from e3pose.base.masking import masked
from e3pose.camera.live_source import STREAMS
from e3pose.camera.probe import Probe, probe, probe_all
from e3pose.camera.webcam import check_name, find_devices, lasting
from e3pose.model.camera_fields import check_camera_id
from e3pose.settings.limits import Rotation, check_source
from e3pose.settings.sources import PHONE, is_recorded, place_of, revealed
from e3pose.simulate import SceneSettings
from e3pose.simulate import simulate as run
from e3pose.site.example import make_example
from e3pose.site.phones import show_phone
from e3pose.site.setup.onvif import Login, parse, streams_of
from e3pose.site.setup.plan import ChosenCamera, Plan
from e3pose.site.setup.session import SetupSession, Thumbnail
from e3pose.site.setup.tasks import Task
from e3pose.site.simulated_films import FOLDER, write_films
from e3pose.wire.topics import check_site

PHONES = "phones"  # folder of the files of phones, after the site's name
SIMULATED = "films"  # folder of the stand-in for cameras, after the site's name
SIMULATED_S, SIMULATED_FPS, SIMULATED_SIZE = 30.0, 12.5, (640, 480)
SIMULATED_SEED = 727  # somebody who walks about
MOST_ASKED = 16  # cameras at a time
TURNS: tuple[Rotation, ...] = (0, 90, 180, 270)

GROUP = ("239.255.255.250", 3702)
WAIT_S = 3.0
MAX_BYTES, MOST_ANSWERS = 65_507, 64
PROBE = """<?xml version="1.0" encoding="UTF-8"?>
<e:Envelope xmlns:e="http://www.w3.org/2003/05/soap-envelope"
 xmlns:w="http://schemas.xmlsoap.org/ws/2004/08/addressing"
 xmlns:d="http://schemas.xmlsoap.org/ws/2005/04/discovery"
 xmlns:dn="http://www.onvif.org/ver10/network/wsdl">
<e:Header><w:MessageID>uuid:{id}</w:MessageID>
<w:To e:mustUnderstand="true">urn:schemas-xmlsoap-org:ws:2005:04:discovery</w:To>
<w:Action e:mustUnderstand="true">http://schemas.xmlsoap.org/ws/2005/04/discovery/Probe</w:Action>
</e:Header><e:Body><d:Probe><d:Types>dn:NetworkVideoTransmitter</d:Types></d:Probe></e:Body>
</e:Envelope>"""

FILMS = (".mp4", ".mkv", ".mov", ".avi", ".webm", ".m4v")
DEPTH, MOST_FILMS, MOST_ENTRIES = 4, 200, 20_000
DEVICES = ("usb", "picamera2", "imx500", "depthai")
MAX_SOURCE = 500


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
        for doubt in seen.doubts():
            task.say(f"{source}: {doubt}")
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
        setup.found = [{**asdict(each), "streams": [], "why": ""} for each in cameras]
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


def thumbnail_of(setup: SetupSession, camera_id: str) -> Thumbnail:
    """Return the newest picture of a camera that no program of the site has."""
    camera = setup.plan().camera(camera_id)
    if not camera.source:
        return Thumbnail(why="it runs on its own machine")
    if is_recorded(camera.source):
        return Thumbnail(why="it plays keypoints, no images")
    return setup.thumbnails.look(camera.source, camera.rotation)


def shown_source(setup: SetupSession, source: str) -> str:
    """Return a source as a person types it in the root."""
    place = place_of(source) if source else None
    if place is None:
        return masked(source)
    prefix = source[: len(source) - len(place)]
    return f"{prefix}{setup.shown(Path(place))}"


@dataclass(frozen=True, slots=True)
class NetworkCamera:
    """A camera that answered.

    Attributes:
        host: its address.
        name: that it states, of its make and model; empty if it states none.
        service: address of its device service; empty where it tells none that is usable.
    """

    host: str
    name: str
    service: str = ""


def look_around(wait_s: float = WAIT_S, to: tuple[str, int] = GROUP) -> list[NetworkCamera]:
    """Ask the local network for cameras; return the answers that come in time.

    Args:
        wait_s: how long to wait for answers.
        to: whom to ask.
    """
    asked = str(uuid.uuid4())
    found: dict[str, NetworkCamera] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)  # no router passes it on
        out.sendto(PROBE.format(id=asked).encode(), to)
        end_s = time.monotonic() + wait_s
        for _ in range(MOST_ANSWERS):
            left_s = end_s - time.monotonic()
            if left_s <= 0:
                break
            out.settimeout(left_s)
            try:
                answer, (host, _port) = out.recvfrom(MAX_BYTES)
            except TimeoutError:
                break
            if (camera := read_answer(answer, asked, str(host))) is not None:
                found[camera.host] = camera
    return [found[host] for host in sorted(found)]


def read_answer(answer: bytes, asked: str, sender: str) -> NetworkCamera | None:
    """Return the camera that an answer tells of; None for another message.

    Args:
        answer: the datagram.
        asked: identifier of our question.
        sender: the address that it came from, the only one that is believed.
    """
    root = parse(answer)
    if root is None:
        return None
    words: dict[str, list[str]] = {"RelatesTo": [], "Scopes": [], "XAddrs": []}
    for node in root.iter():  # whatever their namespaces
        words.get(node.tag.rpartition("}")[2], []).append(node.text or "")
    if not any(asked in word for word in words["RelatesTo"]) or not words["XAddrs"]:
        return None
    urls = [url for text in words["XAddrs"] for url in text.split()[:8] if _host(url) == sender]
    if not urls:
        return None
    name = _name(" ".join(words["Scopes"]).split())
    return NetworkCamera(sender, name, next((u for u in urls if u.startswith("http://")), urls[0]))


def _host(url: str) -> str | None:
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None


def _name(scopes: Sequence[str]) -> str:
    """Return make and model of `onvif://www.onvif.org/name/...` scopes."""
    parts = []
    for key in ("name", "hardware"):
        for scope in scopes:
            if match := re.fullmatch(rf"onvif://www\.onvif\.org/{key}/(.{{1,100}})", scope):
                text = unquote(match[1])
                if text.isprintable() and text not in parts:
                    parts.append(text)
                break
    return " ".join(parts)[:100]


def find_films(folder: Path) -> list[str]:
    """Return the films in and below a folder, relative to it, without hidden ones."""
    found = sorted(_films(folder, DEPTH, [MOST_ENTRIES]))
    return [path.relative_to(folder).as_posix() for path in found[:MOST_FILMS]]


def _films(folder: Path, depth: int, left: list[int]) -> Iterator[Path]:
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:
        return
    for entry in entries:
        left[0] -= 1
        if left[0] < 0:
            return
        if entry.name.startswith((".", "node_modules")) or entry.is_symlink():
            continue
        if entry.is_dir() and depth:
            yield from _films(Path(entry.path), depth - 1, left)
        elif entry.is_file() and entry.name.lower().endswith(FILMS):
            yield Path(entry.path)


def check_typed(source: str, folder: Path) -> str:
    """Return a source as a site file has it; files lie in a folder.

    Args:
        source: as typed or pasted.
        folder: in which set-up began: files elsewhere are not opened for a page.

    Raises:
        InputError: for what is no source, or a file elsewhere.
    """
    source = source.strip()
    if not (0 < len(source) <= MAX_SOURCE and source.isprintable()):
        raise InputError("source", repr(masked(source)[:60]), "usb:0, rtsp://HOST/PATH or a film")
    check_source(source)
    if source.startswith("gstreamer:"):
        raise InputError(
            "source", "a GStreamer pipeline", "it in site.toml: a pipeline may write files"
        )
    if source.startswith(PHONE):
        raise InputError("source", repr(masked(source)[:60]), "a phone by `Add a phone`")
    if "://" in source:
        parts = urlsplit(source)
        if parts.scheme not in STREAMS or not parts.hostname:
            found = repr(masked(source)[:60])
            raise InputError("source", found, "rtsp://HOST/PATH or http://HOST/PATH")
        return source
    place = place_of(source)
    if place is None:
        scheme, _, name = source.partition(":")
        if scheme not in DEVICES:  # no code of one's own for a page
            listed = ", ".join(f"{each}:NAME" for each in DEVICES)
            raise InputError("source", repr(masked(source)[:60]), f"one of {listed}")
        if scheme == "usb":
            check_name(name)
        return source
    path = (folder / place).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise InputError(
            "source", repr(place[:80]), f"a file in {folder}; start `e3pose setup` in a folder "
            "above your films"
        )  # fmt: skip
    if not path.exists():
        raise InputError(f"{path}: file not found, expected a film in {folder}")
    return f"{source[: len(source) - len(place)]}{path}"


def free_name(source: str, taken: Sequence[ChosenCamera]) -> str:
    """Return a name for the camera of a source: a film's own, else `cam` and a number."""
    names = {camera.id for camera in taken}
    place = place_of(source)
    stem = "" if place is None else re.sub(r"[^A-Za-z0-9_.-]", "_", Path(place).stem)[:60]
    if stem and stem[0] not in "-." and stem not in names:
        return stem
    return next(name for i in range(len(names) + 1) if (name := f"cam{i}") not in names)


def add_phone(setup: SetupSession, name: str) -> dict[str, Any]:
    """Add a phone to the plan, and return the code and address to show.

    Raises:
        InputError: for a name that is none or taken, or while other work has the cameras.
    """
    setup.tasks.check_free()
    setup.chosen_plan()
    name = check_camera_id(name.strip())
    path = setup.root / f"{setup.name}-{PHONES}" / f"{name}.toml"
    if any(camera.id == name for camera in setup.plan().cameras):
        raise InputError(f"camera {name}", "it already", "another name")
    shown = _code_of(setup, path)
    camera = ChosenCamera(name, f"{PHONE}{path}")
    setup.change(lambda plan: replace(plan, cameras=(*plan.cameras, camera)))
    return shown


def show_code(setup: SetupSession, camera_id: str) -> dict[str, Any]:
    """Return a new code for a phone that is a camera already; the phone before it is forgotten.

    Raises:
        InputError: for a camera that is no phone.
    """
    source = setup.plan().camera(camera_id).source
    if not source.startswith(PHONE):
        raise InputError("camera", repr(camera_id), "one that is a phone")
    return _code_of(setup, Path(place_of(source) or ""))


def _code_of(setup: SetupSession, path: Path) -> dict[str, Any]:
    keys = setup.site().link.keys if setup.has_site else None
    shown = show_phone(path, keys)
    return {
        "name": path.stem, "url": shown.url, "picture": shown.picture(), "port": shown.port,
        "fingerprint": shown.fingerprint, "minutes": shown.minutes,
        "command": f"e3pose phone {setup.shown(path)}",
    }  # fmt: skip
