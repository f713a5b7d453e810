"""Follow the status and poses that a running edge publishes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from e3pose.base.errors import InputError
from e3pose.base.quantities import shell
from e3pose.settings.site_file import SiteTable
from e3pose.wire import topics
from e3pose.wire.access import Kind, Link
from e3pose.wire.codec import decode
from e3pose.wire.keys.folder import holder, valid_certificates
from e3pose.wire.site_messages import Poses, Status
from e3pose.wire.transport import Transport

ANY_HOST = ("0.0.0.0", "[::]", "*")
LOCAL_OPERATOR = "local"


@dataclass(eq=False)
class Follower:
    """Keeps the newest status and poses of a site.

    Attributes:
        site: its name.
        status: the newest; None before the first.
        poses: the newest; None before the first.
        problem: what was wrong with the newest message that made no sense.
        fresh: set by each message.
        delayed: whether to follow the smoothed poses that come later, in place of those at once.
    """

    site: str
    status: Status | None = None
    poses: Poses | None = None
    problem: str = ""
    fresh: threading.Event = field(default_factory=threading.Event)
    delayed: bool = False

    def listen(
        self,
        transport: Transport,
        on_poses: Callable[[Poses], object] | None = None,
        on_status: Callable[[Status], object] | None = None,
        on_delayed: Callable[[Poses], object] | None = None,
    ) -> None:
        """Start to follow; the callbacks run on a thread of the transport.

        Args:
            transport: to the site.
            on_poses: called with the poses that are followed.
            on_status: called with each status.
            on_delayed: called with the smoothed poses as well, beside those at once.
        """

        def take_status(_topic: str, payload: bytes) -> None:
            try:
                self.status = decode(payload, Status, "edge")
            except InputError as error:
                self.problem = str(error)
                return
            if on_status is not None:
                on_status(self.status)
            self.fresh.set()

        def take_poses(_topic: str, payload: bytes) -> None:
            try:
                self.poses = decode(payload, Poses, "edge")
            except InputError as error:
                self.problem = str(error)
                return
            if on_poses is not None:
                on_poses(self.poses)

        def take_delayed(_topic: str, payload: bytes) -> None:
            with suppress(InputError):  # as a site that sends none
                assert on_delayed is not None
                on_delayed(decode(payload, Poses, "edge"))

        transport.subscribe(topics.of_site(self.site, "status"), take_status)
        which = "poses-delayed" if self.delayed else "poses"
        transport.subscribe(topics.of_site(self.site, which), take_poses)
        if on_delayed is not None:
            transport.subscribe(topics.of_site(self.site, "poses-delayed"), take_delayed)


def operator_of(link: Link) -> str | None:
    """Return the operator of a link; None for a viewer's.

    Where a site has no certificates, whoever reaches it operates it.

    Raises:
        InputError: for a certificate that cannot be read.
    """
    if link.certificates is None:
        return LOCAL_OPERATOR
    is_operator = link.certificates.certificate.name == "operator.pem"
    return holder(link.certificates) if is_operator else None


def status_of(link: Link, timeout_s: float) -> Status | None:
    """Return the status of a link's edge; None if it does not answer in time.

    Raises:
        InputError: when the network cannot be joined.
    """
    from e3pose.wire.network import open_network

    follower = Follower(link.site)
    with closing(open_network(link)) as transport:
        follower.listen(transport)
        follower.fresh.wait(timeout_s)
    return follower.status


def viewer_link(site: SiteTable, viewer: Path | None, operates: bool = False) -> Link:
    """Return the link of a viewer to a site.

    Args:
        site: its file.
        viewer: folder that `e3pose keys add NAME --viewer` or `--operator` made; on the edge
            server itself, the first viewer's certificate serves by default.
        operates: whether the first operator's serves in its place, where there is one.

    Raises:
        InputError: for certificates that cannot be used.
    """
    endpoint, certificates = site.link.endpoint, None
    here = endpoint.host in ANY_HOST  # where the edge listens everywhere, it is reached here
    if endpoint.encrypted:
        if viewer is None:
            folder = site.keys
            found = sorted((folder / "viewers").glob("*/viewer.pem"))
            found = sorted((folder / "operators").glob("*/operator.pem")) * operates + found
            if not found:
                raise InputError(
                    f"{folder}: found no viewer's certificate, expected one: "
                    f"e3pose keys add NAME --viewer --keys {shell(folder)}"
                )
            viewer = found[0].parent
        kind: Kind = "operator" if (viewer / "operator.pem").exists() else "viewer"
        certificates = valid_certificates(viewer, kind)
        here |= endpoint.host == "127.0.0.1"
    if here:
        endpoint = replace(endpoint, host="localhost")
    return Link("viewer", site.name, endpoint, certificates, insecure=site.link.insecure)
