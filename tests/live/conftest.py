"""A recording for all sites of real processes, and a browser for tests of pages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.live.processes import HERE, make_recording

if TYPE_CHECKING:
    from tests.site.web.browser import Page


# What takes minutes begins first: a part ends when its last file does.
LONG = ("test_setup_page", "test_outside", "test_events_of_people", "test_planted_secrets")


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is in this folder, and begin with the files that take longest."""
    for item in items:
        if item.path.is_relative_to(HERE):
            item.add_marker("live")
    items.sort(key=lambda item: item.path.stem not in LONG)


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_recording(tmp_path_factory.mktemp("live") / "recording")


@pytest.fixture(scope="session")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A browser for all tests of this process."""
    from tests.site.web.browser import browser

    with browser(tmp_path_factory.mktemp("browser")) as made:
        yield made


@pytest.fixture
def page(window: Page) -> Iterator[Page]:
    """The window of the browser, for one test after the other; between them it draws nothing."""
    yield window
    window.open("about:blank")
    window.messages.clear()
