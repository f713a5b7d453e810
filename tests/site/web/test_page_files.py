"""The files of the page: few, plain, complete, and true to the messages."""

from __future__ import annotations

import posixpath
import re

from tests.test_length import hooks

from e3pose.site.web.page import BROWSER, FILES
from e3pose.wire.messages import fields
from e3pose.wire.site_messages import CameraStatus

OWN = {path: body.decode() for path, body in FILES.items() if not path.startswith("/vendor/")}
SETUP = BROWSER.joinpath("setup.html").read_text()  # stands at the address of the set-up


def test_modules_import_what_is_served_and_every_one_is_used() -> None:
    named = {"/", *re.findall(r'(?:src|href)="(/[^"]*)"', OWN["/"] + SETUP)}
    for path, body in OWN.items():
        for name in re.findall(r'from "(\.[^"]*)"', body):
            named.add(posixpath.normpath(posixpath.join(posixpath.dirname(path), name)))
    assert named == set(FILES)


def test_own_files_name_no_other_host_and_make_no_markup_of_text() -> None:
    for path, text in {**OWN, "/setup.html": SETUP}.items():
        assert not re.search(r"https?://|//cdn|innerHTML|insertAdjacentHTML|eval\(", text), path
        assert not re.search(r"<script>|style=\"|\son\w+=\"", text), path


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
