"""Within a version of the messages no field goes, moves, or gets another type."""

from __future__ import annotations

import json

from tests.cases import each_case
from tests.test_tuned_numbers import hooks

from e3pose.wire.messages import VERSION

SHAPES = hooks.message_shapes()
MORE = f"more: int{hooks.OPTIONAL}"


def test_messages_of_a_version_only_grow() -> None:
    version, stored = json.loads(hooks.MESSAGE_SHAPES.read_text())
    assert version == VERSION, "python docs/hooks.py writes the fields of the new version"
    broken = hooks.broken_messages(stored, SHAPES)
    assert broken == [], "make VERSION one more, or keep the fields"
    assert stored == SHAPES, "python docs/hooks.py notes the new fields"


@each_case("name", sorted(SHAPES))
def test_fields_that_go_move_or_change_are_found(name: str) -> None:
    form, first, *rest = SHAPES[name]
    other = "array" if form == "map" else "map"
    gone, typed, needed = rest, [f"{first}?", *rest], [first, *rest, "more: int"]
    inserted, added = [MORE, first, *rest], [first, *rest, MORE]
    cases = [(other, [first, *rest]), (form, gone), (form, typed), (form, needed)]
    for form_now, fields in cases + [(form, inserted)] * (form != "map"):
        after = {**SHAPES, name: [form_now, *fields]}
        assert hooks.broken_messages(SHAPES, after) == [name], fields
    for fields in [added] + [inserted] * (form == "map"):
        assert hooks.broken_messages(SHAPES, {**SHAPES, name: [form, *fields]}) == [], fields
