"""A site with certificates on loopback."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Literal

from tests.ports import free_port

from e3pose.wire.access import Kind, Link
from e3pose.wire.endpoint import Endpoint, read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in, init_keys, read_roll, revoke_keys
from e3pose.wire.network import NetworkTransport, open_network

HOLDERS: dict[Kind, tuple[str, ...]] = {
    "camera": ("cam1", "cam2", "cam3"),
    "viewer": ("wall", "house"),
    "operator": ("desk",),
    "hub": ("house", "garden"),
    "router": ("hall",),
}


class Site:
    """A site with certificates, whose programs are opened by name: at its edge, or at a router."""

    def __init__(self, folder: Path, name: str = "lab") -> None:
        now = datetime.datetime.now(datetime.timezone.utc)
        self.folder, self.name = folder, name
        self.port, self.router_port = free_port(), free_port()
        self.open: list[NetworkTransport] = []
        init_keys(folder, name, [], now)
        for kind, holders in HOLDERS.items():
            for holder in holders:
                add_keys(folder, holder, now, kind=kind)
        revoke_keys(folder, "cam3")

    def edge(self) -> NetworkTransport:
        files = certificates_in(self.folder, "edge")
        link = Link("edge", self.name, at("127.0.0.1", self.port), files)
        return self.keep(open_network(link, read_roll(self.folder)))

    def router(self) -> NetworkTransport:
        place = self.folder / "routers" / "hall"  # all that is carried there
        here, files = at("127.0.0.1", self.router_port), certificates_in(place, "router")
        link = Link("router", self.name, here, files, (at("localhost", self.port),))
        return self.keep(open_network(link, read_roll(place)))

    def camera(self, name: str, port: int = 0) -> NetworkTransport:
        return self._joined("camera", name, port)

    def viewer(self, port: int = 0) -> NetworkTransport:
        return self._joined("viewer", "wall", port)

    def operator(self, port: int = 0) -> NetworkTransport:
        return self._joined("operator", "desk", port)

    def hub(self, name: str = "house") -> NetworkTransport:
        return self._joined("hub", name, 0)

    def _joined(self, kind: Kind, name: str, port: int) -> NetworkTransport:
        files = certificates_in(self.folder / f"{kind}s" / name, kind)
        role: Literal["camera", "viewer"] = "camera" if kind == "camera" else "viewer"
        return self.keep(
            open_network(Link(role, self.name, at("localhost", port or self.port), files))
        )

    def keep(self, transport: NetworkTransport) -> NetworkTransport:
        self.open.append(transport)
        return transport


def at(host: str, port: int) -> Endpoint:
    return read_endpoint(f"tls/{host}:{port}")
