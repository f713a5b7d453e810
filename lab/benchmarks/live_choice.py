"""What choosing ahead is worth on a live site: real processes, a link that delays, truth known.

python lab/benchmarks/live_choice.py --scenes ring,one-sided --cameras 1,2 --round-trips 0,50,150

Every row is one run: an edge and a process per camera play a simulated scene once, in real time,
through a relay that adds the round trip. The edge finds its lead by itself. Beside the errors of
the published poses stand those of a replay at that lead.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tomli_w

from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.evaluate.summary import accuracy
from e3pose.recording import Recording
from e3pose.settings.resolved import resolve_site
from e3pose.settings.site_file import load_site
from e3pose.simulate import SCENES, SceneSettings, simulate
from e3pose.site.demo.live import Heard, last_words
from e3pose.site.demo.stored_run import Film, as_recording, stored_records
from e3pose.site.example import STORE_FILE, write_recorded
from e3pose.site.follow import Follower, viewer_link
from e3pose.site.up import Program, camera_command, edge_command, run_site
from e3pose.wire.endpoint import Endpoint
from e3pose.wire.network import open_network
from e3pose_lab.reproduce.relay import relay

START_S, READY_S, SILENT_S = 240.0, 10.0, 30.0
LEARN_SLOTS = 75  # at the start, in which the edge still finds its lead; not counted
LAST_S = 1.0  # of the scene, in which the site is being ended; not counted either
SEED = 77  # nothing was chosen on it


@dataclass
class Live:
    """One run of a site."""

    heard: Heard
    leads: list[int]
    figures: dict[str, Any]


def run(recording: Recording, policy: str, count: float, round_trip_s: float) -> Live:
    """Play a recording once through a live site and compare what it published with the truth."""
    with tempfile.TemporaryDirectory(prefix="e3pose-choice-") as name:
        path = write_recorded(Path(name) / "site", recording)
        table = msgspec.toml.decode(path.read_bytes())
        table["loop"] = {"policy": policy, "cameras": count}
        path.write_text(tomli_w.dumps(table))
        site = resolve_site(path)
        port = site.link.endpoint.port
        with relay(port, round_trip_s) as near:
            link = replace(site.link, endpoint=Endpoint("tcp", "127.0.0.1", near))
            through = replace(site, link=link)
            heard, leads = _play(path, through, recording)
        begin_ns = heard.begin_ns
        film = Film(recording.num_slots * recording.interval_s, 1.0, begin_ns)
        records, times, _ = stored_records(
            path.parent / STORE_FILE, recording.interval_s, film, 10 * recording.num_slots
        )
        first = next(i for i, t in enumerate(times) if t > begin_ns) + LEARN_SLOTS
        last_ns = begin_ns + round((film.length_s - LAST_S) * 1e9)
        stop = next((i for i, t in enumerate(times) if t > last_ns), len(times))
        records, times = records[first:stop], times[first:stop]
        moments = film.moments(heard, records, times)
        shown = as_recording(recording, heard, moments)
        return Live(heard, leads, _figures(shown, records))


def _figures(shown: Recording, records: list[Any]) -> dict[str, Any]:
    numbered = [replace(record, slot=slot) for slot, record in enumerate(records)]
    found = accuracy(shown, numbered)
    return {
        "error_mm": found.mpjpe_mm,
        "recall": found.recall_500mm,
        "cameras": float(np.mean([record.selected.sum() for record in records])),
    }


def _play(path: Path, through: Any, recording: Recording) -> tuple[Heard, list[int]]:
    logs = path.parent / "logs"
    logs.mkdir()
    programs = [Program("edge", edge_command(path), logs / "edge.log")]
    heard, follower, leads = Heard(), Follower(through.name), []
    link = viewer_link(load_site(path), None)
    transport = open_network(link)
    follower.listen(transport, heard.poses, lambda status: leads.append(status.lead))
    heard.listen(through.name, transport)
    newest_s = time.monotonic()
    newest = 0

    def stopped() -> bool:
        nonlocal newest, newest_s
        now_s, status = time.monotonic(), follower.status
        if status is not None and status.compiling_s is not None:
            newest_s = now_s
        elif status is not None and not heard.begin_ns:
            heard.begin_ns = time.time_ns() + round(READY_S * 1e9)
            for camera_id in recording.rig.camera_ids:
                command = camera_command(through, camera_id)
                command += ["--begin-s", str(heard.begin_ns / 1e9)]
                programs.append(Program(camera_id, command, logs / f"{camera_id}.log"))
                programs[-1].start()
        if heard.slots > newest:
            newest, newest_s = heard.slots, now_s
        if now_s - newest_s > (SILENT_S if newest else START_S):
            raise SystemExit(f"the site stands still: {last_words(programs)}")
        end_ns = heard.begin_ns + round((recording.num_slots - 1.5) * recording.interval_s * 1e9)
        return heard.begin_ns > 0 and heard.newest_ns >= end_ns

    try:
        run_site(programs, stopped, lambda line: None)
    finally:
        transport.close()
    return heard, leads


def replayed(recording: Recording, policy: str, count: float, lead: int) -> dict[str, Any]:
    """Return the same figures of a replay at a lead, of the same part of the scene."""
    settings = ReplaySettings(policy=policy, num_selected=count, lead_slots=lead)
    records = list(replay(recording, settings))
    last = recording.num_slots - round(LAST_S / recording.interval_s)
    scored = replace(recording, scored_slots=(LEARN_SLOTS, last))
    found = accuracy(scored, records)
    return {"error_mm": found.mpjpe_mm, "recall": found.recall_500mm}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", default="ring,one-sided")
    parser.add_argument("--cameras", default="1,2", help="a slot, several")
    parser.add_argument("--policies", default="round-robin,information")
    parser.add_argument("--round-trips", default="0,50,150", help="milliseconds")
    parser.add_argument("--seconds", type=float, default=40.0, help="of each scene")
    parser.add_argument("--fps", type=float, default=12.5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    print(
        "| scene | C | policy | round trip ms | lead, median | late views % | "
        "live mm | recall % | replay at that lead mm | recall % |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for scene in options.scenes.split(","):
        fps = None if SCENES[scene].fps <= options.fps else options.fps
        recording = simulate(SceneSettings(scene, seconds=options.seconds, fps=fps), SEED)
        for count in map(float, options.cameras.split(",")):
            for trip_ms in map(float, options.round_trips.split(",")):
                for policy in options.policies.split(","):
                    live = run(recording, policy, count, trip_ms / 1e3)
                    lead = int(np.median(live.leads[len(live.leads) // 4 :]))
                    offline = replayed(recording, policy, count, lead)
                    status = live.heard.status
                    late = sum(c.late for c in status.cameras) if status else 0
                    views = max(len(live.heard.views), 1)
                    print(
                        f"| {scene} | {count:g} | {policy} | {trip_ms:g} | {lead} | "
                        f"{100 * late / views:.1f} | {live.figures['error_mm']:.1f} | "
                        f"{100 * live.figures['recall']:.1f} | {offline['error_mm']:.1f} | "
                        f"{100 * offline['recall']:.1f} |",
                        flush=True,
                    )
                    rows.append(
                        {"scene": scene, "count": count, "policy": policy, "trip_ms": trip_ms,
                         "lead": lead, "live": live.figures, "replay": offline}
                    )  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
