"""A site whose kernels are not compiled yet: it says so, and gives no order before they are."""

from __future__ import annotations

import json
import os
import subprocess
import time
import urllib.request
from pathlib import Path

import pytest
from tests.live.processes import COMPILE_S, e3pose
from tests.live.test_programs import write_site
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.settings.site_file import load_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.web.tokens import open_tokens
from e3pose.wire import topics
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import Status

pytestmark = pytest.mark.nightly


def test_first_start_says_compiling_and_orders_afterwards(tmp_path: Path, recording: Path) -> None:
    path = write_site(tmp_path, recording)
    port = free_port()
    # The published pipeline has the fewest kernels.
    settings = path.read_text().replace("[loop]", '[loop]\npipeline = "paper"')
    path.write_text(f'{settings}\n[view]\nlisten = "127.0.0.1:{port}"\n')
    site = load_site(path)
    statuses: list[tuple[float, Status]] = []
    orders_s: list[float] = []
    shown: list[object] = []
    transport = open_network(viewer_link(site, None))
    follower = Follower(site.name)
    follower.listen(transport, None, lambda status: statuses.append((time.monotonic(), status)))
    for camera_id in ("cam0", "cam1", "cam2"):
        transport.subscribe(
            topics.of_order(site.name, camera_id),
            lambda topic, payload: orders_s.append(time.monotonic()),
        )

    def page_knows() -> bool:
        """Return whether slots are computed; meanwhile, keep what the page gets."""
        try:
            token = open_tokens(site.view.tokens).read
            asked = urllib.request.Request(
                f"http://127.0.0.1:{port}/api/status", headers={"Authorization": f"Bearer {token}"}
            )
            with urllib.request.urlopen(asked, timeout=5) as answer:
                shown.append(json.load(answer).get("compiling_s"))
        except OSError:
            shown.append(None)
        return follower.status is not None and follower.status.slot > 10

    with (tmp_path / "up.log").open("wb") as log:
        program = subprocess.Popen(
            e3pose("up", str(path), "--view"),
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "compiled")},
        )
    try:
        assert eventually(page_knows, COMPILE_S), (tmp_path / "logs" / "edge.log").read_text()
    finally:
        program.terminate()
        program.wait()
        transport.close()
    compiling_s = [at_s for at_s, status in statuses if status.compiling_s is not None]
    assert compiling_s and orders_s
    assert min(orders_s) > max(compiling_s)  # cameras were connected long before
    connected = [s.cameras for _, s in statuses if s.compiling_s is not None][-1]
    assert all(camera.last_seen_s is not None for camera in connected)
    assert any(isinstance(value, float) for value in shown)
    assert "compiling: " in (tmp_path / "up.log").read_text()
    assert statuses[-1][1].compiling_s is None
