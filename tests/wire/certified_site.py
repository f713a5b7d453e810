"""A site with certificates on loopback."""

from __future__ import annotations

import datetime
from pathlib import Path

from tests.ports import free_port

from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in, init_keys, read_roll, revoke_keys
from e3pose.wire.network import NetworkTransport, open_network


class Site:
    """A site with certificates, whose programs are opened by name."""

    def __init__(self, folder: Path) -> None:
        now = datetime.datetime.now(datetime.timezone.utc)
        self.folder, self.port = folder, free_port()
        self.open: list[NetworkTransport] = []
        init_keys(folder, "lab", [], now)
        for camera in ("cam1", "cam2", "cam3"):
            add_keys(folder, camera, now)
        add_keys(folder, "wall", now, kind="viewer")
        add_keys(folder, "desk", now, kind="operator")
        add_keys(folder, "house", now, kind="hub")
        add_keys(folder, "garden", now, kind="hub")
        revoke_keys(folder, "cam3")

    def edge(self) -> NetworkTransport:
        roll = read_roll(self.folder)
        link = Link(
            "edge",
            "lab",
            read_endpoint(f"tls/127.0.0.1:{self.port}"),
            certificates_in(self.folder, "edge"),
        )
        return self.keep(open_network(link, roll))

    def camera(self, name: str) -> NetworkTransport:
        files = certificates_in(self.folder / "cameras" / name, "camera")
        return self.keep(
            open_network(Link("camera", "lab", read_endpoint(f"tls/localhost:{self.port}"), files))
        )

    def viewer(self) -> NetworkTransport:
        files = certificates_in(self.folder / "viewers" / "wall", "viewer")
        return self.keep(
            open_network(Link("viewer", "lab", read_endpoint(f"tls/localhost:{self.port}"), files))
        )

    def operator(self) -> NetworkTransport:
        files = certificates_in(self.folder / "operators" / "desk", "operator")
        return self.keep(
            open_network(Link("viewer", "lab", read_endpoint(f"tls/localhost:{self.port}"), files))
        )

    def hub(self, name: str = "house") -> NetworkTransport:
        files = certificates_in(self.folder / "hubs" / name, "hub")
        return self.keep(
            open_network(Link("viewer", "lab", read_endpoint(f"tls/localhost:{self.port}"), files))
        )

    def keep(self, transport: NetworkTransport) -> NetworkTransport:
        self.open.append(transport)
        return transport
