"""The page on messages has every field of every message, and its examples are messages."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest
from tests.cases import each_case
from tests.test_length import hooks

from e3pose.wire import topics
from e3pose.wire.arrays import poses_2d
from e3pose.wire.codec import MAX_BYTES, Message, decode
from e3pose.wire.messages import VERSION, Order, View, fields
from e3pose.wire.site_messages import CameraStatus

TEXT = (Path(__file__).parents[2] / "docs" / "reference" / "messages.md").read_text()
MESSAGES: tuple[Any, ...] = get_args(Message)


@each_case("kind", [*MESSAGES, CameraStatus], ids=lambda kind: str(kind.__name__))
def test_every_message_has_its_table_and_every_field_its_meaning(kind: Any) -> None:
    tag = kind.__struct_config__.tag
    head = f"### {kind.__name__}, tag `{tag}`" if tag else f"#### {kind.__name__}"
    below = TEXT.partition(f"{head}\n")[2].partition("\n### ")[0]
    assert below.count(f"<!-- fields of {kind.__name__} -->") == 1
    table = hooks.fields_table(kind.__name__)
    for field in fields(kind):
        assert f"`{field.name}`" in table
        assert field.meaning != field.name, f"{kind.__name__}: {field.name} has no meaning"


def test_links_of_the_tables_are_used() -> None:
    tables = "".join(map(hooks.fields_table, hooks.MESSAGES))
    assert [words for words in hooks.LINKS if f"[{words}](" not in tables] == []


def example(name: str) -> bytes:
    (text,) = re.findall(rf"<!-- {name} -->\n```\n(.*?)```", TEXT, re.S)
    return bytes.fromhex(text)


def test_the_order_of_the_page_is_one() -> None:
    order = decode(example("order"), Order, "the page")
    (line,) = re.findall(rf"^\[{VERSION}, \[.*\]\]$", TEXT, re.M)
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
