"""Is active time what was ordered, is an exact meter learned, and do budgets keep what they say?

    python lab/benchmarks/active_time.py                   # all rows, three sites at a time
    python lab/benchmarks/active_time.py --rows "turns 25 1/4,random"  # whose names begin so

Each row is a site of real processes over mutual TLS: cameras that replay simulated detections, with
a meter that knows of every look: it counts 3 W, and for each run of the network what makes a slot
with a look one of 8 W, spread over `--look` of the slot. The meter asks the network's wrapper, not
the camera, when it ran. After two minutes, for each camera:

* ordered: slots that the edge ordered, as a share;
* looks: share of slots in which its network ran;
* active: slots that the camera reports as active, by looks. It must be within 2 % of 1;
* watts: learned of the first two minutes' heartbeats. They must be within 3 % of 8 and 3;
* pays: share of slots that the edge says a budget of 4.5 W pays for, which is 0.300;
* kept: share of slots in the last minute that the edge selected a camera with such a budget, or
  one of 0.30 (`30%`). It must be within 0.01 of 0.30; only in rows of a third minute.

A row is `POLICY SLOTS_PER_SECOND COUNT/CAMERAS`, and what else is on: `rests` (asleep by plan),
`gate`, `closed` (sources are closed between looks), `video` (recorded). Pictures for the last ones
are grey, and change for one second in three. The exit status is 1 where something is out of bounds.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, cast
from unittest.mock import patch

import numpy as np

from e3pose.camera.base import LiveFrame, LiveSource
from e3pose.camera.live_source import RecordedSource, make_source
from e3pose.cli.app import main as e3pose
from e3pose.energy.activity import ModeClock
from e3pose.energy.meters.base import Reading
from e3pose.energy.meters.sampler import PowerSampler
from e3pose.energy.profiles import load_profile
from e3pose.energy.site_energy import new_camera, observe, slot_cost
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, Skeleton
from e3pose.site import camera_program
from e3pose.site.up import Program
from e3pose.wire.messages import Heartbeat
from live_site import live_site

ACTIVE_W, IDLE_W = 8.0, 3.0
LEARN_S, KEEP_S = 122.0, 62.0  # budgets are made anew each minute
CAMERA = "camera"  # first word of the command that runs one
HEIGHT, WIDTH = 180, 320


# A camera: `e3pose camera` with another meter.


@dataclass
class Network:
    """A network that takes a part of a slot, and notes when it runs."""

    look_s: float
    begun_ns: list[int] = field(default_factory=list)
    skeleton: Skeleton = COCO17

    def detect(self, image: object, found: Poses2D | None = None) -> Poses2D:
        self.begun_ns.append(time.monotonic_ns())
        time.sleep(self.look_s)
        return Poses2D.empty(17) if found is None else found


@dataclass
class ExactMeter:
    """Counts `IDLE_W`, and for each look what makes its slot one of `ACTIVE_W`, within `look_s`."""

    networks: list[Network]
    slot_s: float
    look_s: float
    begun_ns: int = field(default_factory=time.monotonic_ns)
    counted_j: float = 0.0

    def read(self, mode: object) -> Reading:
        now_ns = time.monotonic_ns()
        begun_ns = [at_ns for network in self.networks for at_ns in network.begun_ns]
        newest_s = (now_ns - np.array(begun_ns[-9:])) / 1e9
        looks = len(begun_ns) - float(np.clip(1 - newest_s / self.look_s, 0, 1).sum())
        total_j = IDLE_W * (now_ns - self.begun_ns) / 1e9
        total_j += (ACTIVE_W - IDLE_W) * self.slot_s * looks
        spent_j, self.counted_j = total_j - self.counted_j, total_j
        return Reading(0.0, spent_j, True, "measured: every look")


class Sampler(PowerSampler):
    """Writes down what each heartbeat says, and how often the network had run."""

    log: Path
    networks: list[Network]

    def __call__(self, _mode: object = None) -> dict[str, Any]:
        fields = super().__call__()
        looks = sum(len(network.begun_ns) for network in self.networks)
        line = {"at_s": time.monotonic(), "looks": looks, **fields}
        with self.log.open("a") as file:
            file.write(json.dumps(line) + "\n")
        return fields


class Looked(RecordedSource):
    """A recording whose keypoints a network takes its time for."""

    network: Network

    def read(self) -> LiveFrame | None:
        frame = super().read()
        if frame is None or frame.poses is None:
            return frame
        return replace(frame, poses=partial(self._found, frame.poses))

    def _found(self, poses: Callable[[], Poses2D]) -> Poses2D:
        return self.network.detect(None, poses())


@dataclass
class Pictures:
    """A source that shows pictures, which stay the same for two seconds of three."""

    inner: LiveSource

    @property
    def fps(self) -> float:
        return self.inner.fps

    def open(self) -> None:
        self.inner.open()

    def read(self) -> LiveFrame | None:
        frame = self.inner.read()
        if frame is None:
            return None
        image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
        if frame.captured_ns // 10**9 % 3 == 0:
            image[:, : WIDTH // 4] = frame.captured_ns // 10**7 % 256
        return LiveFrame(frame.captured_ns, frame.image_size, lambda: image)

    def close(self) -> None:
        self.inner.close()


def run_camera(log: str, slot_s: str, look: str, pictures: str, *words: str) -> None:
    """Run `e3pose camera` with an exact meter and, if `pictures` is `yes`, with pictures."""
    networks: list[Network] = []
    look_s = float(look) * float(slot_s)

    def network(*_: object) -> Network:
        networks.append(Network(look_s))
        return networks[-1]

    def sampler(_profile: object, modes: ModeClock, *_: object) -> PowerSampler:
        meter = ExactMeter(networks, float(slot_s), look_s)
        made = Sampler(meter, modes)
        made.log, made.networks = Path(log), networks
        return made

    def source(*arguments: Any) -> LiveSource:
        made = make_source(*arguments)
        if pictures == "yes" or not isinstance(made, RecordedSource):
            return Pictures(made)
        made.__class__ = Looked
        cast(Looked, made).network = network()
        return made

    with (
        patch.object(camera_program, "load_detector", network),
        patch.object(camera_program, "open_sampler", sampler),
        patch.object(camera_program, "make_source", source),
    ):
        e3pose(words)


def exact_command(
    command: list[str], log: Path, slot_s: float, look: float, pictures: bool = False
) -> list[str]:
    """Return the command of a camera with an exact meter, from the usual one."""
    at = command.index("e3pose") + 1
    options = [str(log), f"{slot_s}", f"{look}", "yes" if pictures else "no"]
    return [command[0], __file__, CAMERA, *options, *command[at:]]


# Sites.


@dataclass(frozen=True)
class Row:
    """A site: who looks, how many slots a second, and what else is on."""

    policy: str
    fps: float
    count: int
    cameras: int
    more: str = ""  # rests, gate, closed, video
    budgets: tuple[str, ...] = ("4.5W",)  # of the first cameras; others spend what they like

    @property
    def name(self) -> str:
        words = f"{self.policy} {self.fps:g} {self.count}/{self.cameras}"
        budgets = "" if len(self.budgets) == 1 else " and ".join(dict.fromkeys(self.budgets))
        return " ".join(word for word in (words, self.more, budgets) if word)

    @property
    def keeps(self) -> bool:
        return len(self.budgets) > 1


POLICIES = {"turns": "round-robin", "random": "random", "information": "information"}
ROWS = [
    *(
        Row(policy, fps, count, cameras)
        for policy in ("turns", "random")
        for fps in (25.0, 30.0)
        for count, cameras in ((1, 4), (2, 4), (2, 5))
    ),
    *(Row("turns", 25.0, 2, 4, more) for more in ("gate", "closed", "video")),
    Row("information", 25.0, 2, 4, "rests"),
    Row("information", 25.0, 2, 4, budgets=("4.5W", "30%")),
    Row("turns", 25.0, 2, 4, budgets=("4.5W",) * 4),
    Row("turns", 30.0, 2, 5, budgets=("30%",) * 5),
]


@dataclass
class Found:
    """Of one camera."""

    camera_id: str
    ordered: float
    looks: float
    active: float
    watts: tuple[float, float]
    measured: bool
    pays: float | None
    kept: float | None

    def wrong(self) -> str:
        """Return the names of the figures that are out of bounds."""
        active_w, idle_w = self.watts
        off_share = max(abs(active_w / ACTIVE_W - 1), abs(idle_w / IDLE_W - 1))
        found = {
            "active": abs(self.active - 1) > 0.02,
            "watts": off_share > 0.03 or not self.measured,
            "pays": self.pays is not None and abs(self.pays - 0.3) > 0.01,
            "kept": self.kept is not None and abs(self.kept - 0.3) > 0.01,
        }
        return " ".join(name for name, bad in found.items() if bad)


def beats_of(log: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.read_text().splitlines() if line.endswith("}")]


def learned(beats: list[dict[str, Any]], slot_s: float) -> tuple[tuple[float, float], bool]:
    """Return the watts that the edge learns of heartbeats, and whether it calls them measured."""
    camera = new_camera(load_profile("generic"))
    for beat in beats:
        said = {name: beat[name] for name in ("mode", "energy_j", "measured", "active_s", "idle_s")}
        at_ns, asleep_s = round(beat["at_s"] * 1e9), beat["asleep_s"]
        heartbeat = Heartbeat("c", 1, at_ns, **said, asleep_s=asleep_s)
        camera = observe(camera, heartbeat)
    active_w, idle_w = camera.cost.watts.tolist()
    return (active_w, idle_w), slot_cost(camera.cost, slot_s).measured


def run(row: Row, look: float, learn_s: float) -> list[Found]:
    """Run a site while it learns, and a minute more where budgets are to be kept."""
    slot_s, pictures = 1 / row.fps, row.more in ("gate", "video")

    def more(index: int) -> str:
        lines = [f'budget = "{row.budgets[index]}"'] if index < len(row.budgets) else []
        lines += {"gate": ["gate = true"], "video": ['record = "video"']}.get(row.more, [])
        return "\n".join(lines)

    logs: dict[str, Path] = {}

    def change(program: Program) -> None:
        if program.name == "edge":
            return
        logs[program.name] = program.log.with_suffix(".jsonl")
        command = list(program.command)
        program.command = exact_command(command, logs[program.name], slot_s, look, pictures)

    loop = f'policy = "{POLICIES[row.policy]}"\npredictor = "zero-velocity"\n'
    loop += 'rest = "asleep"\nwatts = "24W"' if row.more == "rests" else f"cameras = {row.count}"
    with live_site(
        row.cameras, 1, row.fps, loop=loop, store=False, asleep=row.more == "closed", more=more,
        change=change,
    ) as site:  # fmt: skip
        begun_s = time.monotonic()

        def told() -> tuple[int, list[int]]:
            status = site.follower.status
            assert status is not None
            return status.slot, [camera.ordered for camera in status.cameras]

        begin = told(), {name: beats_of(log)[-1] for name, log in logs.items()}
        time.sleep(max(begun_s + learn_s + KEEP_S * row.keeps - time.monotonic(), 0.0))
        end = told(), {name: beats_of(log) for name, log in logs.items()}
        status = site.follower.status
        assert status is not None
    slots, found = end[0][0] - begin[0][0], []
    for index, camera in enumerate(status.cameras):
        name = camera.camera_id
        first, beats = begin[1][name], end[1][name]
        looks = beats[-1]["looks"] - first["looks"]
        active = (beats[-1]["active_s"] - first["active_s"]) / slot_s
        early = [beat for beat in beats if beat["at_s"] < first["at_s"] + learn_s]
        bounded = index < len(row.budgets)
        pays = camera.budget if bounded and not row.budgets[index].endswith("%") else None
        found.append(
            Found(
                name, (end[0][1][index] - begin[0][1][index]) / slots, looks / slots,
                active / max(looks, 1), *learned(early, slot_s), pays,
                camera.duty if bounded and row.keeps else None,
            )
        )  # fmt: skip
    return found


def shown(row: Row, found: list[Found]) -> str:
    """Return the lines of a row, the least and the most of its cameras."""

    def span(value: Callable[[Found], float | None], digits: int = 3) -> str:
        values = [v for each in found if (v := value(each)) is not None]
        if not values:
            return ""
        ends = dict.fromkeys(f"{v:.{digits}f}" for v in (min(values), max(values)))
        return " to ".join(ends)

    wrong = {f"{each.camera_id}: {each.wrong()}" for each in found if each.wrong()}
    cells = (
        row.name, span(lambda f: f.ordered), span(lambda f: f.looks), span(lambda f: f.active),
        span(lambda f: f.watts[0], 2), span(lambda f: f.watts[1], 2), span(lambda f: f.pays),
        span(lambda f: f.kept), "; ".join(sorted(wrong)) or "yes",
    )  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", default="", help="beginnings of the names of rows to run")
    parser.add_argument("--look", type=float, default=0.6, help="of a slot, that a look takes")
    parser.add_argument("--together", type=int, default=3, help="sites at a time")
    parser.add_argument("--seconds", type=float, default=LEARN_S, help="in which it learns")
    options = parser.parse_args()
    rows = [row for row in ROWS if row.name.startswith(tuple(options.rows.split(",")))]
    if not rows:
        parser.error(f"--rows {options.rows!r}: none of {', '.join(row.name for row in ROWS)}")
    print("| site | ordered | looks | active | active W | idle W | pays | kept | within bounds |")
    print("|---|---|---|---|---|---|---|---|---|", flush=True)

    def tell(row: Row) -> bool:
        try:
            found = run(row, options.look, options.seconds)
        except SystemExit as error:  # a program of the site ended
            print(f"{row.name}: {error}", flush=True)
            return False
        print(shown(row, found), flush=True)
        return not any(each.wrong() for each in found)

    with ThreadPoolExecutor(options.together) as pool:
        sys.exit(not all(list(pool.map(tell, rows))))


if __name__ == "__main__":
    if sys.argv[1:2] == [CAMERA]:
        run_camera(*sys.argv[2:])
    else:
        main()
