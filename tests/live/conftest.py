"""One site of real processes for all tests of faults, and a browser for those of pages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.live.processes import LiveSite, make_recording

if TYPE_CHECKING:
    from tests.site.web.browser import Page


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_recording(tmp_path_factory.mktemp("live") / "recording")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[LiveSite]:
    folder = tmp_path_factory.mktemp("site")
    (folder / "recording").symlink_to(recording)
    made = LiveSite(folder, more=('state = "state.npz"',), tables=("[store]", 'path = "poses.db"'))
    with made.at_work():
        yield made


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A window of a browser, for the tests of a file one after the other."""
    from tests.site.web.browser import browser

    with browser(tmp_path_factory.mktemp("browser")) as made:
        yield made
