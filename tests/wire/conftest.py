"""A site whose programs are opened by name, for a file of tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.wire.certified_site import Site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    made = Site(tmp_path_factory.mktemp("site") / "keys")
    yield made
    for transport in made.open:
        transport.close()
