"""Does a live site choose cameras as well as replay promises? A held-out camera judges.

    python lab/benchmarks/live_choice.py $E3POSE_SHARED/data/pizza/recording --hold-out 00_00

Each policy runs once as a site of real processes on loopback, whose cameras play the recording in
real time, and then as a replay with the lead that the site had. The camera held out gives nothing
to either. Every row states mm across the rays of that camera, how many of its people were missed,
and the share of slots of each camera.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import tomlkit

from e3pose.evaluate.held_out import judge, turns
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.slot_record import SlotRecord
from e3pose.recording import Recording, load_recording
from e3pose.site.example import STORE_FILE, write_recorded
from live_run import run_live, stored_records

READY_S = 6.0  # a camera starts


def live(recording: Recording, policy: str, cameras: float) -> tuple[list[SlotRecord], int]:
    """Run a site on one round of the recording; return its stored records and its lead."""
    with tempfile.TemporaryDirectory(prefix="e3pose-live-") as name:
        site_file = write_recorded(Path(name) / "site", recording)
        settings = tomlkit.parse(site_file.read_text())
        settings.setdefault("loop", {}).update(policy=policy, cameras=cameras)
        site_file.write_text(tomlkit.dumps(settings))
        length_s = recording.num_slots * recording.interval_s
        num = recording.num_slots
        heard = run_live(site_file, num, length_s, READY_S)
        store = site_file.parent / STORE_FILE
        records, moments_s = stored_records(store, recording.interval_s, heard, num)
    # The slots of the site are those of the recording, at what the cameras showed in them.
    shown = np.round(moments_s * recording.fps).astype(int).tolist()
    lead = 0 if heard.status is None else heard.status.lead
    return [replace(r, slot=s) for r, s in zip(records, shown, strict=True)], lead


def row(name: str, records: Sequence[SlotRecord], judges: Recording) -> str:
    """Return a line of the table."""
    found = judge(judges, records)
    mean = found.mean
    duty = np.mean([record.selected for record in records], axis=0)
    return (
        f"| {name} | {mean.mean_mm:.1f} | {mean.median_mm:.1f} | {mean.missed_percent:.1f} "
        f"| {duty.sum():.2f} | {', '.join(f'{share:.0%}' for share in duty)} | {len(records)} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("--hold-out", required=True)
    parser.add_argument("--policies", default="round-robin,information")
    parser.add_argument("--cameras", type=float, default=1.0)
    options = parser.parse_args()
    recording, judges = turns(load_recording(options.recording), [options.hold_out])[0]
    assert judges is not None
    print("| | mean, mm | median, mm | missed % | cameras | duty of each | slots |")
    print("|---|---|---|---|---|---|---|")
    for policy in options.policies.split(","):
        records, lead = live(recording, policy, options.cameras)
        print(row(f"{policy}, live, lead {lead}", records, judges), flush=True)
        settings = ReplaySettings(num_selected=options.cameras, lead_slots=max(lead, 1))
        replayed = list(replay(recording, settings, policy=policy))
        print(row(f"{policy}, replayed, lead {lead}", replayed, judges), flush=True)


if __name__ == "__main__":
    main()
