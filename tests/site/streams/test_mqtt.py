"""A broker with a password and a certificate: accepted clients, and messages to others."""

from __future__ import annotations

import datetime
import json
import re
import ssl
from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion
from tests.cases import each_case
from tests.site.streams.broker import broker, listening
from tests.site.streams.test_streams import EVENT, FELL, SOURCE, WATCH, slot

from e3pose.base.errors import InputError
from e3pose.site.streams import open_stream
from e3pose.site.streams.homeassistant import BIRTH, HomeAssistantStream
from e3pose.site.streams.mqtt import MAX_WAITING, MqttStream, login
from e3pose.wire.keys.folder import init_keys

LOGIN = ("wall", "hunter2")


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority with the certificate of a server on this machine."""
    folder = tmp_path_factory.mktemp("broker") / "keys"
    init_keys(folder, "lab", [], datetime.datetime.now(datetime.timezone.utc))
    return folder


def server_side(keys: Path) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(keys / "edge.pem", keys / "edge.key")
    return context


def test_password_and_certificate_let_in(keys: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SSL_CERT_FILE", str(keys / "authority.pem"))
    monkeypatch.setenv("E3POSE_MQTT_USER", LOGIN[0])
    monkeypatch.setenv("E3POSE_MQTT_PASSWORD", LOGIN[1])
    with (
        broker(LOGIN, server_side(keys)) as port,
        listening(port, LOGIN, keys / "authority.pem") as (_, heard),
    ):
        stream = open_stream(f"mqtts://localhost:{port}", SOURCE)
        stream.slot(slot(7))
        stream.zone(EVENT)
        topics = {heard.get(timeout=20)[0] for _ in range(3)}
        stream.close()
    assert "e3pose/lab/poses" in topics and "e3pose/lab/zone/door" in topics


@each_case("kind", [MqttStream, HomeAssistantStream])
def test_a_fall_has_room_while_no_broker_is(
    kind: type[MqttStream | HomeAssistantStream],
) -> None:
    client = mqtt.Client(CallbackAPIVersion.VERSION2)
    client.max_queued_messages_set(MAX_WAITING)
    source = replace(SOURCE, zones=("door",), kinds=("fall",), cameras=("c0",))
    stream = kind(client, source)
    for count in range(3 * MAX_WAITING):
        stream.zone(replace(EVENT, count=count))
        stream.people(replace(WATCH, time_ns=WATCH.time_ns + count * 10**10), [])
    stream.people(WATCH, [FELL])
    wait = [str(message.topic) for message in client._out_messages.values()]
    assert any("fall" in topic for topic in wait) and len(wait) <= 5, wait
    assert stream.problem.endswith("is away")
    for _ in range(MAX_WAITING + 7):
        stream.people(WATCH, [FELL])
    assert re.search(r"is away: \d+ events lost$", stream.problem)


@each_case("kind", [MqttStream, HomeAssistantStream])
def test_a_broker_that_comes_back_is_told_all(
    kind: type[MqttStream | HomeAssistantStream],
) -> None:
    client = MagicMock()
    client.is_connected.return_value = False
    stream = kind(client, replace(SOURCE, zones=("door",)))
    stream.zone(replace(EVENT, count=7))
    stream.people(WATCH, [])
    client.reset_mock()
    client.is_connected.return_value = True
    client.on_connect(client, None, None, None, None)
    said = {call.args[0]: call.args[1] for call in client.publish.call_args_list}
    if kind is MqttStream:
        assert said == {"e3pose/lab/zone/door/count": "7"}
    else:
        assert said["e3pose/lab/home/online"] == "online", "the broker's will said offline"
        assert json.loads(said["e3pose/lab/home/state"])["zones"] == [7]
        client.subscribe.assert_called_once_with(BIRTH, qos=1)


def test_wrong_password_is_reported_and_not_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("E3POSE_MQTT_USER", LOGIN[0])
    monkeypatch.setenv("E3POSE_MQTT_PASSWORD", "a guess")
    with broker(LOGIN) as port, pytest.raises(InputError) as refused:
        open_stream(f"mqtt://127.0.0.1:{port}", SOURCE)
    assert "Not authorized" in str(refused.value) and "E3POSE_MQTT_USER" in str(refused.value)
    assert "guess" not in str(refused.value)


# paho does not close the socket of a handshake that failed.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_another_s_certificate_is_refused(keys: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SSL_CERT_FILE", raising=False)
    with (
        broker(None, server_side(keys)) as port,
        pytest.raises(InputError, match="certificate verify failed"),
    ):
        open_stream(f"mqtts://localhost:{port}", SOURCE)


def test_password_does_not_cross_a_network_unencrypted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("E3POSE_MQTT_USER", "wall")
    with pytest.raises(InputError, match="unencrypted, expected mqtts://"):
        open_stream("mqtt://broker.invalid", SOURCE)
    with pytest.raises(InputError, match="expected them in E3POSE_MQTT_USER") as refused:
        open_stream("mqtts://wall:hunter2@broker.invalid", SOURCE)
    assert "hunter2" not in str(refused.value)


def test_password_may_be_in_a_file(tmp_path: Path) -> None:
    (tmp_path / "password").write_text("hunter2\n")
    (tmp_path / "password").chmod(0o640)
    file = {"E3POSE_MQTT_PASSWORD_FILE": str(tmp_path / "password")}
    with pytest.raises(InputError, match="which others can read"):
        login(file)
    (tmp_path / "password").chmod(0o600)
    assert login({"E3POSE_MQTT_USER": "wall", **file}) == LOGIN
    assert login({"E3POSE_MQTT_USER": "wall"}) == ("wall", None)
    assert login({}) == (None, None)
    with pytest.raises(InputError, match=r"PASSWORD_FILE: found .*nowhere"):
        login({"E3POSE_MQTT_PASSWORD_FILE": "nowhere"})
