"""The steps that record a walk: to calibrate from, and to check with."""

from __future__ import annotations

import base64
import re
import shutil
import threading
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from e3pose.base.atomic import write_file
from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError
from e3pose.base.jpeg import jpeg_size
from e3pose.base.private import make_folder
from e3pose.base.quantities import shell
from e3pose.edge.gather import Arrival
from e3pose.edge.record_server import RecordServer
from e3pose.settings.resolved import ASSUMED_SIZE, ResolvedSite, resolve
from e3pose.site.follow import viewer_link
from e3pose.site.record_program import record_site, waiting_words
from e3pose.site.setup.coverage import CELL_M, Coverage, hints
from e3pose.site.setup.plan import MAX_CAMERAS
from e3pose.site.setup.session import SetupSession, Thumbnail
from e3pose.site.setup.tasks import Task
from e3pose.wire.codec import decode, encode
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import Picture, PictureQuestion
from e3pose.wire.topics import of_camera

Which = Literal["walk", "second"]
MOST_S = 600.0  # that nobody ends
PICTURE_S, PICTURE_EVERY_S = 1.0, 1.0
MOST_PICTURES = 60  # of each camera
PICTURES = "walk-pictures"  # folder in the site's: those of the newest walk, until it goes live
NAMED = re.compile(r"(.+)-(\d{1,12})-(\d{1,5})x(\d{1,5})\.jpg")
MAX_PICTURE_BYTES = 2**20


@dataclass(eq=False)
class Snapshots:
    """Small pictures that the cameras of a walk sent, by camera.

    Attributes:
        pictures: the newest last.
    """

    pictures: dict[str, deque[Picture]] = field(default_factory=dict)

    def take(self, site: ResolvedSite, stop: threading.Event) -> None:
        """Request a picture of every camera about once a second until stopped."""
        with suppress(InputError):  # no operator's certificate: no pictures
            transport = open_network(viewer_link(site.file, None, operates=True))
            try:
                while not stop.wait(PICTURE_EVERY_S):
                    for name in site.rig.camera_ids:
                        topic = of_camera(site.file.name, name, "picture")
                        answer = transport.ask(topic, encode(PictureQuestion()), PICTURE_S)
                        if answer is not None and not stop.is_set():
                            self._keep(name, answer)
            finally:
                transport.close()

    def _keep(self, name: str, answer: bytes) -> None:
        with suppress(InputError):  # what no honest camera sends
            picture = decode(answer, Picture, name)
            if picture.jpeg and picture.camera_id == name:
                jpeg_size(picture.jpeg)
                self.pictures.setdefault(name, deque(maxlen=MOST_PICTURES)).append(picture)

    def save(self, folder: Path) -> None:
        """Save the pictures in the site's folder, for its owner only, replacing earlier ones."""
        forget_pictures(folder)
        make_folder(folder / PICTURES)
        for name, taken in self.pictures.items():
            for picture in taken:
                width, height = picture.image_size
                path = folder / PICTURES / f"{name}-{picture.slot}-{width}x{height}.jpg"
                write_file(path, picture.jpeg, private=True)

    def load(self, folder: Path) -> None:
        """Load the pictures in the site's folder; other files are skipped."""
        self.pictures.clear()
        found = [
            (match[1], int(match[2]), (int(match[3]), int(match[4])), path)
            for path in (folder / PICTURES).glob("*.jpg")
            if (match := NAMED.fullmatch(path.name))
        ]
        for name, slot, size, path in sorted(found)[: MOST_PICTURES * MAX_CAMERAS]:
            with suppress(InputError):
                jpeg = read_bytes(path, MAX_PICTURE_BYTES)
                jpeg_size(jpeg)
                kept = self.pictures.setdefault(name, deque(maxlen=MOST_PICTURES))
                kept.append(Picture(name, slot, size, jpeg))

    def newest(self, name: str) -> Picture | None:
        """Return the newest picture of a camera; None where it sent none."""
        taken = self.pictures.get(name)
        return taken[-1] if taken else None


def forget_pictures(folder: Path) -> None:
    """Remove the pictures of a walk that are kept in the folder of a site."""
    shutil.rmtree(folder / PICTURES, ignore_errors=True)


def record_command(setup: SetupSession, which: Which) -> str:
    """Return the command line that records the next walk."""
    folder = setup.folder / setup.free_folder(which)
    seconds = 60 if which == "walk" else 30
    return f"e3pose record {shell(setup.name)} {setup.shown(folder)} --for {seconds}"


def start_walk(setup: SetupSession, which: Which, snapshots: Snapshots) -> Coverage:
    """Record a walk in the background until it is stopped; its coverage grows.

    Args:
        setup: whose site.
        which: to calibrate from, or to check with.
        snapshots: takes the pictures of its cameras.

    Raises:
        InputError: where there is no site file yet, or the site cannot be recorded.
    """
    site = resolve(setup.site(), placed=False)
    if which == "second" and not site.rig.placed:
        raise InputError("calibration", "none", "one before the second walk: solve first")
    name = setup.free_folder(which)
    covered = Coverage(site.rig, site.skeleton, site.file.fps)
    sizes = [
        camera.image_size if site.rig.placed else _size(setup, camera.camera_id)
        for camera in site.rig.cameras
    ]
    snapshots.pictures.clear()
    ids = site.rig.camera_ids
    joints = len(site.skeleton)

    def watch(slot: int, arrivals: Mapping[int, Arrival]) -> None:
        views = {
            i: arrival.poses
            for i, arrival in arrivals.items()
            if arrival.poses.scores.shape[1:] == (joints,)
        }
        covered.add(views, sizes)

    def record(task: Task) -> None:
        setup.thumbnails.close()
        stop = threading.Event()
        taking = threading.Thread(target=snapshots.take, args=(site, stop), daemon=True)
        task.stage = "starting the cameras"
        taking.start()

        def look(server: RecordServer) -> None:
            missing = waiting_words(server)
            task.stage = f"waiting for {missing}" if missing else "recording"
            task.shown = {"seconds": round(server.slots / server.plan.fps, 1)}
            if task.stopping.is_set():
                raise KeyboardInterrupt  # as Ctrl-C ends it: in order

        try:
            record_site(
                setup.site(), setup.folder / name, for_s=MOST_S, report=task.say, look=look,
                watch=watch,
            )  # fmt: skip
        finally:
            stop.set()
            taking.join(PICTURE_S * (len(ids) + 1))
        if which == "walk":
            snapshots.save(setup.folder)
            setup.change(lambda plan: replace(plan, walk=name))
        else:
            setup.change(lambda plan: replace(plan, second=name))
        setup.keep_result(which, body(covered))

    title = "Recording the walk" if which == "walk" else "Recording the second walk"
    setup.start(Task(which, title, record_command(setup, which)), record)
    return covered


def _size(setup: SetupSession, camera_id: str) -> tuple[int, int]:
    camera = setup.plan().camera(camera_id)
    return (camera.width, camera.height) if camera.width else ASSUMED_SIZE


def body(covered: Coverage) -> dict[str, Any]:
    """Return the coverage of a walk, for the page."""
    names, found = covered.rig.camera_ids, hints(covered)
    number = len(names)
    return {
        "cameras": [
            {
                "id": name,
                "people": int(covered.people[i]),
                "share": round(covered.share(i), 3),
                "seen": covered.seen[i].tolist(),
            }
            for i, name in enumerate(names)
        ],
        "pairs": [
            {"a": names[a], "b": names[b], "seconds": round(covered.pair_s(a, b), 1)}
            for a in range(number)
            for b in range(a + 1, number)
        ],
        "seconds": round(covered.seconds, 1),
        "length": round(covered.slots / covered.fps, 1),
        "hints": found,
        "enough": not found,
        "cell_m": CELL_M,
        "floor": [[x, y, count] for (x, y), count in sorted(covered.floor.items())[:5000]],
        "centers": covered.rig.centers_m[:, :2].round(3).tolist() if covered.rig.placed else [],
    }


def newest_view(covered: Coverage | None, snapshots: Snapshots, camera_id: str) -> dict[str, Any]:
    """Return the newest picture of a camera in a walk, with the people it saw last."""
    picture = snapshots.newest(camera_id)
    people = []
    if covered is not None and camera_id in covered.rig.camera_ids:
        people = covered.newest.get(covered.rig.index(camera_id), [])
    if picture is None:
        return {**asdict(Thumbnail(why="no picture yet")), "people": []}
    shown = Thumbnail(base64.b64encode(picture.jpeg).decode(), picture.image_size)
    return {**asdict(shown), "people": people}
