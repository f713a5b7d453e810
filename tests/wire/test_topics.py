"""Topics: every site and camera keeps to its own."""

from __future__ import annotations

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.camera_fields import check_camera_id
from e3pose.wire.topics import ANY, check_site, of_camera, sender


def test_sender_of_a_cameras_topic() -> None:
    assert sender(of_camera("lab", "cam1", "view")) == "cam1"
    assert of_camera("lab", ANY, "view") == "e3pose/lab/camera/*/view"


@each_case("name", ["", "*", "**", "a/b", "../x", "a b", "a$*", "-x", "x" * 65, "ü"])
def test_names_that_would_reach_elsewhere_do_not_enter(name: str) -> None:
    with pytest.raises(InputError, match="site"):
        check_site(name)
    with pytest.raises(InputError, match="camera id"):
        check_camera_id(name)
    with pytest.raises(InputError):
        sender(of_camera("lab", name, "view"))


@each_case("topic", ["e3pose/lab/order/cam1", "x/lab/camera/cam1/view", "", "/////"])
def test_topic_of_no_camera_has_no_sender(topic: str) -> None:
    with pytest.raises(InputError):
        sender(topic)
