"""What a set-up finds when it is started again: pictures, work cut off; and newer cameras."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.rigs import looking
from tests.site.setup.conftest import Asking
from tests.site.tables import resolved_site

from e3pose.base.errors import GaveUp, InputError
from e3pose.camera.probe import Probe
from e3pose.site.setup import cameras, going_live
from e3pose.site.setup.cameras import NetworkCamera, check_typed
from e3pose.site.setup.onvif import Denied, Login, Stream
from e3pose.site.setup.session import AT_WORK, SetupSession
from e3pose.site.setup.tasks import Task
from e3pose.site.setup.walking import PICTURES, Snapshots, forget_pictures
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import Picture

JPEG = bytes(cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes())


def picture(name: str, slot: int) -> bytes:
    return encode(Picture(name, slot, (640, 480), JPEG, captured_edge_ns=1))


def test_pictures_of_a_walk_are_there_again_and_for_their_owner_alone(tmp_path: Path) -> None:
    taken = Snapshots()
    for slot in (30, 4):
        taken._keep("hall-2", picture("hall-2", slot))
    taken._keep("door", picture("door", 7))
    taken.save(tmp_path)
    for path in (tmp_path / PICTURES).iterdir():
        assert path.stat().st_mode & 0o077 == 0
    (tmp_path / PICTURES / "door-9-1x1.jpg").write_bytes(b"no picture")
    (tmp_path / PICTURES / "notes.jpg").write_bytes(JPEG)
    found = Snapshots()
    found.load(tmp_path)
    assert {name: [p.slot for p in some] for name, some in found.pictures.items()} == {
        "hall-2": [4, 30], "door": [7],
    }  # fmt: skip
    assert found.pictures["door"][0].image_size == (640, 480)
    found.save(tmp_path)
    assert len(list((tmp_path / PICTURES).iterdir())) == 3, "those of before are gone"
    forget_pictures(tmp_path)
    assert not (tmp_path / PICTURES).exists()


def test_work_that_was_cut_off_is_said(tmp_path: Path) -> None:
    setup = SetupSession(tmp_path)
    setup.choose("room", new=True)
    setup.start(Task("solve", "Finding the cameras"), lambda task: None)
    setup.tasks.wait(10)
    assert setup.results()[AT_WORK] is None
    setup.keep_result(AT_WORK, {"kind": "walk", "title": "Recording"})  # then killed
    begun = setup.folder / "walk.partial"
    begun.mkdir()
    again = SetupSession(tmp_path)
    again.choose("room")
    task = again.tasks.newest
    assert task is not None and (task.kind, task.state) == ("walk", "failed")
    assert not begun.exists(), "the next walk needs its place"
    assert "interrupted" in task.problem and "start it again" in task.problem
    once_more = SetupSession(tmp_path)
    once_more.choose("room")
    assert once_more.tasks.newest is None


def test_network_cameras_are_asked_for_streams(
    asking: Asking, monkeypatch: pytest.MonkeyPatch
) -> None:
    def streams(service: str, login: Login) -> list[Stream]:
        if login.password != "right":
            raise Denied("10.0.0.7: wants a user and password, those of the camera")
        return [Stream("Main", "rtsp://admin:right@10.0.0.7/main")]

    monkeypatch.setattr(cameras, "look_around", lambda: [NetworkCamera("10.0.0.7", "IPC", "http:")])
    monkeypatch.setattr(cameras, "streams_of", streams)
    asking.post("site", name="room", kind="new")
    asking.post("look")
    asking.server.table.setup.tasks.wait(20)
    (found,) = asking.get("found").json()["network"]
    assert found["streams"] == [] and "wants a user" in found["why"]
    refused = asking.post("streams", host="10.0.0.7", user="admin", password="wrong")
    assert refused.status_code == 409 and "wants a user" in refused.json()["detail"]
    other = asking.post("streams", host="192.0.2.9", user="a", password="right")
    assert "one that was found" in other.json()["detail"]
    told = asking.post("streams", host="10.0.0.7", user="admin", password="right").json()
    assert told["streams"] == [{"name": "Main", "source": "rtsp://admin:***@10.0.0.7/main"}]
    assert asking.get("found").json()["network"][0]["why"] == ""
    # What the page was shown adds the stream; its password goes to a private file.
    monkeypatch.setattr(cameras, "probe", lambda source: Probe(source, (640, 480), 25.0, False))
    asking.post("cameras", sources=[told["streams"][0]["source"]])
    asking.server.table.setup.tasks.wait(20)
    (camera,) = asking.get("state").json()["cameras"]
    assert camera["source"] == "secret:room/secrets/cam0"
    file = asking.root / "room" / "secrets" / "cam0"
    assert file.read_text() == "rtsp://admin:right@10.0.0.7/main\n"
    assert file.stat().st_mode & 0o777 == 0o600
    again = asking.post("cameras", sources=[told["streams"][0]["source"]])
    assert "no camera of the site yet" in again.json()["detail"] and "right" not in again.text
    assert ":right" not in (asking.root / "room" / "setup.toml").read_text()


def test_a_phone_is_added_and_shown_a_code(asking: Asking) -> None:
    asking.post("site", name="room", kind="new")
    shown = asking.post("phones", name="anna").json()
    assert shown["picture"].startswith("data:image/svg+xml") and shown["url"].startswith("https://")
    assert shown["command"] == "e3pose phone room-phones/anna.toml"
    (camera,) = asking.get("state").json()["cameras"]
    assert (camera["id"], camera["source"]) == ("anna", "phone:room-phones/anna.toml")
    assert shown["url"].partition("#")[2] not in asking.get("state").text
    assert "it already" in asking.post("phones", name="anna").json()["detail"]
    assert asking.post("phones", name="../x").status_code == 409
    again = asking.post("phones/anna").json()
    assert again["url"] != shown["url"] and again["port"] == shown["port"]
    with pytest.raises(InputError, match="Add a phone"):
        check_typed("phone:x.toml", asking.root)


def test_site_that_gives_up_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def give_up(*_args: object, **_more: object) -> None:
        raise GaveUp("edge: out of luck (ended 5 times, the last with code 4)")

    monkeypatch.setattr(going_live, "site_programs", give_up)
    live = going_live.LiveSite(state="starting")
    live._run(resolved_site(tmp_path, looking((4, 0), (0, 4))))
    assert live.state == "failed" and live.problem.startswith("edge: out of luck (ended 5 times")
