"""A set-up with a site, and what asks it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import numpy as np
import pytest

from e3pose.output.report.overlay import write_movie
from e3pose.site.setup.program import SetupServer, open_setup


@dataclass
class Asking:
    """A set-up and a client of its API.

    Attributes:
        server: that serves.
        client: shows its token.
        root: folder in which it was started.
    """

    server: SetupServer
    client: httpx.Client
    root: Path

    def get(self, path: str) -> httpx.Response:
        """Ask a question."""
        return self.client.get(f"/api/setup/{path}")

    def post(self, path: str, **body: object) -> httpx.Response:
        """Give an order."""
        return self.client.post(f"/api/setup/{path}", json=body)


@pytest.fixture
def asking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Asking]:
    monkeypatch.chdir(tmp_path)
    with open_setup(None, "127.0.0.1:0") as server:
        token = server.rules.tokens.write
        headers = {"Authorization": f"Bearer {token}"}
        with httpx.Client(base_url=f"http://{server.address}", headers=headers, timeout=60) as made:
            yield Asking(server, made, tmp_path)


@pytest.fixture
def films(asking: Asking) -> tuple[Path, ...]:
    """Two films of two seconds, of joints that the detector `drawn` reads, in the root."""
    folder = asking.root / "films"
    folder.mkdir()
    images = [np.full((48, 64, 3), 20 * number, dtype=np.uint8) for number in range(1, 11)]
    paths = (folder / "a.mp4", folder / "b.mp4")
    for path in paths:
        write_movie(path, images, 5.0)
    return paths
