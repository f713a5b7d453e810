"""The page of events, from four films to a fall in Home Assistant's format, command by command."""

from __future__ import annotations

import json
import shlex
import signal
import subprocess
import sys
import threading
from pathlib import Path

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from tests.live.test_events_of_people import is_reached
from tests.live.test_events_of_people import port as port
from tests.test_docs import BY_PAGE, blocks
from tests.waiting import eventually

pytestmark = pytest.mark.nightly

PAGE = "docs/how-to/events.md"
FIRST = "e3pose simulate films"
FALL_S = 240.0  # what a machine that never ran this may take


def page_commands() -> list[str]:
    """Return the commands of the walk in their order."""
    lines = [line for block in blocks(BY_PAGE[PAGE], "") for line in block.strip().splitlines()]
    first = next(i for i, line in enumerate(lines) if line.startswith(FIRST))
    last = next(i for i, line in enumerate(lines) if line.startswith("e3pose stream room"))
    return lines[first : last + 1]


def start(command: str, folder: Path) -> subprocess.Popen[bytes]:
    """Start an `e3pose` command of the page; what it says goes to a file of its verb's name."""
    program, verb, *words = shlex.split(command)
    assert program == "e3pose"
    with (folder / f"{verb}.log").open("wb") as log:
        made = [sys.executable, "-m", "e3pose", verb, *words]
        return subprocess.Popen(made, cwd=folder, stdout=log, stderr=subprocess.STDOUT)


def test_four_films_and_a_broker_bring_a_fall_to_home_assistant(tmp_path: Path, port: int) -> None:
    before, ready = dict[str, str](), threading.Event()

    def note(_client: object, _data: object, message: mqtt.MQTTMessage) -> None:
        before.setdefault(message.topic, message.payload.decode())

    home = mqtt.Client(CallbackAPIVersion.VERSION2)
    home.on_message, home.on_subscribe = note, lambda *_: ready.set()
    assert eventually(lambda: is_reached(home, port)), "mosquitto runs"
    home.loop_start()
    running = list[subprocess.Popen[bytes]]()
    for command in page_commands():
        program = command.split()[0]
        if program == "mosquitto":
            assert command == "mosquitto -p 1883"
        elif program == "mosquitto_sub":
            for topic in shlex.split(command)[3::2]:
                home.subscribe(topic)
            assert ready.wait(30)
        elif program == "echo":
            subprocess.run(command, shell=True, cwd=tmp_path, check=True)
        elif command.split()[1] in ("up", "stream"):
            running.append(start(command.replace(":1883", f":{port}"), tmp_path))
        else:
            assert start(command, tmp_path).wait(400) == 0, command
    try:
        fall = "e3pose/room/home/trigger/fall"
        assert eventually(lambda: fall in before, FALL_S), before
        (discovery,) = [topic for topic in before if topic.startswith("homeassistant/")]
        config = json.loads(before[discovery])
        assert config["components"]["trigger_fall"]["topic"] == fall
        assert json.loads(before[fall])["sentence"].partition(" fell at ")[2]
        told = [sys.executable, "-m", "e3pose", "query", "room", "--what", "events"]
        assert b"fall" in subprocess.check_output(told, cwd=tmp_path)
    finally:
        for one in reversed(running):
            one.send_signal(signal.SIGINT)
        for one in running:
            one.wait(60)
        home.disconnect()
        home.loop_stop()
