"""Pictures of cameras with the people of their moment: when they are asked for, who sees them."""

from __future__ import annotations

import base64
import threading
from dataclasses import dataclass, field, replace
from random import Random
from typing import Any

import numpy as np
import pytest
from fastapi import FastAPI
from starlette.testclient import TestClient
from tests.cases import each_case
from tests.memory_transport import Hub, MemoryTransport
from tests.site.tables import write_site
from tests.site.web.watched import FPS, RIG, STARTED_NS, Watched, poses, record

from e3pose.base.errors import InputError
from e3pose.base.jpeg import jpeg_size
from e3pose.site.connect import live_slot
from e3pose.site.web.access import Client, Rules
from e3pose.site.web.control import Ask
from e3pose.site.web.feed import Feed
from e3pose.site.web.pictures import (
    POSES_S,
    CameraPictures,
    PictureRules,
    make_pictures,
    reprojected,
)
from e3pose.site.web.program import picture_rules
from e3pose.site.web.tokens import PageTokens, make_tokens
from e3pose.wire.codec import decode, encode
from e3pose.wire.site_messages import CameraStatus, Picture, PictureQuestion, Status
from lies import jpeg_header, lies_of_fields, picture_schemes

SLOT_NS = round(1e9 / FPS)
PER_S = 2.0


def captured(slot: float) -> int:
    return STARTED_NS + round(slot * SLOT_NS)


JPEG = jpeg_header(320, 256)
NEXT, LARGE = JPEG + b"next", jpeg_header(960, 768)


def taken(slot: float, jpeg: bytes = JPEG) -> Picture:
    """A picture captured at a time in slots, which the camera calls slot 99."""
    return Picture("c0", 99, (1000, 800), jpeg, 7, 0.5, captured(slot))


@dataclass
class Seen:
    """Pictures of a camera that a test plays, on a clock that it moves."""

    hub: Hub = field(default_factory=Hub)
    now_s: float = 100.0
    answer: Picture | bytes | None = None
    asked: list[PictureQuestion] = field(default_factory=list)
    edge: MemoryTransport = field(init=False)
    pictures: CameraPictures = field(init=False)

    def __post_init__(self) -> None:
        feed = Feed("lab", now_s=lambda: self.now_s, quiet_s=60.0)
        feed.listen(self.hub.join())
        self.edge = self.hub.join()
        self.pictures = CameraPictures(
            RIG.cameras[0], feed, self._answer, 1 / FPS, PER_S, lambda: self.now_s
        )

    def _answer(self, payload: bytes) -> bytes | None:
        self.asked.append(decode(payload, PictureQuestion, "view"))
        return encode(self.answer) if isinstance(self.answer, Picture) else self.answer

    def publish(self, *slots: int) -> None:
        for slot in slots:
            self.edge.publish("e3pose/lab/poses", encode(poses(slot)))

    def say(self, camera: CameraStatus) -> None:
        said = Status("lab", 1, FPS, 1, 0, (camera,))
        self.edge.publish("e3pose/lab/status", encode(said))

    def ask(
        self, have: str = "", large: bool = False, after_s: float = 1 / PER_S
    ) -> dict[str, Any]:
        """Let time pass, and ask as a page does."""
        self.now_s += after_s
        return self.pictures.newest(have, large)


def test_people_are_those_of_the_slot_nearest_to_the_capture() -> None:
    seen = Seen(answer=taken(3.4))
    seen.publish(2, 3, 4)
    found = seen.ask()
    assert base64.b64decode(found["jpeg"]) == JPEG
    assert (found["slot"], found["captured_ns"]) == (3, captured(3.4))
    assert found["apart_ms"] == pytest.approx(-0.4 * 1000 / FPS, abs=0.01)
    people = {person["track"]: person for person in found["people"]}
    expected = RIG.cameras[0].project(record(3).people.joints_m[0, 5])
    assert people[10]["joints_px"][5] == pytest.approx(expected.tolist(), abs=0.1)
    assert people[10]["joints_px"][3] == [None, None]
    assert people[10]["measured"][5] and not people[10]["measured"][3]


def test_picture_waits_until_the_poses_of_its_moment_are_published() -> None:
    seen = Seen(answer=taken(2))
    seen.publish(1, 2)
    assert seen.ask()["slot"] == 2
    seen.answer = taken(4, NEXT)
    waiting = seen.ask()
    assert waiting["slot"] == 2 and base64.b64decode(waiting["jpeg"]) == JPEG
    seen.publish(3, 4)
    found = seen.ask(after_s=0.01)
    assert found["slot"] == 4 and base64.b64decode(found["jpeg"]) == NEXT
    assert len(seen.asked) == 2


@each_case(("moment", "slots"), [(5.0, (2, 3)), (1.4, (3, 4))])
def test_moment_without_a_slot_shows_nobody(moment: float, slots: tuple[int, ...]) -> None:
    seen = Seen(answer=taken(moment))
    seen.publish(*slots)
    seen.ask()
    found = seen.ask(after_s=2.5)
    assert found["jpeg"] and found["slot"] is None and found["people"] == []


def test_camera_is_asked_so_often_and_no_more_however_many_watch() -> None:
    seen = Seen(answer=taken(2))
    seen.publish(2)
    for _ in range(100):
        seen.ask(after_s=0.125)
        for _ in range(3):
            seen.ask(after_s=0.0)
    assert len(seen.asked) == 12.5 * PER_S


def test_last_picture_of_a_camera_that_sleeps_has_its_age_and_is_not_sent_again() -> None:
    seen = Seen(answer=taken(2))
    seen.publish(2)
    first = seen.ask()
    seen.answer = Picture("c0", 0, (1, 1), b"")  # the camera has no newer one
    again = seen.ask(first["have"])
    assert seen.asked[-1] == PictureQuestion(captured(2), False)
    assert again["jpeg"] is None and again["captured_ns"] == captured(2) and not again["why"]
    assert seen.ask()["jpeg"] == first["jpeg"]  # another page
    # Last picture of a camera that sleeps has its age.
    seen = Seen(answer=taken(2))
    seen.publish(2)
    assert seen.ask()["age_s"] == pytest.approx(1 / PER_S, abs=0.01)
    seen.answer = Picture("c0", 0, (1, 1), b"")
    found = seen.ask(after_s=30.0)
    assert found["jpeg"] and found["age_s"] == pytest.approx(30.5, abs=0.01)
    assert found["slot"] == 2 and len(found["people"]) == 2  # those of its own moment


def test_large_picture_is_asked_for_while_somebody_wants_one() -> None:
    seen = Seen(answer=taken(2))
    seen.publish(2)
    small = seen.ask()
    seen.answer = taken(2, LARGE)
    large = seen.ask(small["have"], large=True)
    assert seen.asked[-1] == PictureQuestion(0, True)
    assert base64.b64decode(large["jpeg"]) == LARGE
    seen.answer = Picture("c0", 0, (1, 1), b"")
    seen.ask(large["have"], large=True)
    assert seen.asked[-1] == PictureQuestion(captured(2), True)
    seen.ask(large["have"], after_s=5.0)
    assert seen.asked[-1] == PictureQuestion(captured(2), False)


@each_case(
    ("answer", "camera", "why"),
    [
        (None, None, "edge gone"),
        (None, CameraStatus("c0", False, "silent for 2 s"), "offline: silent for 2 s"),
        (None, CameraStatus("c0", True), "no answer: does the camera file have"),
        (Picture("c0", 0, (1, 1), b"", why="no detection yet"), CameraStatus("c0", True), "no det"),
        (b"garbage", CameraStatus("c0", True), "c0: message"),
    ],
)
def test_missing_picture_says_why(
    answer: Picture | bytes | None, camera: CameraStatus | None, why: str
) -> None:
    seen = Seen(answer=answer)
    if camera is not None:
        seen.say(camera)
    found = seen.ask()
    assert found["why"].startswith(why) and found["jpeg"] is None and found["captured_ns"] is None
    assert len(found["why"]) < 70


LIES = {lie.name: lie.changes[Picture] for lie in picture_schemes() if lie.name != "late answer"}


@each_case("name", LIES)
def test_camera_that_lies_shows_nothing_and_is_named(name: str) -> None:
    seen = Seen(answer=taken(2))
    seen.publish(2)
    seen.say(CameraStatus("c0", True))
    before = seen.ask()
    message = LIES[name](taken(3), 0, Random(1))
    seen.answer = encode(message) if isinstance(message, Picture) else message
    seen.publish(3)
    seen.ask()
    found = seen.ask(after_s=POSES_S)  # also what comes of a later moment would be shown by now
    assert found["captured_ns"] == before["captured_ns"] and found["jpeg"] == before["jpeg"]
    assert len(found["why"]) < 200
    assert "byte" in name or found["why"].startswith(("c0: ", "no answer"))
    seen.answer = taken(3)
    assert seen.ask()["slot"] == 3  # an honest one


def test_extremes_of_every_field_of_a_picture_end_no_page() -> None:
    app, said = FastAPI(), []
    for lie, count in lies_of_fields(hold=1):
        for n in range(count if Picture in lie.changes else 0):
            seen = Seen()
            seen.publish(2)
            try:
                seen.answer = encode(lie.changes[Picture](taken(2), n, Random(1)))
            except (OverflowError, TypeError, ValueError):
                seen.answer = b"\xc1"  # what msgpack cannot hold
            name = f"/{lie.name}/{n}"
            app.get(name)(seen.ask)
            shown = TestClient(app).get(name, params={"after_s": 1.0})
            assert shown.status_code == 200, lie.name
            if jpeg := shown.json()["jpeg"]:
                assert base64.b64decode(jpeg) == JPEG
            said.append(shown.json()["why"])
    assert len(said) > 50 and any(said)


def test_camera_that_never_answers_keeps_nobody_waiting() -> None:
    asked, end, app = threading.Event(), threading.Event(), FastAPI()

    def hangs(payload: bytes) -> None:
        asked.set()
        end.wait(20.0)

    asks: dict[str, Ask] = {i: lambda payload: encode(taken(2)) for i in RIG.camera_ids}
    app.include_router(make_pictures(RIG, Feed("lab"), {**asks, "c0": hangs}, 1 / FPS, PER_S))
    with TestClient(app) as client:
        first = threading.Thread(target=lambda: client.get("/api/pictures/c0"))
        first.start()
        assert asked.wait(20.0)
        for _ in range(60):  # more than a server has threads
            assert client.get("/api/pictures/c0").json()["jpeg"] is None
        assert client.get("/api/pictures/c1").status_code == 200
        assert first.is_alive()
        end.set()
        first.join(20.0)


@each_case(
    ("data", "size"),
    [
        (jpeg_header(320, 240), (320, 240)),
        (b"\xff\xd8\xff\xe0\0\4ab\xff\xff\xff\xd0" + jpeg_header(2, 3)[2:], (2, 3)),
        (jpeg_header(60_000, 60_000), None),
        (jpeg_header(0, 10), None),
        (jpeg_header(320, 240)[:8], None),
        (b"\xff\xd8" + 10 * b"\xff\xe0\0\0", None),
        (b"", None),
    ],
)
def test_size_of_a_jpeg_is_read_beforehand(data: bytes, size: tuple[int, int] | None) -> None:
    if size is None:
        with pytest.raises(InputError, match="picture: found"):
            jpeg_size(data)
    else:
        assert jpeg_size(data) == size


def test_route_knows_its_cameras() -> None:
    app = FastAPI()
    asks = dict.fromkeys(RIG.camera_ids, lambda _: None)
    app.include_router(make_pictures(RIG, Feed("lab"), asks, 1 / FPS, PER_S))
    client = TestClient(app)
    assert client.get("/api/pictures/c0").json()["why"] == "edge gone"
    assert client.get("/api/pictures/c9").status_code == 404
    assert client.get(f"/api/pictures/c0?have={'x' * 99}").status_code == 422


@each_case(
    ("view", "here", "operates", "shown", "why"),
    [
        ("", True, True, True, ""),
        ("", False, True, False, "pictures = true under"),
        ("pictures = true", False, True, True, ""),
        ("pictures = false", True, True, False, ""),
        ("", True, False, False, "operator's certificate"),
        ("pictures = false", True, False, False, ""),
    ],
)
def test_pictures_are_shown_on_loopback_and_elsewhere_where_the_site_says_so(
    tmp_path: Any, view: str, here: bool, operates: bool, shown: bool, why: str
) -> None:
    page = Rules(PageTokens(make_tokens()), frozenset(), here, open_pictures=here)
    rules = picture_rules(write_site(tmp_path, f"[view]\n{view}\n"), page, operates)
    assert rules.shown is shown and why in rules.why and bool(rules.why) is bool(why)
    assert rules.for_scope("read")["shown"] is (shown and here)
    assert rules.for_scope("write")["shown"] is shown


def test_beyond_loopback_pictures_take_the_write_token(watched: Watched) -> None:
    rules: Rules[PageTokens] = watched.view.rules
    headers = {"host": "localhost"}
    assert rules.open_pictures and rules.judge("/api/pictures/c0", headers, Client("a"))[1] is None
    beyond = Rules(rules.tokens, rules.hosts, open_reading=False)
    assert beyond.judge("/api/pictures/c0", headers, Client("a"))[1] is not None
    read = headers | {"authorization": f"Bearer {rules.tokens.own.read}"}
    refusal = beyond.judge("/api/pictures/c0", read, Client("a"))[1]
    assert refusal is not None and refusal.status == 403
    write = headers | {"authorization": f"Bearer {rules.tokens.own.write}"}
    assert beyond.judge("/api/pictures/c0", write, Client("a"))[1] is None
    assert PictureRules(True).for_scope("read")["why"] == "Pictures need the write token."


def test_page_is_told_of_pictures(watched: Watched) -> None:
    with watched.client() as client:
        told = client.get("/api/site").json()["pictures"]
        assert told == {"shown": True, "why": "", "per_s": 2.0}
        watched.publish(3)
        found = client.get("/api/pictures/c0").json()
        assert found["jpeg"] is None and "no answer" in found["why"]
        assert 0 <= client.get("/api/status").json()["silent_s"] < 60


def test_joints_behind_a_camera_are_not_drawn() -> None:
    slot = live_slot(poses(3))
    behind = slot.people.joints_m.copy()
    behind[0, 0] = [9.0, 0.0, 1.0]  # c0 stands at x = 4 m and looks to x = 0
    moved = replace(slot, people=replace(slot.people, joints_m=behind))
    assert np.isnan(RIG.cameras[0].project(behind[0, 0].astype(float))).all()
    assert reprojected(moved, RIG.cameras[0])[0]["joints_px"][0] == [None, None]
