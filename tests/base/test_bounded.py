from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from tests.cases import each_case

from e3pose.base import bounded
from e3pose.base.bounded import decode_json, read_bytes, read_lines
from e3pose.base.errors import InputError


def test_reads_a_file_of_just_the_limit(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12345")
    assert read_bytes(tmp_path / "a", 5) == b"12345"
    with pytest.raises(InputError, match="found 5 bytes, expected at most 4"):
        read_bytes(tmp_path / "a", 4)


@each_case(
    ("path", "message"),
    [
        ("absent", "not found"),
        ("x" * 5000, "cannot be read"),
        ("a\0b", "cannot be read"),
        (".", "found a folder"),
        ("pipe", "pipe, socket or device"),  # without waiting
        ("zero", "pipe, socket or device"),
    ],
)
def test_a_path_that_cannot_be_is_named(tmp_path: Path, path: str, message: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    with pytest.raises(InputError, match=message):
        read_bytes(tmp_path / path, 10)


def test_lines_are_numbered_and_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_bytes(b"one\r\n\nlonger")
    assert list(read_lines(tmp_path / "a", 100)) == [(1, b"one"), (2, b""), (3, b"longer")]
    monkeypatch.setattr(bounded, "MAX_LINE_BYTES", 5)
    with pytest.raises(InputError, match="a:3: line is longer"):
        list(read_lines(tmp_path / "a", 100))


@each_case(
    ("kind", "content", "found"),
    [
        (list[int], b" \n", "an empty file"),
        (list[int], b"[1,", "Input data was truncated"),
        (list[int], b'["a"]', "Expected `int`, got `str`"),
        (list[str], b'["\xff"]', "'utf-8' codec can't decode"),
        (object, b"[" * 100_000, "maximum recursion depth exceeded"),
    ],
)
def test_content_that_is_not_what_was_expected_is_said_in_one_line(
    kind: Any, content: bytes, found: str
) -> None:
    with pytest.raises(InputError) as error:
        decode_json(kind, content, "a.json", "numbers")
    assert str(error.value).startswith(f"a.json: {found}")
    assert str(error.value).endswith(", expected numbers")
