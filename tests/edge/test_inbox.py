"""What cameras say becomes views with the joints of the site, whatever their detectors find."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace
from tests.cases import each_case
from tests.manual_clock import ManualClock
from tests.memory_transport import Hub
from tests.rigs import looking

from e3pose.base.clock import SlotTimes
from e3pose.edge.camera_state import State
from e3pose.edge.gather import Gather
from e3pose.edge.inbox import Inbox
from e3pose.model.skeleton import BODY25, COCO17, COCO18, Skeleton
from e3pose.wire.arrays import pack
from e3pose.wire.codec import encode
from e3pose.wire.messages import Heartbeat, Hello, View

RIG = looking((4, 0), (0, 4))


def view(joints: int, session: int = 5) -> View:
    """Return one person whose joint i is at (10 i, 5), scored 0.5."""
    pixels = np.stack([10.0 * np.arange(joints), np.full(joints, 5.0)], axis=-1)
    scores = np.full((1, joints), 0.5, dtype=np.float32)
    keypoints = pixels[None].astype(np.float32)
    return View("c0", session, 0, 1, pack(keypoints), pack(scores))


def received(found: Skeleton, expected: Skeleton, sent: int | None = None) -> tuple[Inbox, Gather]:
    """Let a camera with one skeleton with_hello and send a view to an edge with another."""
    gather, hub = Gather(2), Hub()
    inbox = Inbox(
        "lab", RIG, expected.joints, 0.05, gather, ManualClock(10**9),
        lambda beat: None,
    )  # fmt: skip
    inbox.listen(hub.join())
    camera = hub.join()
    hello = Hello("c0", 5, found.joints, (1000, 800), 25.0)
    camera.publish("e3pose/lab/camera/c0/hello", encode(hello))
    camera.publish("e3pose/lab/camera/c0/view", encode(view(sent or len(found))))
    return inbox, gather


@each_case("found", [COCO18, BODY25])
def test_joints_are_taken_by_their_names(found: Skeleton) -> None:
    inbox, gather = received(found, COCO17)
    poses = gather.close()[0].poses
    assert inbox.wrong == 0 and poses.scores.shape == (1, 17)
    for index, joint in enumerate(COCO17.joints):
        assert poses.keypoints_px[0, index, 0] == 10.0 * found.index(joint)


def test_joint_between_others_is_their_mean_and_one_that_is_not_found_missing() -> None:
    poses = received(COCO17, COCO18)[1].close()[0].poses
    shoulders = [COCO17.index(f"{side}_shoulder") for side in ("left", "right")]
    assert poses.keypoints_px[0, COCO18.index("neck"), 0] == 10.0 * np.mean(shoulders)
    poses = received(COCO17, BODY25)[1].close()[0].poses
    heel = BODY25.index("left_heel")
    assert poses.scores[0, heel] == 0 and np.isnan(poses.keypoints_px[0, heel]).all()
    assert (poses.scores[0, : BODY25.index("left_big_toe")] == 0.5).all()


def test_view_with_other_joints_than_were_announced_is_refused() -> None:
    inbox, gather = received(COCO18, COCO17, sent=17)
    assert inbox.wrong == 1 and not gather.close()
    assert "found 17 joints, expected 18" in inbox.cameras[0].fault


def test_times_of_cameras_are_moved_to_the_edge_s() -> None:
    beats, clock = list[Heartbeat](), ManualClock(10**18)
    inbox = Inbox("lab", RIG, COCO17.joints, 0.05, gather := Gather(2), clock, beats.append)
    inbox.listen((hub := Hub()).join())
    camera, near_ns = hub.join(), 5 * 10**9
    for slot, (said_ns, taken_ns) in enumerate((
        (0, -near_ns), (2**62, near_ns), (10**18 - 10**9, -(10**9)), (10**18 + 1, 1)
    )):  # fmt: skip
        clock.advance(1.0)
        moved_ns = 0 if said_ns in (0, 2**62) else 10**9 * (slot + 1)
        said = replace(view(17), slot=slot, captured_edge_ns=said_ns + moved_ns)
        camera.publish("e3pose/lab/camera/c0/view", encode(said))
        beat = Heartbeat("c0", 5, said_ns + moved_ns, "active")
        camera.publish("e3pose/lab/camera/c0/heartbeat", encode(beat))
        assert gather.close()[0].captured_ns - clock.now_ns() == taken_ns
        assert beats[-1].sent_edge_ns - clock.now_ns() == taken_ns
    assert inbox.wrong == 0 and inbox.cameras[0].beat == beats[-1]


def test_heartbeats_beyond_five_per_second_are_not_passed_on() -> None:
    beats, clock = list[Heartbeat](), ManualClock(10**18)
    inbox = Inbox("lab", RIG, COCO17.joints, 0.05, Gather(2), clock, beats.append)
    inbox.listen((hub := Hub()).join())
    camera = hub.join()
    for count in range(100):
        clock.advance(0.02)
        beat = Heartbeat("c0", 5, clock.now_ns(), "active", captured=count)
        camera.publish("e3pose/lab/camera/c0/heartbeat", encode(beat))
    assert len(beats) == 10
    newest = inbox.cameras[0].beat
    assert newest is not None and newest.captured == 99
    camera.publish("e3pose/lab/camera/c0/heartbeat", encode(replace(newest, ends=True)))
    assert beats[-1].ends  # the last one always is


def test_who_cannot_sleep_is_never_told_to() -> None:
    inbox = Inbox(
        "lab", RIG, COCO17.joints, 0.05, Gather(2), ManualClock(10**9),
        lambda beat: None, wakes_s=[0.5, 0.5],
    )  # fmt: skip
    hub, times, until = Hub(), SlotTimes(0, 10**8), np.array([100, 100])
    inbox.listen(hub.join())
    assert inbox.order_sleep(times, until, 100, 2).tolist() == [0, 0]  # awake from that slot on
    hello = Hello("c0", 1, COCO17.joints, (640, 480), 20.0, rests=())
    hub.join().publish("e3pose/lab/camera/c0/hello", encode(hello))
    assert inbox.order_sleep(times, until, 20, 2).tolist() == [0, 100]  # c1 may be asleep already
    assert [c.sleep.due_ns for c in inbox.cameras] == [0, times.begin_ns(98)]
    assert inbox.states().tolist() == [State.BARRED, State.ASLEEP]
    inbox.excuse()
    assert inbox.states()[1] == State.ASLEEP
