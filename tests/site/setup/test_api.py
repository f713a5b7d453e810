"""The API of the set-up: who may ask, what it refuses, and that it writes what `init` writes."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest
from tests.cases import each_case
from tests.site.setup.conftest import Asking

from e3pose.base.errors import InputError
from e3pose.settings.site_file import load_site
from e3pose.site.setup.plan import load_plan
from e3pose.site.setup.program import desk_of, open_setup

WAIT_S = 60.0


def bare(asking: Asking) -> httpx.Client:
    return httpx.Client(base_url=f"http://{asking.server.address}", timeout=30)


def test_every_question_needs_the_token(asking: Asking) -> None:
    with bare(asking) as nobody:
        for path in ("state", "found", "networks", "settings", "overlays", "covered"):
            answer = nobody.get(f"/api/setup/{path}")
            assert answer.status_code == 401 and "`e3pose setup` prints it" in answer.text
        wrong = {"Authorization": "Bearer wrong-wrong-wrong-wrong"}
        assert nobody.post("/api/setup/site", json={}, headers=wrong).status_code == 401
        assert nobody.get("/").status_code == 200, "the page holds nothing of the machine"
        assert "script-src 'self'" in nobody.get("/").headers["content-security-policy"]
    for headers, status in (
        ({"Host": "evil.example"}, 421),
        ({"Origin": "https://evil.example"}, 403),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({}, 200),
    ):
        assert asking.client.get("/api/setup/state", headers=headers).status_code == status


def test_bodies_are_small_and_hold_nothing_else(asking: Asking) -> None:
    assert asking.post("site", name="x" * 5000).status_code == 413
    assert asking.post("site", name="room", more=1).status_code == 422
    assert asking.post("cameras", sources=[]).status_code == 422
    assert asking.post("cameras", sources=["a"] * 33).status_code == 422
    assert asking.client.post("/api/setup/site", content=b"{" * 100).status_code == 422
    assert asking.client.post("/api/setup/record/everything").status_code == 422


@each_case("name", ["..", ".", "../x", "a/b", "a\\b", "-x", "", "x" * 65, "a\n"])
def test_names_of_sites_are_no_paths(asking: Asking, name: str) -> None:
    for kind in ("known", "new", "example"):
        assert asking.post("site", name=name, kind=kind).status_code in (409, 422)
    assert list(asking.root.iterdir()) == []


def test_a_site_is_to_be_named_and_a_folder_of_other_things_is_none(
    asking: Asking,
) -> None:
    for path, body in (("simulate", {}), ("cameras", {"sources": ["usb:0"]})):
        assert "choose or name it first" in asking.post(path, **body).json()["detail"]
    photos = asking.root / "photos"
    photos.mkdir()
    (photos / "a.jpg").touch()
    assert "found no site" in asking.post("site", name="photos").json()["detail"]
    assert "not empty" in asking.post("site", name="photos", kind="new").json()["detail"]
    assert [path.name for path in photos.iterdir()] == ["a.jpg"]
    state = asking.get("state").json()
    assert state["site"] == "" and state["sites"] == []


def test_a_finished_example_opens_with_its_steps_done(asking: Asking) -> None:
    state = asking.post("site", name="try", kind="example").json()
    done = {step["id"]: step["done"] for step in state["steps"]}
    assert state["site"] == "try" and len(state["cameras"]) == 4
    assert done["cameras"] and done["network"] and done["solve"] and not done["live"]
    commands = {step["id"]: step["command"] for step in state["steps"]}
    assert commands["live"] == "e3pose up try --view"
    asking.server.table.live.state = "running"  # which has the cameras
    for path in ("cameras/cam0", "record/walk", "site/leave"):
        assert "stop it first" in asking.post(path).json()["detail"], path
    asking.server.table.live.state = "off"
    assert asking.post("site/leave").json()["site"] == ""
    assert asking.get("state").json()["sites"] == [{"name": "try", "made": True}]


def test_films_become_a_site_that_the_verbs_read(asking: Asking, films: tuple[Path, ...]) -> None:
    assert asking.post("site", name="room", kind="new").status_code == 200
    found = asking.get("found").json()
    assert found["films"] == [f"films/{path.name}" for path in films]
    assert asking.post("cameras", sources=found["films"]).status_code == 200
    asking.server.table.setup.tasks.wait(WAIT_S)
    state = asking.get("state").json()
    assert state["task"]["state"] == "done", state["task"]
    assert [camera["id"] for camera in state["cameras"]] == ["a", "b"]
    assert state["cameras"][0]["width"] == 64 and state["cameras"][0]["fps"] == 5.0
    again = asking.post("cameras", sources=found["films"][:1]).json()
    assert "one that is no camera of the site yet" in again["detail"]
    assert asking.post("cameras/a", name="door", rotation=90).status_code == 200
    assert asking.post("cameras/b", name="door").json()["detail"] == (
        "camera door: found twice, expected another name"
    )
    assert asking.post("cameras/b", rotation=45).status_code == 409
    assert asking.post("cameras/nobody", remove=True).status_code == 409
    picture = asking.get("cameras/door/picture").json()
    assert picture["size"] == [64, 48] and picture["jpeg"], picture
    assert asking.post("networks/nonsense/use").status_code == 409
    assert asking.post("networks/drawn/use").status_code == 200
    asking.server.table.setup.tasks.wait(WAIT_S)
    state = asking.get("state").json()
    assert state["task"]["state"] == "done", state["task"]
    assert state["task"]["command"].startswith("e3pose init room door=films/a.mp4 b=films/b.mp4")
    site = load_site(asking.root / "room")
    assert [(c.id, c.rotation, c.detector) for c in site.camera] == [
        ("door", 90, "drawn"), ("b", None, "drawn"),
    ]  # fmt: skip
    assert {step["id"]: step["done"] for step in state["steps"]}["network"]
    speed = next(n["speed"] for n in asking.get("networks").json() if n["name"] == "drawn")
    assert "poses a second here with two cameras" in speed


def test_what_was_chosen_is_there_after_a_restart(
    asking: Asking, films: tuple[Path, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    asking.post("site", name="room", kind="new")
    asking.post("cameras", sources=["films/a.mp4"])
    asking.server.table.setup.tasks.wait(WAIT_S)
    asking.server.close()
    assert [camera.id for camera in load_plan(asking.root / "room").cameras] == ["a"]
    with open_setup(asking.root / "room", "127.0.0.1:0") as again:
        setup = again.table.setup
        assert setup.name == "room" and [c.id for c in setup.plan().cameras] == ["a"]


def test_steps_that_cannot_begin_say_why(asking: Asking) -> None:
    asking.post("site", name="room", kind="new")
    for path, body, said in (
        ("networks/drawn/use", {}, "two or more: 3D needs them"),
        ("record/walk", {}, "found a folder without site.toml"),
        ("solve", {"height_cm": 171}, "walk: found none, expected a recorded walk first"),
        ("solve", {"height_cm": 3}, "expected 50 to 250 cm"),
        ("check", {}, "second walk: found none"),
        ("live", {"order": "start"}, "found a folder without site.toml"),
        ("settings", {"cameras": 1}, "found a folder without site.toml"),
        ("cameras", {"sources": ["/etc/passwd"]}, "a folder above your films"),
    ):
        answer = asking.post(path, **body)
        assert answer.status_code == 409 and said in answer.json()["detail"], (path, answer.text)


def test_only_a_free_port_of_loopback_and_a_folder_serve(asking: Asking, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is in use: stop .* such as another `e3pose setup`"):
        open_setup(None, asking.server.address)
    with pytest.raises(InputError, match="an address of loopback"):
        open_setup(None, "0.0.0.0:0")
    with pytest.raises(InputError, match="HOST:PORT"):
        open_setup(None, "here")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="expected the folder of a site"):
        desk_of(tmp_path / "file")
    assert desk_of(tmp_path / "new").name == "new"
