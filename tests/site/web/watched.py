"""A view of a site that a test plays the edge of: its store holds slots, its messages are ours."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import msgspec
import numpy as np
from tests.memory_transport import Hub, MemoryTransport
from tests.rigs import looking

from e3pose.base.rate_limit import Rate
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord
from e3pose.recording.calibration import save_rig
from e3pose.settings.resolved import resolve_site
from e3pose.site.web.program import View, open_view
from e3pose.store import EnergyReading, Event, Run, StoreWriter
from e3pose.wire.arrays import pack, unpack
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import CameraStatus, Poses, Status

RIG = looking((4, 0), (0, 4), (-4, 0))
STARTED_NS = 1_795_000_000_000_000_000
FPS, SLOTS = 25.0, 40
SITE = """format = "e3pose-site"
version = 1
name = "lab"
calibration = "rig.toml"
fps = 25
[store]
path = "lab.db"
"""


def record(slot: int) -> SlotRecord:
    """Tracks 10 and 11 at x = -1 and 1 m; y is the slot in centimetres; joint 3 is missing."""
    joints_m = np.zeros((2, 17, 3))
    joints_m[:, :, 0] = [[-1.0], [1.0]]
    joints_m[:, :, 1] = slot / 100
    joints_m[:, :, 2] = np.linspace(0, 1.7, 17)
    scores = np.ones((2, 17))
    scores[:, 3] = 0.0
    selected = np.array([True, slot % 2 == 0, False])
    return SlotRecord(
        slot=slot, time_s=slot / FPS, selected=selected, arrived=selected,
        people=People(np.array([10, 11]), joints_m, scores, sigma_m=np.full((2, 17), 0.01)),
        occlusion=np.zeros(3), deficit=np.zeros(3),
        next_selection=~selected,
    )  # fmt: skip


def poses(slot: int, blind: str = "") -> Poses:
    """The same people as a message of the edge."""
    made = record(slot)
    return Poses(
        slot,
        STARTED_NS + round(slot / FPS * 1e9),
        COCO17.joints,
        pack(made.people.track_ids.astype(np.int64)),
        pack(made.people.joints_m.astype(np.float32)),
        pack(np.full((2, 17), 0.01, dtype=np.float32)),
        pack(made.people.measured),
        selected=("c0", "c1"),
        arrived=() if blind else ("c0",),
        blind=blind,
    )


def status(slot: int) -> Status:
    """A quarter of the last minute was blind; the time of one event is not known."""
    return Status(
        "lab", slot, FPS, 2, 2, tuple(CameraStatus(i, True) for i in RIG.camera_ids),
        events=("c1 connected", "c2 connected"), events_ns=(0, STARTED_NS),
        slots=120, blind={"orders-late": 30}, blind_share=0.25, run_ns=STARTED_NS,
    )  # fmt: skip


@dataclass
class Watched:
    """A view, and the edge of its site, which the test plays.

    Attributes:
        view: that serves.
        edge: publishes.
        folder: of the site.
    """

    view: View
    edge: MemoryTransport
    folder: Path

    def client(self, token: str = "") -> httpx.Client:
        """Return a client that shows a token."""
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        return httpx.Client(base_url=self.view.url, headers=headers, timeout=30)

    def publish(self, slot: int, blind: str = "") -> None:
        """Send the status of the site and its people."""
        self.edge.publish("e3pose/lab/status", encode(status(slot)))
        self.edge.publish("e3pose/lab/poses", encode(poses(slot, blind)))

    def publish_smoothed(self, slot: int, delay_ms: float = 200.0) -> None:
        """Send the people of a slot once more, 3 m to the right, as late as the delay."""
        late = poses(slot)
        joints_m = unpack(late.joints_m) + np.array([3.0, 0.0, 0.0], dtype=np.float32)
        smoothed = msgspec.structs.replace(
            late, joints_m=pack(joints_m), selected=(), arrived=(), delay_ms=delay_ms,
            published_edge_ns=late.time_edge_ns + round(1e6 * delay_ms) + 31_000_000,
        )  # fmt: skip
        self.edge.publish("e3pose/lab/poses-delayed", encode(smoothed))


def store_site(folder: Path, more: str = "") -> None:
    """Write a site to a folder, with some stored slots, and further tables of its file."""
    (folder / "site.toml").write_text(SITE + more)
    save_rig(RIG, folder / "rig.toml")
    run = Run("lab", "lab", STARTED_NS, 1 / FPS, "coco17", COCO17.joints, RIG.camera_ids)
    with StoreWriter(folder / "lab.db", run) as writer:
        for slot in range(SLOTS):
            writer.append(record(slot), time_ns=STARTED_NS + round(slot / FPS * 1e9), wait=True)
        writer.energy(EnergyReading(STARTED_NS + 10**9, "c0", 7.5, 1.0, "measured: VDD_IN", 0.75))
        writer.event(Event(STARTED_NS + 10**9, "camera-lost", "c2: silent for 2 s", "c2"))


@contextmanager
def watched_site(
    folder: Path, more: str = "", report: Callable[[str], object] = lambda line: None
) -> Iterator[Watched]:
    """View a site; see `store_site`, which writes it where the folder has none.

    Args:
        folder: of the site.
        more: tables of its file.
        report: called with lines for operators.
    """
    if not (folder / "site.toml").exists():
        store_site(folder, more)
    hub = Hub()
    with open_view(
        resolve_site(folder), "127.0.0.1:0", transport=hub.join(), report=report
    ) as view:
        view.rules.writes = Rate(1e6, 1e6, time.monotonic)  # tests ask for much
        view.feed.quiet_s = 1e9  # and their edge says little
        view.feed.names.look(STARTED_NS)  # else the first follower hears of the run by and by
        yield Watched(view, hub.join(), folder)
