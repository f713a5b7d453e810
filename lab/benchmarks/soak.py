"""Does anything grow? A site of real processes for a while; memory and threads, printed.

python lab/benchmarks/soak.py --minutes 30
python lab/benchmarks/soak.py --minutes 30 --no-churn

Viewers, visitors of the page and a camera come and go meanwhile. Growth per hour is a line through
the second half of the time: a short run says what an hour would bring if it went on so.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections import Counter

import numpy as np

from churn import churn
from live_site import Sample, live_site, wait

GROWTH_MB = 10.0  # from the second fifth of the time to the last: more is a leak
VIEWERS, VISITORS = 3, 3  # that come and go at the same time


def medians(samples: list[Sample]) -> tuple[Sample, Sample]:
    """Return the middle of the second and of the last fifth of the samples."""
    fifth = max(1, len(samples) // 5)

    def middle(part: list[Sample]) -> Sample:
        at_s, *rest = np.median(_columns(part), axis=0).tolist()
        return Sample(at_s, *(int(value) for value in rest))

    return middle(samples[fifth : 2 * fifth] or samples[:1]), middle(samples[-fifth:])


def per_hour_mb(samples: list[Sample]) -> tuple[float, float, float]:
    """Return the growth of edge, all cameras and page by a line through the second half."""
    columns = _columns(samples[len(samples) // 2 :])
    if len(columns) < 3:
        return 0.0, 0.0, 0.0
    rss = columns[:, [1, 3, 5]]
    edge, cameras, page = (np.polyfit(columns[:, 0] / 3600, rss / 1e6, 1)[0]).tolist()
    return edge, cameras, page


def _columns(samples: list[Sample]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array([
        [s.at_s, s.edge_rss, s.edge_threads, s.camera_rss, s.camera_threads, s.page_rss,
         s.page_threads]
        for s in samples
    ])  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--cameras", type=int, default=5)
    parser.add_argument("--people", type=int, default=4)
    parser.add_argument("--every", type=float, default=5.0, help="seconds between samples")
    parser.add_argument("--growth", type=float, default=GROWTH_MB, help="megabytes that are a leak")
    parser.add_argument("--churn", action=argparse.BooleanOptionalAction, default=True)
    options = parser.parse_args()
    with contextlib.ExitStack() as stack:
        spare = int(options.churn)
        site = stack.enter_context(
            live_site(options.cameras, options.people, page=options.churn, spare=spare)
        )
        seen: Counter[str] = Counter()
        if options.churn:
            spare_id = f"cam{options.cameras - 1}"
            seen = stack.enter_context(churn(site, VIEWERS, VISITORS, spare_id))
        lost = 0
        while (sample := site.sample()).at_s < options.minutes * 60:
            status = site.follower.status
            assert status is not None
            lost = status.slots_lost
            came = "".join(f"  {count} {kind}" for kind, count in sorted(seen.items()))
            print(
                f"{sample.at_s:6.0f} s  slot {status.slot}  edge {sample.edge_rss / 1e6:.1f} MB "
                f"{sample.edge_threads} threads  cameras {sample.camera_rss / 1e6:.1f} MB "
                f"{sample.camera_threads} threads  page {sample.page_rss / 1e6:.1f} MB "
                f"{sample.page_threads} threads  {status.slots_lost} slots lost{came}",
                flush=True,
            )
            wait(options.every)
    running = options.cameras - spare
    early, late = medians(site.samples)
    growth = (late.edge_rss - early.edge_rss) / 1e6
    cameras = (late.camera_rss - early.camera_rss) / 1e6 / running
    page = (late.page_rss - early.page_rss) / 1e6
    edge_h, cameras_h, page_h = per_hour_mb(site.samples)
    came = ", ".join(f"{count} {kind}" for kind, count in sorted(seen.items())) or "nobody"
    print(
        f"came and went: {came}; "
        f"per hour, from the last {options.minutes / 2:g} min: edge {edge_h:+.1f} MB, page "
        f"{page_h:+.1f} MB, a camera {cameras_h / running:+.1f} MB"
    )
    print(
        f"in {late.at_s - early.at_s:.0f} s the edge grew by {growth:+.1f} MB and "
        f"{late.edge_threads - early.edge_threads:+d} threads, the page by {page:+.1f} MB, "
        f"a camera by {cameras:+.1f} MB, "
        f"all cameras by {late.camera_threads - early.camera_threads:+d} threads; "
        f"{lost} slots lost"
    )
    # Threads of the network library come and go with sessions.
    threads = not options.churn and late.edge_threads > early.edge_threads
    threads = threads or late.camera_threads > early.camera_threads
    if max(growth, cameras, page) > options.growth or threads:
        sys.exit("something grows")


if __name__ == "__main__":
    main()
