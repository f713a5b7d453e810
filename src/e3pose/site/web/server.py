"""Serve a page until it is closed: its https, the bounds of its connections."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from starlette.types import ASGIApp

from e3pose.base.errors import Fault, InputError
from e3pose.base.listener import Bounds
from e3pose.base.version import Watched
from e3pose.site.run import run_until_stopped
from e3pose.site.serving import CONNECTIONS, PER_ADDRESS, Serving
from e3pose.site.web.access import Door, Judge, Rules

P = TypeVar("P", bound="PageServer")


@dataclass(slots=True, eq=False)
class PageServer:
    """A page at work, until it is closed. Use it as a context manager.

    Attributes:
        url: of it.
        serving: its server.
        ends: closes the server, then what the page works with.
        watched: what is read again when its files were replaced.
    """

    url: str
    serving: Serving
    ends: ExitStack
    watched: tuple[Watched, ...]

    def __enter__(self: P) -> P:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def running(self) -> bool:
        """Return whether it serves; also loads replaced files, so call it often."""
        for files in self.watched:
            files.update()
        return self.serving.running()

    def run(self, for_s: float | None = None) -> None:
        """Serve until Ctrl-C, SIGTERM, or for a number of seconds.

        Raises:
            Fault: when its server ended by itself.
        """
        run_until_stopped(self.running, for_s)
        if not self.serving.running():
            raise Fault("the server of the page ended by itself")

    def close(self) -> None:
        """End."""
        self.ends.close()


def serve(
    app: ASGIApp,
    rules: Rules[Judge],
    listening: socket.socket,
    secure: ssl.SSLContext | None = None,
) -> Serving:
    """Serve the application of a page behind its door.

    Args:
        app: without its door.
        rules: of the door.
        listening: where; closed at the end.
        secure: of https; None for plain http.
    """
    bounds = Bounds(CONNECTIONS, PER_ADDRESS, proxies=rules.proxies)
    return Serving(Door(app, rules), listening, bounds, secure)


def https_of(
    files: tuple[Path, Path], report: Callable[[str], object]
) -> tuple[ssl.SSLContext, Watched]:
    """Return the https context of a page, and a function that loads a renewed certificate.

    Args:
        files: the certificate and its key.
        report: called with whether other files are used; if not, those before stay in use.

    Raises:
        OSError: for files that cannot be used.
    """
    secure = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)

    def renew() -> None:
        try:  # on another one first: a key that does not fit would make this one useless
            ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(*files)
            secure.load_cert_chain(*files)
        except OSError as error:
            raise InputError(f"cannot be used, the one before is: {error}") from None
        report("certificate of the page renewed")

    renewal = Watched(files, renew, lambda why: report(f"certificate of the page: {why}"))
    secure.load_cert_chain(*files)
    return secure, renewal
