"""What the page knows of a camera's fields is what the message has."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from msgspec import inspect

from e3pose.site.web.page import FILES
from e3pose.wire.messages import fields
from e3pose.wire.site_messages import CameraStatus

NAME = "camera_status.js"
HERE = Path(__file__).parents[3] / "src" / "e3pose" / "site" / "web" / "browser" / NAME
COMMAND = "python -m tests.site.web.test_camera_status_js"
SCRIPTS = {path: body.decode() for path, body in FILES.items() if path.endswith(".js")}


def javascript(typed: Any) -> str:
    """Return the type of a field as JSDoc has it."""
    match typed:
        case inspect.Metadata():
            return javascript(typed.type)
        case inspect.UnionType():
            return "|".join(javascript(each) for each in typed.types)
        case inspect.LiteralType():
            return "|".join(json.dumps(value) for value in typed.values)
        case inspect.IntType() | inspect.FloatType():
            return "number"
        case inspect.BoolType():
            return "boolean"
        case inspect.NoneType():
            return "null"
        case inspect.StrType():
            return "string"
    raise TypeError(f"no type of the page for {typed}")


def script() -> str:
    """Return the module of the page that has the types and meanings of the fields."""
    typed: Any = inspect.type_info(CameraStatus)
    types = {field.name: javascript(field.type) for field in typed.fields}
    told = {field.name: field.meaning for field in fields(CameraStatus)}
    shown = {name: words.replace("None", "–") for name, words in told.items()}
    return "\n".join(
        (
            "// What a camera reports: types and meanings of its fields, made of `CameraStatus`.",
            f"// `{COMMAND}` writes this file.",
            "",
            "/**",
            " * @typedef {object} CameraStatus",
            *(
                f" * @property {{{types[name]}}} {name} {words.replace('None', 'null')}"
                for name, words in told.items()
            ),
            " */",
            "",
            f"export const MEANINGS = {json.dumps(shown, indent=2, ensure_ascii=False)};",
            "",
        )
    )


def test_types_of_the_page_are_those_of_the_message() -> None:
    assert HERE.read_text() == script(), f"another file than {COMMAND} writes"


def test_the_page_uses_no_field_that_cameras_do_not_report() -> None:
    """Of what is called a camera; stored statuses of the past go by the same names."""
    known = {field.name for field in fields(CameraStatus)}
    used = {
        name
        for path, text in SCRIPTS.items()
        if not path.startswith(("/vendor/", "/setup/"))
        for name in re.findall(r"(?<![\w.])camera\.(\w+)", text)
    }
    assert {"camera_id", "battery", "asleep_s", "why"} <= used <= known, used - known
    columns = SCRIPTS["/details.js"].partition("const COLUMNS")[2].partition("\n];")[0]
    used = set(re.findall(r"\bc\.(\w+)", columns))
    assert {"duty", "lost", "temperature_c"} <= used <= known, used - known
    meant = set(re.findall(r'"(\w+)"', " ".join(re.findall(r"means\(([^)]*)\)", columns))))
    assert {"duty", "price", "lost"} <= meant <= known, meant - known


if __name__ == "__main__":
    HERE.write_text(script())
