"""The Foxglove stream is read by Foxglove's own client."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import pytest
from tests.node_packages import installed, node
from tests.ports import free_port
from tests.site.streams.test_streams import SOURCE, TIME_NS, slot

from e3pose.site.streams import open_stream

pytestmark = [pytest.mark.network, pytest.mark.nightly]  # npm fetches it

CLIENT = ["@foxglove/ws-protocol@0.8.0", "ws@8"]
SCRIPT = """
const { FoxgloveClient } = require("@foxglove/ws-protocol"), { WebSocket } = require("ws");
const socket = new WebSocket(process.argv[2], ["foxglove.sdk.v1"]);
const client = new FoxgloveClient({ ws: socket });
client.on("advertise", (channels) => {
  const poses = channels.find(({ topic }) => topic === "/poses");
  if (poses) client.subscribe(poses.id);
});
client.on("message", ({ timestamp, data }) => {
  const message = JSON.parse(new TextDecoder().decode(data));
  console.log(JSON.stringify({ time_ns: String(timestamp), message }));
  process.exit(0);
});
client.on("error", (error) => { console.error(error); process.exit(1); });
"""


def test_foxglove_is_read_by_its_own_client(tmp_path: Path) -> None:
    packages = installed(tmp_path, CLIENT)
    port = free_port()
    stream = open_stream(f"foxglove://127.0.0.1:{port}", SOURCE)
    done = threading.Event()

    def send() -> None:  # until the client has subscribed
        while not done.wait(0.05):
            stream.slot(slot(7))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        found = json.loads(node(packages, SCRIPT, f"ws://127.0.0.1:{port}"))
    finally:
        done.set()
        thread.join()
        stream.close()
    assert int(found["time_ns"]) == TIME_NS
    assert found["message"]["people"][0]["track"] == 7
