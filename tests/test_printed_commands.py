"""Commands that are printed can be pasted: paths in them are quoted."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

SOURCES = Path(__file__).parents[1] / "src" / "e3pose"
COMMAND = re.compile(r"e3pose [a-z]+ [^`;]*$")
# What stands in a command without quotes: ids, names of models and options, numbers.
SAFE = re.compile(
    r"camera_id|camera\.camera_id|node\.camera|self\.camera_id|name|site(\.file\.name)?|option|words|"
    r"wanted|width|axis|kind|seconds|made|network|more|height|rig|walk|detector|choice\.name|options|"
    r"asked\.what|[A-Z_]+(\[.*\])?|files|shell\(.*|setup\.shown\(.*|quote\(.*|' '\.join\(.*"
)


@cache
def texts(path: Path) -> list[ast.JoinedStr]:
    """Return the texts with values of a file."""
    tree = ast.parse(path.read_text())
    return [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)]


def printed(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the values that stand in commands of a file, and their lines."""
    for node in texts(path):
        before = ""
        for part in node.values:
            if isinstance(part, ast.Constant):
                before += str(part.value)
            elif isinstance(part, ast.FormattedValue):
                if COMMAND.search(before):
                    yield node.lineno, ast.unparse(part.value)
                before += "x"


def test_paths_in_printed_commands_are_quoted() -> None:
    bare = [
        f"{path.relative_to(SOURCES)}:{line}: {value}"
        for path in sorted(SOURCES.rglob("*.py"))
        for line, value in printed(path)
        if not SAFE.fullmatch(value)
    ]
    assert not bare, bare
    found = [value for path in SOURCES.rglob("*.py") for _, value in printed(path)]
    assert sum(value.startswith("shell(") for value in found) > 15


def test_a_calibration_from_people_that_is_printed_states_their_height() -> None:
    """Without it all sizes may be 6 % off."""
    all_texts = [ast.unparse(node) for path in SOURCES.rglob("*.py") for node in texts(path)]
    asked = [text for text in all_texts if re.search("calibrate extrinsics .*--update", text)]
    assert len(asked) >= 6 and [text for text in asked if "height" not in text] == []
