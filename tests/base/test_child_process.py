"""Functions that are called in a process of their own: answers, refusals, deadlines."""

from __future__ import annotations

import json
import operator
import os
import time
from collections.abc import Callable
from typing import Any

import pytest
from tests.cases import each_case

from e3pose.base.child_process import call_apart
from e3pose.base.errors import InputError
from e3pose.base.quantities import frequency_hz

ROOM = 2 * 10**9


def test_answer_comes_back_and_what_is_printed_is_none() -> None:
    assert call_apart(operator.add, [1], ["b"], limit_s=20.0) == [1, "b"]
    assert call_apart(print, "noise", limit_s=20.0) is None


@each_case(
    ("function", "argument", "limits", "words"),
    [
        (frequency_hz, "fast", {"limit_s": 20.0}, "found 'fast', expected"),
        (json.loads, "{", {"limit_s": 20.0}, "Expecting property name"),
        (os._exit, 3, {"limit_s": 20.0}, "no memory, or a crash"),
        (time.sleep, 60.0, {"limit_s": 0.5, "most_memory": ROOM}, "took more than 0.5 s"),
        (bytearray, 2 * ROOM, {"limit_s": 20.0, "most_memory": ROOM}, "not enough memory"),
    ],
)
def test_what_gives_no_answer_says_why(
    function: Callable[..., Any], argument: object, limits: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        call_apart(function, argument, **limits)
