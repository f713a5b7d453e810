"""Does anything grow? A site of real processes for a while; memory and threads, printed.

python benchmarks/soak.py --minutes 30
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from live_site import Sample, live_site, wait

GROWTH_MB = 10.0  # from the second fifth of the time to the last: more is a leak


def medians(samples: list[Sample]) -> tuple[Sample, Sample]:
    """Return the middle of the second and of the last fifth of the samples."""
    fifth = max(1, len(samples) // 5)

    def middle(part: list[Sample]) -> Sample:
        columns = np.array(
            [[s.at_s, s.edge_rss, s.edge_threads, s.camera_rss, s.camera_threads] for s in part]
        )
        at_s, *rest = np.median(columns, axis=0).tolist()
        return Sample(at_s, *(int(value) for value in rest))

    return middle(samples[fifth : 2 * fifth] or samples[:1]), middle(samples[-fifth:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--cameras", type=int, default=5)
    parser.add_argument("--people", type=int, default=4)
    parser.add_argument("--every", type=float, default=5.0, help="seconds between samples")
    parser.add_argument("--growth", type=float, default=GROWTH_MB, help="megabytes that are a leak")
    options = parser.parse_args()
    with live_site(options.cameras, options.people) as site:
        lost = 0
        while (sample := site.sample()).at_s < options.minutes * 60:
            status = site.follower.status
            assert status is not None
            lost = status.slots_lost
            print(
                f"{sample.at_s:6.0f} s  slot {status.slot}  edge {sample.edge_rss / 1e6:.1f} MB "
                f"{sample.edge_threads} threads  cameras {sample.camera_rss / 1e6:.1f} MB "
                f"{sample.camera_threads} threads  {status.slots_lost} slots lost",
                flush=True,
            )
            wait(options.every)
    early, late = medians(site.samples)
    growth = (late.edge_rss - early.edge_rss) / 1e6
    cameras = (late.camera_rss - early.camera_rss) / 1e6 / options.cameras
    print(
        f"in {late.at_s - early.at_s:.0f} s the edge grew by {growth:+.1f} MB and "
        f"{late.edge_threads - early.edge_threads:+d} threads, a camera by {cameras:+.1f} MB, "
        f"all cameras by {late.camera_threads - early.camera_threads:+d} threads; "
        f"{lost} slots lost"
    )
    threads = late.edge_threads > early.edge_threads or late.camera_threads > early.camera_threads
    if growth > options.growth or cameras > options.growth or threads:
        sys.exit("something grows")


if __name__ == "__main__":
    main()
