"""A set-up that is killed in the middle of its work and started again: it goes on in that step."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.ports import free_port
from tests.waiting import eventually

pytestmark = pytest.mark.nightly
WORK_S = 600.0


@dataclass
class Setup:
    """A program `e3pose setup` and a client of it."""

    program: subprocess.Popen[str]
    client: httpx.Client

    def get(self, path: str) -> Any:
        answer = self.client.get(f"/api/setup/{path}")
        assert answer.status_code == 200, answer.text
        return answer.json()

    def post(self, path: str, **body: object) -> Any:
        answer = self.client.post(f"/api/setup/{path}", json=body)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def task(self) -> dict[str, Any]:
        return dict(self.get("state")["task"])

    def done(self) -> None:
        """Wait for the work at hand, which must succeed."""
        assert eventually(lambda: self.task()["state"] != "running", WORK_S)
        assert self.task()["state"] == "done", self.task()

    def interrupted(self, kind: str) -> bool:
        """Return whether the newest work is of this kind and says that it was interrupted."""
        task = self.task()
        assert "interrupted" in task["problem"], task
        return (task["kind"], task["state"]) == (kind, "failed")

    def steps(self) -> dict[str, dict[str, Any]]:
        return {step["id"]: step for step in self.get("state")["steps"]}

    def recorded(self, seconds: float) -> bool:
        task = self.task()
        assert not task["problem"], task
        return float(task["shown"].get("seconds", 0)) >= seconds

    def kill(self) -> None:
        self.program.send_signal(signal.SIGKILL)
        self.program.wait()


@contextmanager
def setup(folder: Path) -> Iterator[Setup]:
    """Start `e3pose setup room` in a folder."""
    listen = f"127.0.0.1:{free_port()}"
    words = [sys.executable, "-m", "e3pose", "setup", "room", "--no-browser", "--listen", listen]
    with ExitStack() as stack:
        program = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True)
        stack.callback(program.wait)
        stack.callback(program.terminate)
        assert program.stdout is not None
        stack.enter_context(program.stdout)
        token = re.search(r"#token=(\S+)", program.stdout.readline())
        assert token is not None
        headers = {"Authorization": f"Bearer {token[1]}"}
        client = httpx.Client(base_url=f"http://{listen}", headers=headers, timeout=60)
        yield Setup(program, stack.enter_context(client))


@pytest.mark.timeout(1800)
def test_work_that_is_killed_is_said_and_done_again_with_its_pictures(tmp_path: Path) -> None:
    with setup(tmp_path) as first:
        first.post("simulate")
        first.done()
        first.post("networks/drawn/use")
        first.done()
        site_file = tmp_path / "room" / "site.toml"
        endpoint = f"127.0.0.1:{free_port()}"
        site_file.write_text(re.sub(r"127\.0\.0\.1:\d+", endpoint, site_file.read_text()))
        first.post("record/walk")
        assert eventually(lambda: first.recorded(5), WORK_S)
        first.kill()

    with setup(tmp_path) as second:
        assert second.interrupted("walk")
        assert second.steps()["walk"]["open"] and not second.steps()["walk"]["done"]
        second.post("record/walk")
        assert eventually(lambda: second.recorded(30), WORK_S)
        second.post("stop")
        second.done()
        second.post("solve", height_cm=171)
        second.kill()

    with setup(tmp_path) as third:
        assert third.interrupted("solve")
        assert third.steps()["walk"]["done"] and not third.steps()["solve"]["done"]
        third.post("solve", height_cm=171)
        third.done()
        found = third.get("overlays")["cameras"]
        assert len(found) == 4
        for camera in found:
            assert camera["jpeg"] and camera["solved"], camera["id"]
        third.post("record/second")
        assert eventually(lambda: third.recorded(5), WORK_S)
        third.kill()

    with setup(tmp_path) as fourth:
        assert fourth.interrupted("second")
        assert fourth.steps()["solve"]["done"] and fourth.steps()["check"]["open"]
        assert all(camera["jpeg"] for camera in fourth.get("overlays")["cameras"])
