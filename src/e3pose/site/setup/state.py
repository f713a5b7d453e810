"""State of the set-up page: the site, its steps with commands, and the jobs."""

from __future__ import annotations

from typing import Any

from e3pose.base.quantities import plural, shell
from e3pose.site.setup.cameras import shown_source, simulate_command
from e3pose.site.setup.going_live import LiveSite
from e3pose.site.setup.judging import check_command
from e3pose.site.setup.networks import init_command
from e3pose.site.setup.plan import Plan
from e3pose.site.setup.session import SetupSession
from e3pose.site.setup.solving import solve_command
from e3pose.site.setup.walking import record_command


def state_of(setup: SetupSession, live: LiveSite) -> dict[str, Any]:
    """Return all that the page shows but pictures, lists of networks, and settings."""
    task = setup.tasks.newest
    body: dict[str, Any] = {
        "root": str(setup.root),
        "sites": setup.sites(),
        "site": setup.name,
        "task": None if task is None else task.body(),
        "live": live.body(),
    }
    if not setup.name:
        return body
    plan = setup.plan()
    results = setup.results()
    return {
        **body,
        "made": setup.has_site,
        "cameras": [
            {
                "id": c.id, "source": shown_source(setup, c.source), "rotation": c.rotation,
                "width": c.width, "height": c.height, "fps": c.fps, "announced": c.announced,
            }
            for c in plan.cameras
        ],
        "detector": plan.detector,
        "height_cm": plan.height_cm,
        "walk": results.get("walk"),
        "second": results.get("second"),
        "solve": results.get("solve"),
        "check": results.get("check"),
        "commands": {"simulate": simulate_command(setup)},
        "steps": _steps(setup, plan, results, live),
    }  # fmt: skip


def _steps(
    setup: SetupSession, plan: Plan, results: dict[str, Any], live: LiveSite
) -> list[dict[str, Any]]:
    """Return the steps: whether each is done, whether it can begin, its command, and words."""
    written = setup.has_site and [c.was for c in plan.cameras] == [c.id for c in plan.cameras]
    placed = written and setup.placed()
    walked = bool(plan.walk) or placed
    checked = results.get("check") is not None
    few = len(plan.cameras) < 2
    rows = (
        ("cameras", "Cameras", not few, True, init_command(setup, plan.detector),
         plural(len(plan.cameras), "camera") if plan.cameras else "none yet"),
        ("network", "Network", written, not few, init_command(setup, plan.detector),
         plan.detector if written else "changes are not written yet" if setup.has_site else ""),
        ("walk", "Walk", walked, written, record_command(setup, "walk"),
         "recorded" if plan.walk else "calibrated already" if placed else ""),
        ("solve", "Solve", placed, bool(plan.walk) or placed, solve_command(setup, plan.height_cm),
         "cameras placed" if placed else ""),
        ("check", "Check", checked, placed, f"{record_command(setup, 'second')}\n"
         f"{check_command(setup)}", "" if not checked else results["check"]["grade"]),
        ("live", "Go live", live.body()["live"], placed, f"e3pose up {shell(setup.name)} --view",
         live.state if live.on else ""),
        ("change", "Change", False, setup.has_site, f"e3pose check {shell(setup.name)}", ""),
    )  # fmt: skip
    return [
        {"id": key, "title": title, "done": done, "open": opened, "command": command, "words": says}
        for key, title, done, opened, command, says in rows
    ]
