"""What programs say in the end, as a person would say it."""

from __future__ import annotations

import msgspec
from tests.cases import each_case

from e3pose.base.quantities import plural
from e3pose.camera.status import CameraCounts
from e3pose.site.summary import camera_summary, edge_summary
from e3pose.wire.site_messages import CameraStatus, Status


def test_edge_says_how_it_left_each_camera() -> None:
    cameras = (
        CameraStatus("cam0", False, why="stopped", last_seen_s=0.1, duty=0.5, late=1, lost=0),
        CameraStatus("cam1", True, last_seen_s=0.1, duty=0.25, late=2, lost=3),
        CameraStatus("cam2", True, why="views come late", last_seen_s=0.1),
        CameraStatus("cam3", False, why="never connected"),
    )
    assert plural(1_234_567, "row") == "1234567 rows" and plural(0.95, "row") == "0.95 rows"
    status = Status("lab", 1, 20.0, 2, 1, cameras, (1.0, 2.0), (3.0, 4.0))
    blind = msgspec.structs.replace(status, blind={"orders-late": 3, "views-missing": 2})
    said = edge_summary(blind, 27, 40)[0]
    assert said.startswith("27 slots, 0 lost, 5 blind (3 orders late, 2 views missing), 40 views")
    assert edge_summary(status, 1, 1) == [
        "1 slot, 0 lost, 0 blind, 1 view in time; lead 2; computing 1.0 ms (99 %: 2.0) per slot, "
        "latency 3.0 ms (99 %: 4.0) after the last view",
        "  cam0: stopped; active in 50% of the last minute's slots, 1 view late, 0 lost",
        "  cam1: online; active in 25% of the last minute's slots, 2 views late, 3 lost",
        "  cam2: online, views come late; active in 0% of the last minute's slots, "
        "0 views late, 0 lost",
        "  cam3: never connected",
    ]


def test_edge_that_did_nothing_says_why_and_measures_nothing() -> None:
    status = Status("lab", 0, 0.0, 2, 0, (CameraStatus("cam0", False, why="never connected"),))
    message = edge_summary(status, 0, 0)
    assert message == ["No slots: fewer than two cameras connected", "  cam0: never connected"]


def test_camera_without_frames_says_why() -> None:
    assert camera_summary("cam0", CameraCounts(), 0, 0) == "cam0: no frames"
    message = camera_summary("cam0", CameraCounts(), 0, 0, "source usb:0: found no /dev/video0")
    assert message == "cam0: no frames: source usb:0: found no /dev/video0"


@each_case(
    ("done", "orders", "late", "message"),
    [
        (CameraCounts(1, 1, sent=1), 4, 1, "cam0: 1 frame, 1 processed, 1 view sent, 1 late order"),
        (
            CameraCounts(9, 2, sent=2),
            4,
            0,
            "cam0: 9 frames, 2 processed, 2 views sent, 0 late orders",
        ),
        (CameraCounts(9), 0, 0, "cam0: 9 frames, but no orders from the edge"),
    ],
)
def test_camera_says_what_it_did(done: CameraCounts, orders: int, late: int, message: str) -> None:
    assert camera_summary("cam0", done, orders, late) == message
