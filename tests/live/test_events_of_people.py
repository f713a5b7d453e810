"""A fall in a running site: stored, and told to Home Assistant through a broker."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from tests.live.processes import CAMERAS, FPS, LiveSite, e3pose, run
from tests.ports import free_port
from tests.site.streams.test_webhook import SECRET, Receiver, checker
from tests.waiting import eventually

from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.simulation import lives_of
from e3pose.store import Store
from e3pose.store.people import people_of

HOME = SceneSettings("home-fall", seconds=30.0, fps=FPS, cameras=len(CAMERAS))
SEED = 1


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    """A mosquitto on a free port."""
    program = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:/usr/local/sbin")
    if program is None:
        pytest.skip("mosquitto is not installed")
    port, file = free_port(), tmp_path / "mosquitto.conf"
    file.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    broker = subprocess.Popen([program, "-c", str(file)], stderr=subprocess.DEVNULL)
    yield port
    broker.terminate()
    broker.wait()


def is_reached(home: mqtt.Client, port: int) -> bool:
    """Return whether a client has reached a broker, which may still start."""
    try:
        return not home.connect("127.0.0.1", port)
    except OSError:
        return False


@pytest.fixture
def receiver(tmp_path: Path) -> Iterator[Receiver]:
    receiver = Receiver(tmp_path)
    yield receiver
    receiver.end()


def test_a_fall_reaches_home_assistant_a_webhook_and_the_store(
    tmp_path: Path, port: int, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    (life,) = lives_of(HOME, SEED)
    assert life.episodes[0].kind.startswith("fall")
    save_recording(simulate(HOME, SEED), tmp_path / "recording")
    tables = ("[store]", 'path = "poses.db"', "[events]", "lies_s = 8.0")
    site = LiveSite(tmp_path, tables=tables)
    heard, ready = dict[str, Any](), threading.Event()

    def note(_client: object, _data: object, message: mqtt.MQTTMessage) -> None:
        heard[message.topic] = message.payload.decode()

    home = mqtt.Client(CallbackAPIVersion.VERSION2)
    home.on_message = note
    home.on_subscribe = lambda *_: ready.set()
    with site.at_work():
        assert eventually(lambda: is_reached(home, port)), "mosquitto runs"
        home.loop_start()
        home.subscribe("#", qos=1)
        assert ready.wait(30)
        place = f"homeassistant://127.0.0.1:{port}"
        hook = f"webhook:http://127.0.0.1:{receiver.port}/hook"
        (tmp_path / "secret").write_bytes(SECRET)
        (tmp_path / "secret").chmod(0o600)
        monkeypatch.setenv("E3POSE_WEBHOOK_SECRET_FILE", str(tmp_path / "secret"))
        receiver.start("takes")
        site.start("stream", *e3pose("stream", str(site.path), place, hook))
        trigger = "e3pose/lab/home/trigger/fall"
        assert eventually(lambda: trigger in heard, 90.0), (heard, site.diagnostics())
        config = json.loads(heard["homeassistant/device/e3pose_lab/config"])
        assert {"alarm_fall", "trigger_fall", "people"} <= set(config["components"])
        assert heard["e3pose/lab/home/online"] == "online"
        assert "fell" in json.loads(heard[trigger])["sentence"]

        def notices() -> list[str]:
            assert all(
                checker()(n["body"].encode(), n["signature"], SECRET) for n in receiver.got()
            )
            return [json.loads(notice["body"])["kind"] for notice in receiver.got()]

        # Who joins while somebody lies there is told that first.
        assert eventually(lambda: "fall" in notices()), site.log("stream").read_text()
        assert not any("joints" in payload for payload in heard.values()), "no poses leave"

        def stored() -> list[dict[str, Any]]:
            return [r for r in Store(tmp_path / "poses.db").rows("events") if r["kind"] == "fall"]

        assert eventually(lambda: bool(stored())), site.diagnostics()
        assert stored()[0]["phase"] == "begun" and stored()[0]["track_id"] >= 0
        site.start("test", *e3pose("events", "test", str(site.path), "--for", "90"))
        assert eventually(lambda: "FALL begun" in site.log("test").read_text(), 90.0)
        site.send("test", signal.SIGINT)  # which says what it saw so far
        assert site.wait("test") == 0, site.log("test").read_text()
        said = site.log("test").read_text()
        assert "is lying on the floor" in said and "s after it began" in said, said
        assert "A fall or a long lie was reported." in said, said
        site.programs["stream"].kill()  # the broker tells what its program cannot
        assert eventually(lambda: heard["e3pose/lab/home/online"] == "offline")
    home.disconnect()
    home.loop_stop()


def test_a_name_is_told_while_it_is_one_and_forgotten_everywhere(tmp_path: Path, port: int) -> None:
    save_recording(simulate(HOME, SEED), tmp_path / "recording")
    tables = ("[store]", 'path = "poses.db"', "[events]", "lies_s = 8.0", 'names = ["mqtt"]')
    site = LiveSite(tmp_path, tables=tables)
    told, ready = list[tuple[str, str, bool]](), threading.Event()

    def note(_client: object, _data: object, message: mqtt.MQTTMessage) -> None:
        if "/event/" in message.topic:
            told.append((message.topic, message.payload.decode(), message.retain))

    def names() -> list[str]:
        return [json.loads(payload)["name"] for _, payload, _ in told]

    def tells(name: str) -> bool:
        """Give everybody the name, and return whether an event was told with it."""
        for person in people_of(tmp_path / "poses.db"):
            run_of, track = person.tracks[0]
            who = person.name or str(track)
            if who != name:
                run("people", "name", str(site.path), who, name, "--run", str(run_of))
        return name in names()

    home = mqtt.Client(CallbackAPIVersion.VERSION2)
    home.on_message = note
    home.on_subscribe = lambda *_: ready.set()
    with site.at_work():
        assert eventually(lambda: is_reached(home, port)), "mosquitto runs"
        home.loop_start()
        home.subscribe("#", qos=1)
        assert ready.wait(30)
        site.start("stream", *e3pose("stream", str(site.path), f"mqtt://127.0.0.1:{port}"))
        assert eventually(lambda: tells("Ada"), 90.0), (told, site.diagnostics())
        assert eventually(lambda: tells("Berta"), 90.0), (told, site.diagnostics())
        since = len(told) - 1
        assert "Ada" not in names()[since:]
        assert not any(retained for _, _, retained in told), "no broker keeps a name"
        table, copy = tmp_path / "tracks.csv", tmp_path / "backup.db"
        assert run("query", str(site.path), "--what", "tracks", "--csv", str(table))[0] == 0
        assert run("store", "copy", str(site.path), str(copy))[0] == 0
        assert "Berta" in table.read_text()
        tracks = [one for p in people_of(tmp_path / "poses.db") for one in p.tracks if p.name]
        also = ("--also", str(table), str(copy))
        code, said, error = run("people", "forget", str(site.path), "Berta", *also)
        assert code == 0 and " 0 left" in said, (said, error)
        begun = len(told)
        assert eventually(lambda: len(told) > begun, 90.0), site.diagnostics()
        assert set(names()[begun:]) == {""}, "who was forgotten is a number"
        site.send("edge", signal.SIGINT)
        assert site.wait("edge") == 0
    home.disconnect()
    home.loop_stop()
    for run_of, track in tracks:  # who stayed in view was stored on
        code, said, error = run(
            "people", "forget", str(site.path), str(track), "--run", str(run_of)
        )
        assert code == 0 and " 0 left" in said, (said, error)
        found = run("people", "find", str(site.path), str(track), "--run", str(run_of))
        assert found[0] == 0 and "Nothing of" in found[1], found
    kept = [path for path in tmp_path.rglob("*") if path.is_file()]
    traces = [
        path.name for path in kept for name in (b"Ada", b"Berta") if name in path.read_bytes()
    ]
    assert copy in kept and traces == []
