"""Programs that were started by another one end when that is killed in a way it cannot report."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
from tests.live.processes import COMPILE_S, LiveSite, e3pose
from tests.waiting import eventually

from e3pose.store import Store

GONE_S = 15.0  # two, with room for a busy machine


@contextmanager
def killed(command: list[str], log: Path, num_children: int) -> Iterator[list[psutil.Process]]:
    """Kill a program once the last of its children is ready; yield its children."""
    with log.open("wb") as output:
        program = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
        )
    children: list[psutil.Process] = []
    try:

        def started() -> bool:
            children[:] = psutil.Process(program.pid).children(recursive=True)
            return len(children) >= num_children

        assert eventually(started, COMPILE_S), log.read_text()
        yield children
    finally:
        program.kill()
        program.wait()
        for child in children:
            if child.is_running():
                child.kill()


def gone(children: list[psutil.Process]) -> bool:
    return not any(c.is_running() and c.status() != psutil.STATUS_ZOMBIE for c in children)


def test_killed_up_leaves_nobody_behind(tmp_path: Path) -> None:
    """What `e3pose demo` starts ends in the same way; `tests/cli/test_demonstrating.py` looks."""
    folder = tmp_path / "try"
    command = e3pose("up", str(folder), "--example", "--quiet")
    logs = [folder / "logs" / name for name in ("edge.log", "cam0.log", "cam3.log")]
    with killed(command, tmp_path / "up.log", 5) as children:
        state = folder / "state.npz"
        assert eventually(state.exists, COMPILE_S), logs[0].read_text()
        site = LiveSite(folder)
        assert eventually(lambda: len(site.stored("live.db")) >= 10), logs[0].read_text()
        psutil.Process(children[0].ppid()).send_signal(signal.SIGKILL)
        assert eventually(lambda: gone(children), GONE_S), children
    # Each ended as if it was asked to: with its summary, and complete files.
    assert "slots, 0 lost" in logs[0].read_text(), logs[0].read_text()
    for log in logs[1:]:
        assert "views sent" in log.read_text(), log.read_text()
    for log in logs:
        assert "Traceback" not in log.read_text(), log.read_text()
    assert [each.run.site for each in Store(folder / "live.db").runs()] == ["example"]
