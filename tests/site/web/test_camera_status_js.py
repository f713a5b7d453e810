"""What the page knows of a camera's fields is what the message has."""

from __future__ import annotations

import re

from tests.test_tuned_numbers import hooks

from e3pose.site.web.page import FILES
from e3pose.wire.messages import fields
from e3pose.wire.site_messages import CameraStatus

SCRIPTS = {path: body.decode() for path, body in FILES.items() if path.endswith(".js")}


def test_types_of_the_page_are_those_of_the_message() -> None:
    written = hooks.BROWSER_TYPES.read_text()
    assert written == hooks.browser_types(), "python docs/hooks.py writes it"


def test_the_page_uses_no_field_that_cameras_do_not_report() -> None:
    known = {field.name for field in fields(CameraStatus)}
    pages = [text for path, text in SCRIPTS.items() if not path.startswith(("/vendor/", "/setup/"))]
    used = set(re.findall(r"(?<![\w.])camera\.(\w+)", "".join(pages)))
    assert {"camera_id", "battery", "asleep_s", "why"} <= used <= known, used - known
    columns = SCRIPTS["/details.js"].partition("const COLUMNS")[2].partition("\n];")[0]
    used = set(re.findall(r"\bc\.(\w+)", columns))
    assert {"duty", "lost", "temperature_c"} <= used <= known, used - known
    meant = set(re.findall(r'"(\w+)"', " ".join(re.findall(r"means\(([^)]*)\)", columns))))
    assert {"duty", "price", "lost"} <= meant <= known, meant - known
