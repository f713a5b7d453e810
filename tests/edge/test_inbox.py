"""What cameras say becomes views with the joints of the site, whatever their detectors find."""

from __future__ import annotations

import numpy as np
import pytest
from tests.manual_clock import ManualClock
from tests.memory_transport import Hub
from tests.rigs import looking

from e3pose.edge.gather import Gather
from e3pose.edge.inbox import Inbox
from e3pose.model.skeleton import BODY25, COCO17, COCO18, Skeleton
from e3pose.wire.arrays import pack
from e3pose.wire.codec import encode
from e3pose.wire.messages import Hello, View

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
        "lab", RIG, expected.joints, 0.05, gather, ManualClock(10**9), lambda i, s: None,
        lambda beat: None,
    )  # fmt: skip
    inbox.listen(hub.join())
    camera = hub.join()
    hello = Hello("c0", 5, found.joints, (1000, 800), 25.0)
    camera.publish("e3pose/lab/camera/c0/hello", encode(hello))
    camera.publish("e3pose/lab/camera/c0/view", encode(view(sent or len(found))))
    return inbox, gather


@pytest.mark.parametrize(("found", "expected"), [(COCO18, COCO17), (BODY25, COCO17)])
def test_joints_are_taken_by_their_names(found: Skeleton, expected: Skeleton) -> None:
    inbox, gather = received(found, expected)
    poses = gather.close()[0].poses
    assert inbox.wrong == 0 and poses.scores.shape == (1, len(expected))
    for index, joint in enumerate(expected.joints):
        assert poses.keypoints_px[0, index, 0] == 10.0 * found.index(joint)


def test_joint_between_others_is_their_mean() -> None:
    poses = received(COCO17, COCO18)[1].close()[0].poses
    shoulders = [COCO17.index(f"{side}_shoulder") for side in ("left", "right")]
    assert poses.keypoints_px[0, COCO18.index("neck"), 0] == 10.0 * np.mean(shoulders)


def test_joint_that_no_detector_finds_is_missing() -> None:
    poses = received(COCO17, BODY25)[1].close()[0].poses
    heel = BODY25.index("left_heel")
    assert poses.scores[0, heel] == 0 and np.isnan(poses.keypoints_px[0, heel]).all()
    assert (poses.scores[0, : BODY25.index("left_big_toe")] == 0.5).all()


def test_view_with_other_joints_than_were_announced_is_refused() -> None:
    inbox, gather = received(COCO18, COCO17, sent=17)
    assert inbox.wrong == 1 and not gather.close()
    assert "found 17 joints, expected 18" in inbox.roster.cameras[0].fault
