"""One view for the tests of a module."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.site.web.watched import Watched, watched_site


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    with watched_site(tmp_path_factory.mktemp("site")) as made:
        yield made
