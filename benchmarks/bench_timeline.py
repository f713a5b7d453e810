"""Frame rate against network and server delay, for the designs of the paper's timeline figure.

python benchmarks/bench_timeline.py --plot timeline.svg
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from e3pose.evaluate.drawing import check_svg
from e3pose.reproduce.timeline import FPS, central_2d, distributed, ours
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--round-trips-ms", type=float, nargs="+", default=[0, 20, 50, 100, 200])
    parser.add_argument("--servers-ms", type=float, nargs="+", default=[5])
    parser.add_argument("--plot", type=Path, help="draw the rates, an .svg file")
    options = parser.parse_args()
    if options.plot is not None:
        check_svg("--plot", options.plot)
    scene = SceneSettings("ring", people=2, seconds=4.0, fps=FPS, cameras=3)
    recording = simulate(scene, seed=1)
    rows = []
    print("frames a second, of at most 25")
    print("round trip  server  ours  central 2D  distributed")
    for server_ms in options.servers_ms:
        for trip_ms in options.round_trips_ms:
            trip_s, server_s = trip_ms / 1e3, server_ms / 1e3
            rates = (
                ours(recording, trip_s, server_s, options.seconds),
                central_2d(trip_s, server_s, options.seconds),
                distributed(options.seconds),
            )
            rows.append((trip_ms, server_ms, *rates))
            print(
                f"{trip_ms:7.0f} ms {server_ms:4.0f} ms {rates[0]:5.1f} {rates[1]:11.1f} "
                f"{rates[2]:12.1f}",
                flush=True,
            )
    if options.plot is not None:
        draw(rows, options.plot)


def draw(rows: Sequence[tuple[float, ...]], path: Path) -> None:
    """Draw the rates against the round trip, dashed where the server takes longest."""
    from e3pose.evaluate.drawing import COLOURS, MARKERS, legend_above, picture

    servers = sorted({row[1] for row in rows})
    with picture(path, 5.5, 3.2) as figure:
        axes = figure.subplots()
        for number, name in enumerate(("e3pose", "central control, 2D boxes", "distributed")):
            for server_ms in {servers[0], servers[-1]}:
                slow = server_ms > servers[0]
                points = [(row[0], row[2 + number]) for row in rows if row[1] == server_ms]
                axes.plot(
                    *zip(*points, strict=True),
                    color=COLOURS[number],
                    marker=MARKERS[number],
                    markersize=9 - 3 * number,  # two of them lie on each other
                    linestyle="--" if slow else "-",
                    label=None if slow else name,
                )
        axes.set(xlabel="round trip, ms", ylabel="frames a second", ylim=(0, FPS * 1.1))
        legend_above(figure)


if __name__ == "__main__":
    main()
