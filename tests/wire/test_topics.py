"""Topics: every site and camera keeps to its own."""

from __future__ import annotations

from functools import partial

import pytest

from e3pose.base.errors import InputError
from e3pose.wire.topics import ANY, of_camera, of_control, of_order, of_site, sender


def test_sender_of_a_cameras_topic() -> None:
    assert sender(of_camera("lab", "cam1", "view")) == "cam1"
    assert of_camera("lab", ANY, "view") == "e3pose/lab/camera/*/view"


@pytest.mark.parametrize("name", ["", "*", "**", "a/b", "../x", "a b", "a$*", "-x", "x" * 65, "ü"])
def test_names_that_would_reach_elsewhere_are_refused(name: str) -> None:
    with pytest.raises(InputError):
        of_order("lab", name)
    with pytest.raises(InputError, match="site"):
        of_site(name, "poses")
    for topic in (partial(of_camera, what="view"), of_control):
        if name == ANY:
            assert f"/{ANY}" in topic("lab", name)
            continue
        with pytest.raises(InputError):
            topic("lab", name)


@pytest.mark.parametrize("topic", ["e3pose/lab/order/cam1", "x/lab/camera/cam1/view", "", "/////"])
def test_topic_of_no_camera_has_no_sender(topic: str) -> None:
    with pytest.raises(InputError):
        sender(topic)
