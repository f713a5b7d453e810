"""A ROS 2 node: the people of a running site as standard messages.

Run: python examples/09_ros2_node.py SITE
in a ROS 2 environment (rclpy, visualization_msgs, geometry_msgs) with e3pose installed. SITE is the
site file, or its folder.

    /e3pose/skeletons  visualization_msgs/MarkerArray   a line list per person, for RViz
    /e3pose/people     geometry_msgs/PoseArray          where each person stands

Both are in the frame `world`, metres, z up, stamped with the middle of the slot.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from e3pose import SKELETONS, connect
from e3pose.site.connect import LiveSlot

LIMBS = SKELETONS["coco17"].limbs
LIFETIME_NS = 500_000_000  # of who is not shown any more


def skeletons(slot: LiveSlot, header: Any, msgs: Any) -> list[Any]:
    """Return a marker per person.

    Args:
        slot: the people.
        header: of the messages.
        msgs: has the classes `Marker` and `Point`.
    """
    found = []
    ids, places_m = slot.people.track_ids.tolist(), slot.people.joints_m.astype(float)
    for track, joints_m in zip(ids, places_m, strict=True):
        known = np.isfinite(joints_m).all(axis=-1)
        marker = msgs.Marker()
        marker.header, marker.ns, marker.id = header, "e3pose", track
        marker.type, marker.action = msgs.Marker.LINE_LIST, msgs.Marker.ADD
        marker.pose.orientation.w, marker.scale.x = 1.0, 0.03
        marker.color.g, marker.color.a = 0.6, 1.0
        marker.lifetime.sec, marker.lifetime.nanosec = 0, LIFETIME_NS
        ends = [end for limb in LIMBS if known[list(limb)].all() for end in limb]
        marker.points = [msgs.Point(x=x, y=y, z=z) for x, y, z in joints_m[ends].tolist()]
        found.append(marker)
    return found


def main(place: str) -> None:
    """Publish slots as they come, until the node is shut down."""
    from types import SimpleNamespace

    import rclpy
    from geometry_msgs.msg import Point, Pose, PoseArray
    from std_msgs.msg import Header
    from visualization_msgs.msg import Marker, MarkerArray

    rclpy.init()
    node = rclpy.create_node("e3pose")
    markers = node.create_publisher(MarkerArray, "/e3pose/skeletons", 10)
    people = node.create_publisher(PoseArray, "/e3pose/people", 10)
    msgs = SimpleNamespace(Marker=Marker, Point=Point)
    with connect(place) as site:
        for slot in site:
            if not rclpy.ok():
                break
            header = Header(frame_id="world")
            header.stamp.sec, header.stamp.nanosec = divmod(slot.time_ns, 10**9)
            markers.publish(MarkerArray(markers=skeletons(slot, header, msgs)))
            poses = []
            for x, y, _ in np.nanmedian(slot.people.joints_m.astype(float), axis=1).tolist():
                pose = Pose()
                pose.position.x, pose.position.y, pose.orientation.w = x, y, 1.0
                poses.append(pose)
            people.publish(PoseArray(header=header, poses=poses))


if __name__ == "__main__":
    main(sys.argv[1])
