"""A page whose program is killed while it makes a file: the next one says so, and makes it."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.ports import free_port
from tests.rigs import looking
from tests.site.tables import write_site
from tests.site.web.test_past import ZONE, at_ns, store_fall
from tests.waiting import eventually

from e3pose.recording.calibration import save_rig
from e3pose.site.web.tokens import open_tokens

pytestmark = pytest.mark.nightly


@contextmanager
def view(site_file: Path) -> Iterator[tuple[subprocess.Popen[bytes], httpx.Client]]:
    listen = f"127.0.0.1:{free_port()}"
    words = [sys.executable, "-m", "e3pose", "view", str(site_file), "--listen", listen]
    with ExitStack() as stack:
        program = subprocess.Popen(words, stdout=subprocess.DEVNULL)
        stack.callback(program.wait)
        stack.callback(program.terminate)
        client = stack.enter_context(httpx.Client(base_url=f"http://{listen}", timeout=30))

        def there() -> bool:
            try:
                return client.get("/").status_code == 200
            except httpx.TransportError:
                return False

        assert eventually(there, 60)
        token = open_tokens(site_file.parent / "view-tokens.toml").write
        client.headers["Authorization"] = f"Bearer {token}"
        yield program, client


def jobs(client: httpx.Client) -> list[dict[str, Any]]:
    return list(client.get("/api/jobs").json()["jobs"])


def test_files_being_made_are_cut_off_and_can_be_made_again(tmp_path: Path) -> None:
    port = free_port()
    site = write_site(
        tmp_path, f'[link]\nendpoint = "tcp/127.0.0.1:{port}"\n[store]\npath = "lab.db"\n{ZONE}'
    )
    save_rig(looking((4, 0), (0, 4), (-4, 0)), tmp_path / "rig.toml")
    store_fall(tmp_path / "lab.db")
    wish = {"form": "csv", "name": "fall", "start_ns": at_ns(250), "end_ns": at_ns(370)}
    with view(site.path) as (program, client):
        assert client.post("/api/control/jobs", json=wish).status_code == 200
        assert eventually(lambda: jobs(client)[0]["state"] == "working", 30)
        program.send_signal(signal.SIGKILL)
        program.wait()
    with view(site.path) as (_, client):
        (job,) = jobs(client)
        assert job["state"] == "failed" and "cut off" in job["doing"]
        assert client.post("/api/control/jobs", json=wish).status_code == 200
        assert eventually(lambda: jobs(client)[0]["state"] == "done", 60)
        assert jobs(client)[0]["files"][0]["name"] == "fall.csv"
    with view(site.path) as (_, client):
        assert [job["state"] for job in jobs(client)] == ["done", "failed"]
        made = client.get(f"/api/jobs/{jobs(client)[0]['number']}/fall.csv")
        assert made.text.startswith("frame,seconds,")
