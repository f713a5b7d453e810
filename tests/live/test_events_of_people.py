"""A fall in a running site: stored, and told to Home Assistant through a broker."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from tests.live.processes import CAMERAS, FPS, LiveSite, e3pose
from tests.ports import free_port
from tests.site.streams.test_webhook import SECRET, Receiver, checker
from tests.waiting import eventually

from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.simulation import lives_of
from e3pose.store import Store

HOME = SceneSettings("home-fall", seconds=30.0, fps=FPS, cameras=len(CAMERAS))
SEED = 1


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """A mosquitto on a free port."""
    program = shutil.which("mosquitto", path="/usr/sbin:/usr/bin:/usr/local/sbin")
    if program is None:
        pytest.skip("mosquitto is not installed")
    port, file = free_port(), tmp_path_factory.mktemp("broker") / "mosquitto.conf"
    file.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    broker = subprocess.Popen([program, "-c", str(file)], stderr=subprocess.DEVNULL)
    yield port
    broker.terminate()
    broker.wait()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, port: int) -> Iterator[LiveSite]:
    """A home in which somebody falls every half minute; none without a broker."""
    folder = tmp_path_factory.mktemp("home")
    save_recording(simulate(HOME, SEED), folder / "recording")
    tables = ("[store]", 'path = "poses.db"', "[events]", "lies_s = 8.0")
    with LiveSite(folder, tables=tables, together=True).at_work() as made:
        yield made


@dataclass
class Heard:
    """What a client of a broker heard.

    Attributes:
        client: the client.
        messages: topic and payload, oldest first.
    """

    client: mqtt.Client
    messages: list[tuple[str, str]]

    def newest(self, topic: str) -> str | None:
        return next((told for at, told in reversed(self.messages) if at == topic), None)


@contextmanager
def listening(port: int, *topics: str) -> Iterator[Heard]:
    """Hear what a broker is told."""
    ready = threading.Event()
    heard = Heard(mqtt.Client(CallbackAPIVersion.VERSION2), [])
    home = heard.client
    home.on_message = lambda _client, _data, message: heard.messages.append(
        (message.topic, message.payload.decode())
    )
    home.on_subscribe = lambda *_: ready.set()
    assert eventually(lambda: is_reached(home, port)), "mosquitto runs"
    home.loop_start()
    for topic in topics:
        home.subscribe(topic, qos=1)
    try:
        assert ready.wait(30)
        yield heard
    finally:
        home.disconnect()
        home.loop_stop()


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
    site: LiveSite, port: int, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    (life,) = lives_of(HOME, SEED)
    assert life.episodes[0].kind.startswith("fall")
    store = Store(site.folder / "poses.db")
    with listening(port, "#") as heard:
        place = f"homeassistant://127.0.0.1:{port}"
        hook = f"webhook:http://127.0.0.1:{receiver.port}/hook"
        secret = site.folder / "secret"
        secret.write_bytes(SECRET)
        secret.chmod(0o600)
        monkeypatch.setenv("E3POSE_WEBHOOK_SECRET_FILE", str(secret))
        receiver.start("takes")
        site.start("stream", *e3pose("stream", str(site.path), place, hook))
        site.start("test", *e3pose("events", "test", str(site.path), "--for", "90"))
        trigger = "e3pose/lab/home/trigger/fall"
        assert eventually(lambda: heard.newest(trigger), 90.0), (heard, site.diagnostics())
        config = json.loads(heard.newest("homeassistant/device/e3pose_lab/config") or "")
        assert {"alarm_fall", "trigger_fall", "people"} <= set(config["components"])
        assert heard.newest("e3pose/lab/home/online") == "online"
        assert "fell" in json.loads(heard.newest(trigger) or "")["sentence"]

        def notices() -> list[str]:
            assert all(
                checker()(n["body"].encode(), n["signature"], SECRET) for n in receiver.got()
            )
            return [json.loads(notice["body"])["kind"] for notice in receiver.got()]

        # Who joins while somebody lies there is told that first.
        assert eventually(lambda: "fall" in notices()), site.log("stream").read_text()
        assert not any("joints" in told for _, told in heard.messages), "no poses leave"

        def stored() -> list[dict[str, Any]]:
            return [row for row in store.rows("events") if row["kind"] == "fall"]

        assert eventually(lambda: bool(stored())), site.diagnostics()
        assert stored()[0]["phase"] == "begun" and stored()[0]["track_id"] >= 0
        assert eventually(lambda: "FALL begun" in site.log("test").read_text(), 90.0)
        site.send("test", signal.SIGINT)  # which says what it saw so far
        assert site.wait("test") == 0, site.log("test").read_text()
        said = site.log("test").read_text()
        assert "is lying on the floor" in said and "s after it began" in said, said
        assert "A fall or a long lie was reported." in said, said
        site.programs["stream"].kill()  # the broker tells what its program cannot
        assert eventually(lambda: heard.newest("e3pose/lab/home/online") == "offline")
