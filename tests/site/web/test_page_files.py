"""The files of the page: few, plain, complete, and of this host alone."""

from __future__ import annotations

import posixpath
import re
from importlib import resources

from e3pose.site.web.page import BROWSER, FILES

OWN = {path: body.decode() for path, body in FILES.items() if not path.startswith("/vendor/")}
SETUP = BROWSER.joinpath("setup.html").read_text()  # stands at the address of the set-up
MOST_LINES = 4000  # of our own script and styles


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


def test_script_and_styles_stay_within_their_bounds() -> None:
    lines = sum(len(text.splitlines()) for path, text in OWN.items() if path != "/")
    assert 1000 < lines <= MOST_LINES


def test_library_comes_with_its_licences() -> None:
    vendor = BROWSER.joinpath("vendor")
    assert "MIT" in vendor.joinpath("LICENSE-preact").read_text()
    assert "Apache License" in vendor.joinpath("LICENSE-htm").read_text()
    assert resources.files("e3pose.site.web").joinpath("browser/vendor/preact.js").is_file()
