"""Smart plugs: what each kind says, and what is no meter."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from e3pose.base.errors import InputError
from e3pose.energy.meters import plug
from e3pose.energy.meters.base import MeterError
from e3pose.energy.meters.plug import open_plug

ANSWERS: dict[str, object] = {}


@pytest.fixture
def host() -> Iterator[str]:
    class Plug(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            found = ANSWERS.get(self.path)
            self.send_response(404 if found is None else 200)
            self.end_headers()
            self.wfile.write(found if isinstance(found, bytes) else json.dumps(found).encode())

        def log_message(self, format: str, *args: object) -> None: ...

    server = HTTPServer(("127.0.0.1", 0), Plug)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    ANSWERS.clear()
    yield f"127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


# As the makers document them: Shelly of the second and of the first generation, Tasmota.
GEN2 = {"id": 0, "output": True, "apower": 5.3, "voltage": 230.1, "aenergy": {"total": 12.5}}
GEN1 = {"power": 4.25, "is_valid": True, "total": 1234}
TASMOTA = {"StatusSNS": {"Time": "2026-11-29T12:00:00", "ENERGY": {"Total": 0.1, "Power": 6}}}


@pytest.mark.parametrize(
    ("kind", "path", "answer", "watts"),
    [
        ("shelly", "/rpc/Switch.GetStatus?id=0", GEN2, 5.3),
        ("shelly", "/meter/0", GEN1, 4.25),
        ("tasmota", "/cm?cmnd=Status%208", TASMOTA, 6.0),
    ],
)
def test_a_plug_says_watts(
    kind: str, path: str, answer: object, watts: float, host: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ANSWERS[path] = answer
    meter = open_plug(f"{kind}:{host}")
    reading = meter.read("active")
    assert reading.watts == watts and reading.measured and kind in reading.how
    ANSWERS.clear()
    assert meter.read("active").watts == watts, "it is asked twice a second at most"
    monkeypatch.setattr(plug, "FRESH_S", -1.0)
    with pytest.raises(MeterError, match=f"{kind} plug {host}: "):
        meter.read("active")


@pytest.mark.parametrize(
    "answer", [{}, {"apower": None}, {"apower": -4}, {"apower": 1e9}, [], b"<html>", b"", b"NaN"]
)
def test_what_is_no_meter_is_refused(answer: object, host: str) -> None:
    ANSWERS["/rpc/Switch.GetStatus?id=0"] = answer
    with pytest.raises(InputError, match="expected a plug with a meter"):
        open_plug(f"shelly:{host}")


@pytest.mark.parametrize("name", ["shelly", "shelly:", "um25c:1", "shelly:a/b", "tasmota:me@x"])
def test_other_names_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="expected shelly:HOST or tasmota:HOST"):
        open_plug(name)
