"""Within a version of the messages no field goes, moves, or gets another type.

`fields.json` has the messages of this version as they were written last.
"""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any, get_args

from msgspec import inspect
from tests.test_tuned_numbers import hooks

from e3pose.wire.codec import Message
from e3pose.wire.messages import VERSION, Array
from e3pose.wire.site_messages import CameraStatus, Tombstone

FILE = Path(__file__).with_name("fields.json")
COMMAND = "python -m tests.wire.test_versions"
KINDS: tuple[Any, ...] = (*get_args(Message), CameraStatus, Tombstone, Array)
Shapes = dict[str, dict[str, Any]]


def shapes() -> Shapes:
    """Return of each message its tag, whether it is a map by names, and its fields in order."""
    found = {}
    for kind in KINDS:
        typed: Any = inspect.type_info(kind)
        fields = [[each.name, hooks.type_words(each.type), each.required] for each in typed.fields]
        named = not kind.__struct_config__.array_like
        found[kind.__name__] = {"tag": typed.tag, "named": named, "fields": fields}
    return found


def broken(before: Shapes, after: Shapes) -> list[str]:
    """Return what a reader or a writer of the messages of before would trip over."""
    found = []
    for name, was in before.items():
        now = after.get(name)
        if now is None or (now["tag"], now["named"]) != (was["tag"], was["named"]):
            found.append(f"{name}: is gone, or has another form")
            continue
        old, new = was["fields"], now["fields"]
        places: list[int] = list(range(len(old)))
        if was["named"]:
            names = [each[0] for each in new]
            places = [names.index(each[0]) if each[0] in names else -1 for each in old]
        for field, place in zip(old, places, strict=True):
            if not 0 <= place < len(new) or new[place] != field:
                found.append(f"{name}: {field[0]} went, moved, or has another type or default")
        added = [each for index, each in enumerate(new) if index not in places]
        found += [f"{name}: {each[0]} is new and has no default" for each in added if each[2]]
    return found


def test_messages_of_a_version_only_grow() -> None:
    stored = json.loads(FILE.read_text())
    assert stored["version"] == VERSION, f"{COMMAND} writes the fields of the new version"
    assert broken(stored["messages"], shapes()) == [], "make VERSION one more, or keep the field"
    assert stored["messages"] == shapes(), f"{COMMAND} notes the new fields"


def test_fields_that_go_move_or_change_are_found() -> None:
    for name, shape in shapes().items():
        last = len(shape["fields"]) - 1
        for change in ("gone", "moved", "typed", "required", "form"):
            after = copy.deepcopy(shapes())
            fields = after[name]["fields"]
            match change:
                case "gone":
                    del fields[0]
                case "moved":
                    fields[0], fields[last] = fields[last], fields[0]
                case "typed":
                    fields[last][1] = "another"
                case "required":
                    fields.append(["more", "int", True])
                case "form":
                    after[name]["named"] = not shape["named"]
            harmless = last == 0 or shape["named"]
            assert bool(broken(shapes(), after)) != (change == "moved" and harmless), (name, change)


def test_new_fields_with_defaults_break_nothing() -> None:
    after = copy.deepcopy(shapes())
    for shape in after.values():
        place = 3 if shape["named"] else len(shape["fields"])
        shape["fields"].insert(place, ["more", "int", False])
    assert broken(shapes(), after) == []


if __name__ == "__main__":
    stored: Any = json.loads(FILE.read_text()) if FILE.exists() else {"version": 0}
    if stored["version"] == VERSION and (faults := broken(stored["messages"], shapes())):
        raise SystemExit("\n".join(faults))
    rows = ",\n".join(f"  {json.dumps(name)}: {json.dumps(one)}" for name, one in shapes().items())
    FILE.write_text(f'{{"version": {VERSION}, "messages": {{\n{rows}\n}}}}\n')
