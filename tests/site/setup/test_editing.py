"""A site file that exists is changed: checked first, comments kept, the file of before kept."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from tests.ports import free_port
from tests.rigs import looking

from e3pose.base.errors import InputError
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.settings.resolved import ResolvedSite
from e3pose.settings.site_file import load_site
from e3pose.site.setup import settings
from e3pose.site.setup.editing import apply_cameras, restore_before
from e3pose.site.setup.going_live import LiveSite
from e3pose.site.setup.plan import ChosenCamera, Plan
from e3pose.site.setup.session import SetupSession
from e3pose.site.setup.settings import Wanted, Zone, change_settings, present
from e3pose.wire.site_messages import Control

PORT = free_port()  # nobody listens there
SITE = f"""# my site
format = "e3pose-site"
version = 1
name = "lab"
calibration = "rig.toml"
fps = 10  # as measured

[link]
endpoint = "tcp/127.0.0.1:{PORT}"

[store]
path = "live.db"

[loop]
cameras = 2  # of three

[[camera]]
id = "c0"  # at the door
source = "usb:0"
detector = "movenet-multipose"

[[camera]]
id = "c1"
source = "usb:1"
detector = "movenet-multipose"

[[camera]]
id = "c2"
source = "usb:2"
detector = "movenet-multipose"
"""
RIG = looking((4, 0), (0, 4), (-4, 0))


@pytest.fixture
def setup(tmp_path: Path) -> SetupSession:
    folder = tmp_path / "lab"
    folder.mkdir()
    (folder / "site.toml").write_text(SITE)
    save_rig(RIG, folder / "rig.toml")
    return SetupSession(tmp_path, "lab")


def change(setup: SetupSession, **wanted: object) -> str:
    return str(change_settings(setup, LiveSite(), Wanted(**wanted))["said"])  # type: ignore[arg-type]


def test_goals_zones_batteries_and_storage_are_written(setup: SetupSession) -> None:
    corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0)]
    said = change(
        setup, target_error="40mm", budget="4W", batteries={"c1": 50.0, "c0": 0.0}, keep="7d",
        max_size="2GB", zones=[Zone(name="door", corners=corners)],
    )  # fmt: skip
    assert said == "Wrote lab/site.toml; the file of before is site.toml.before."
    site = load_site(setup.folder)
    assert site.loop.target_error_m == pytest.approx(0.04) and site.loop.num_selected is None
    assert site.budget == "4W" and site.store is not None and site.store.max_bytes == 2e9
    assert [camera.battery_wh for camera in site.camera] == [None, 50.0, None]
    assert site.zone[0].name == "door" and list(site.zone[0].corners) == corners
    text = setup.site_file.read_text()
    assert "# my site" in text and "# at the door" in text and "fps = 10  # as measured" in text
    assert (setup.folder / "site.toml.before").read_text() == SITE
    shown = present(setup)
    assert shown["target_error"] == "40mm" and shown["zones"][0]["name"] == "door"
    assert change(setup, cameras=1.5, zones=[]) and load_site(setup.folder).zone == ()
    assert load_site(setup.folder).loop.num_selected == 1.5


def test_what_is_wrong_is_said_and_nothing_is_written(setup: SetupSession) -> None:
    for wanted, said in (
        ({"cameras": 99.0}, "loop.cameras"),
        ({"target_error": "1"}, "target_error"),
        ({"budget": "much"}, "budget"),
        ({"keep": "long"}, "store.keep"),
        ({"batteries": {"nobody": 5.0}}, "camera 'nobody'"),
        ({"zones": [Zone(name="a b", corners=[(0, 0), (1, 0), (1, 1)])]}, "zone"),
        ({"zones": [Zone(name="a", corners=[(0, 0), (1, 0), (1, 1)])] * 2}, "zone a: found twice"),
        ({"cameras": 1.0, "target_error": "40mm"}, "found both"),
    ):
        with pytest.raises(InputError, match=said):
            change(setup, **wanted)
        assert setup.site_file.read_text() == SITE
    assert not (setup.folder / "site.toml.before").exists()
    assert change(setup, cameras=2) == "Nothing changed."


def test_the_file_of_before_comes_back_and_goes_again(setup: SetupSession) -> None:
    with pytest.raises(InputError, match="file not found"):
        restore_before(setup.site_file)
    change(setup, cameras=1)
    changed = setup.site_file.read_text()
    restore_before(setup.site_file)
    assert setup.site_file.read_text() == SITE
    restore_before(setup.site_file)
    assert setup.site_file.read_text() == changed


def test_a_running_site_takes_what_it_can(
    setup: SetupSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    live, asked = LiveSite(state="running"), list[Control]()

    def ask(control: Control) -> str:
        asked.append(control)
        return "1 camera per slot"

    monkeypatch.setattr(live, "ask", ask)
    found = change_settings(setup, live, Wanted(cameras=1.0))
    assert asked == [Control(1.0, None)] and not found["restart"]
    assert "At once: 1 camera per slot." in found["said"]
    found = change_settings(setup, live, Wanted(target_error="40mm", keep="3d"))
    assert asked[-2].target_error_mm == pytest.approx(40.0) and not found["restart"]
    assert asked[-1] == Control(reread=True)
    batteries, door = {"c0": 50.0}, Zone(name="door", corners=[(0, 0), (1, 0), (1, 1)])
    found = change_settings(setup, live, Wanted(batteries=batteries, zones=[door], budget="60%"))
    assert asked[-1] == Control(reread=True) and len(asked) == 4
    assert "The running site takes batteries at its next start" in found["said"]
    assert found["restart"], "one click"


def test_what_a_running_edge_refuses_waits_for_its_restart(
    setup: SetupSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    live = LiveSite(state="running")

    def ask(control: Control) -> str:
        raise InputError("the edge does not answer")

    monkeypatch.setattr(live, "ask", ask)
    found = change_settings(setup, live, Wanted(keep="3d"))
    assert found["restart"] and "takes storage at its next start" in found["said"]


def test_a_site_that_another_program_runs_is_asked_too(
    setup: SetupSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[Control]()

    def ask(site: ResolvedSite, control: Control) -> str:
        asked.append(control)
        raise InputError("cameras: found 1, expected more")

    monkeypatch.setattr(settings, "ask_elsewhere", ask)
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        port = listening.getsockname()[1]
        setup.site_file.write_text(SITE.replace(f":{PORT}", f":{port}"))
        found = change_settings(setup, LiveSite(), Wanted(cameras=1.0))
    assert asked == [Control(1.0, None)] and not found["restart"]
    assert "cameras: found 1, expected more" in found["said"]
    assert "takes the goal at its next start, where you started it." in found["said"]


def chosen(*cameras: ChosenCamera) -> Plan:
    return Plan(cameras=cameras, detector="drawn")


def seen(camera_id: str, source: str, was: str, rotation: int = 0) -> ChosenCamera:
    return ChosenCamera(camera_id, source, rotation, 1000, 800, 8.0, 0.0, was)  # type: ignore[arg-type]


def apply(setup: SetupSession, plan: Plan) -> None:
    from e3pose.site.new_site import Choice

    setup.change(lambda _: plan)
    probes = {camera.id: camera.probe for camera in plan.cameras}
    apply_cameras(setup, Choice("lab", probes, "drawn", "auto", 1, 2, None))


def test_cameras_that_stay_keep_their_place_when_renamed_or_fewer(setup: SetupSession) -> None:
    apply(setup, chosen(seen("left", "usb:0", "c0", 90), seen("c2", "usb:2", "c2")))
    site, rig = load_site(setup.folder), load_rig(setup.folder / "rig.toml")
    assert [camera.id for camera in site.camera] == ["left", "c2"] and site.fps == 8
    assert site.camera[0].rotation == 90 and rig.camera_ids == ("left", "c2") and rig.placed
    assert rig.centers_m[0] == pytest.approx(RIG.centers_m[0])
    assert "# at the door" in setup.site_file.read_text()
    assert load_rig(setup.folder / "rig.toml.before").camera_ids == ("c0", "c1", "c2")


def test_a_new_camera_asks_for_a_new_walk(setup: SetupSession) -> None:
    setup.keep_result("solve", {"cameras": []})
    cameras = seen("c0", "usb:0", "c0"), seen("c1", "usb:1", "c1"), seen("n", "usb:7", "")
    apply(setup, chosen(*cameras))
    assert not setup.placed() and (setup.folder / "rig.toml.before").exists()
    assert setup.plan().walk == "" and setup.results()["solve"] is None
    assert load_site(setup.folder).camera[2].source == "usb:7"
