"""The page on messages names every field of every message, and its examples are messages."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest
from tests.cases import each_case

from e3pose.wire import topics
from e3pose.wire.arrays import poses_2d
from e3pose.wire.codec import MAX_BYTES, Message, decode
from e3pose.wire.messages import VERSION, Order, View
from e3pose.wire.site_messages import CameraStatus

TEXT = (Path(__file__).parents[2] / "docs" / "reference" / "messages.md").read_text()
MESSAGES: tuple[Any, ...] = get_args(Message)


def section(kind: Any) -> str:
    """The part of the page that is about one message."""
    if kind is CameraStatus:
        return TEXT.partition("(CameraStatus)")[2]
    (text,) = re.findall(rf"### {kind.__name__}, tag .*?(?=\n### |\n`cameras`|\Z)", TEXT, re.S)
    assert f"tag `{kind.__struct_config__.tag}`" in text
    return str(text)


@each_case("kind", [*MESSAGES, CameraStatus], ids=lambda kind: str(kind.__name__))
def test_every_field_has_its_row_in_its_place(kind: Any) -> None:
    rows = re.findall(r"^\| (\d+) \| (\*\*)?`(\w+)`", section(kind), re.M)
    first = 0 if kind is CameraStatus else 1  # place 0 is the tag
    assert [(int(place), name, bool(bold)) for place, bold, name in rows] == [
        (place, field.name, field.required)
        for place, field in enumerate(msgspec.structs.fields(kind), first)
    ]


def example(name: str) -> bytes:
    (text,) = re.findall(rf"<!-- {name} -->\n```\n(.*?)```", TEXT, re.S)
    return bytes.fromhex(text)


def test_the_order_of_the_page_is_one() -> None:
    order = decode(example("order"), Order, "the page")
    (line,) = re.findall(r"^\[1, \[.*\]\]$", TEXT, re.M)
    assert msgspec.msgpack.decode(example("order")) == msgspec.json.decode(line)
    assert order.slot == 42 and order.active and order.lead == 2


def test_the_view_of_the_page_is_one() -> None:
    poses = poses_2d(decode(example("view"), View, "the page"))
    assert poses.keypoints_px.tolist() == [[[320, 240.5]]]
    assert poses.scores[0, 0] == pytest.approx(0.9)


def test_version_limit_and_topics_are_those_of_the_code() -> None:
    assert f"The version is {VERSION}." in TEXT
    assert f"larger than {MAX_BYTES // 2**20} MiB" in TEXT
    for topic in (
        topics.of_camera("SITE", "CAMERA", "hello"),
        topics.of_camera("SITE", "CAMERA", "clock"),
        topics.of_order("SITE", "CAMERA"),
        topics.of_site("SITE", "poses"),
        topics.of_site("SITE", "status"),
    ):
        assert f"`{topic}`" in TEXT
