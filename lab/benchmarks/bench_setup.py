"""How long a new user's way takes: from the first click in `e3pose setup` to live 3D, four films.

    python lab/benchmarks/bench_setup.py

It gives the orders that the page's buttons give, one after the other, with the simulated films of
*Try it without cameras*, and walks as long as the page asks for. *Attention* is the time in which a
person walks; the rest they may spend elsewhere. Reading and deciding come on top.
"""

from __future__ import annotations

import os
import re
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx

from e3pose.site.example import free_port
from e3pose.site.setup.program import SetupServer, open_setup

LOOK_S = 0.2
SECOND_S = 15.0  # of the second walk
MOST_S = 900.0


def main() -> None:
    """Time the way, and print a line for each step."""
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        with open_setup(None, "127.0.0.1:0") as server:
            headers = {"Authorization": f"Bearer {server.rules.tokens.write}"}
            address = f"http://{server.address}"
            with httpx.Client(base_url=address, headers=headers, timeout=60) as client:
                rows = way(server, client)
    total = attention = 0.0
    print(f"{'step':<28}{'seconds':>9}{'attention':>11}")
    for words, seconds, walked in rows:
        total, attention = total + seconds, attention + (seconds if walked else 0.0)
        print(f"{words:<28}{seconds:>9.1f}{seconds if walked else 0.0:>11.1f}")
    print(f"{'all':<28}{total:>9.1f}{attention:>11.1f}")
    print(f"{os.cpu_count()} cores, load of the machine before: {load:.1f}")


def way(server: SetupServer, client: httpx.Client) -> list[tuple[str, float, bool]]:
    """Return each step: words, seconds, and whether a person walks meanwhile."""
    desk, rows = server.table.desk, list[tuple[str, float, bool]]()

    def ask(path: str, **body: object) -> Any:
        answer = client.post(f"/api/setup/{path}", json=body)
        answer.raise_for_status()
        return answer.json()

    def until(ready: Callable[[], bool]) -> None:
        end_s = time.monotonic() + MOST_S
        while not ready():
            job = desk.tasks.newest
            if time.monotonic() > end_s or (job is not None and job.problem):
                raise SystemExit(f"stuck: {job and (job.problem or job.stage)}")
            time.sleep(LOOK_S)

    def timed(words: str, walked: bool, do: Callable[[], object]) -> None:
        begin_s = time.monotonic()
        do()
        rows.append((words, time.monotonic() - begin_s, walked))

    def job(path: str, **body: object) -> None:
        ask(path, **body)
        until(lambda: not desk.tasks.busy)

    def walk(which: str, enough: Callable[[], bool]) -> None:
        ask(f"record/{which}")
        until(enough)
        job("stop")

    def told() -> dict[str, Any]:
        answer = client.get("/api/setup/covered")
        return dict(answer.json()) if answer.status_code == 200 else {}

    def live() -> None:
        ask("live", order="start")
        until(lambda: bool(server.table.live.body()["people"]))

    timed("name the site", False, lambda: ask("site", name="room", kind="new"))
    timed("make four films", False, lambda: job("simulate"))
    timed("network and site file", False, lambda: job("networks/drawn/use"))
    site_file = Path("room/site.toml")  # another site may run on this machine
    endpoint = f"127.0.0.1:{free_port()}"
    site_file.write_text(re.sub(r"127\.0\.0\.1:\d+", endpoint, site_file.read_text()))
    timed("walk until it is enough", True, lambda: walk("walk", lambda: bool(told().get("enough"))))
    timed("solve", False, lambda: job("solve", height_cm=171.0))
    timed("draw the people", False, lambda: client.get("/api/setup/overlays").raise_for_status())
    timed("second walk", True, lambda: walk("second", lambda: told().get("length", 0) > SECOND_S))
    timed("check", False, lambda: job("check"))
    timed("go live, until 3D people", False, live)
    return rows


if __name__ == "__main__":
    main()
