"""Topics of messages, in a namespace of each site: `e3pose/SITE/...`.

e3pose/SITE/camera/CAMERA/{hello,view,heartbeat,alive}   a camera writes, the edge reads
e3pose/SITE/camera/CAMERA/clock                          a camera asks, the edge answers
e3pose/SITE/camera/CAMERA/picture                        an operator asks, the camera answers
e3pose/SITE/order/CAMERA                                 the edge writes, that camera reads
e3pose/SITE/{poses,poses-delayed,status}                 the edge writes, viewers read
e3pose/SITE/control/OPERATOR                             that operator asks, the edge answers
e3pose/SITE/outbox/HUB                                   that hub asks, the edge answers
e3pose/SITE/alive                                        that the edge is there

Names are checked where they enter: in files (`check_site`, `check_camera_id`), in certificates
(`e3pose.wire.keys.folder.holder`) and in topics that others publish (`sender`).
"""

from __future__ import annotations

from e3pose.base.errors import InputError
from e3pose.model.camera_fields import check_camera_id

ROOT = "e3pose"
ANY = "*"


def check_site(site: object) -> str:
    """Return `site` if it is a valid name; the rule is that of camera ids."""
    try:
        return check_camera_id(site)
    except InputError as error:
        raise error.at(thing="site") from None


def of_camera(site: str, camera_id: str, what: str) -> str:
    """Return a topic published by a camera; `ANY` stands for all cameras."""
    return f"{ROOT}/{site}/camera/{camera_id}/{what}"


def of_order(site: str, camera_id: str) -> str:
    """Return the topic of a camera's orders."""
    return f"{ROOT}/{site}/order/{camera_id}"


def of_site(site: str, what: str) -> str:
    """Return a topic of the edge: `poses`, `poses-delayed`, `status` or `alive`."""
    return f"{ROOT}/{site}/{what}"


def of_control(site: str, operator: str) -> str:
    """Return the topic on which an operator controls the edge; `ANY` stands for all operators."""
    return f"{ROOT}/{site}/control/{operator}"


def of_outbox(site: str, hub: str) -> str:
    """Return the topic on which a hub asks for summaries; `ANY` stands for all hubs."""
    return f"{ROOT}/{site}/outbox/{hub}"


def sender(topic: str) -> str:
    """Return the camera that published on a topic.

    Raises:
        InputError: when it is no topic of a camera.
    """
    parts = topic.split("/")
    if len(parts) != 5 or parts[0] != ROOT or parts[2] != "camera":
        raise InputError(f"topic {topic[:120]!r}: expected {ROOT}/SITE/camera/CAMERA/...")
    return check_camera_id(parts[3])
