"""The two minutes in which a site lets one camera join: see `e3pose.wire.keys.joining`."""

from __future__ import annotations

import asyncio
import datetime
import secrets
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

from e3pose.base.bounded import read_bytes
from e3pose.base.errors import InputError, reason_of
from e3pose.base.installing import not_installed
from e3pose.base.listener import Bounds, Listener, open_socket, port_in_use
from e3pose.base.rate_limit import Rate
from e3pose.model.camera_fields import check_camera_id
from e3pose.settings.site_file import SiteTable
from e3pose.site.phones import AUTHORITY, addresses
from e3pose.wire.codec import one_line
from e3pose.wire.endpoint import is_loopback
from e3pose.wire.keys import joining
from e3pose.wire.keys.folder import MAX_PEM_BYTES, add_keys, read_roll, revoke_keys

BOUNDS = Bounds(connections=16, per_address=4)
TRY_S, LINGER_S = 20.0, 2.0  # for the rest of a try, and for its last line to leave
CODES, EVERY_S = 5, 30.0  # codes at once, and seconds to each further one


class _Guest(asyncio.StreamReaderProtocol):
    """A connection; one that tries the code is not closed for others."""

    def __init__(self, meet: Callable[..., Any]) -> None:
        loop = asyncio.get_running_loop()
        super().__init__(asyncio.StreamReader(joining.MAX_LINE, loop), meet, loop)
        self.waiting_since_s: float | None = loop.time()


@dataclass(slots=True, eq=False)
class Joining:
    """Lets cameras join a site, one by each code.

    Attributes:
        site: its file.
        cameras: who may join; None for any name that has no certificate.
        log: called with a line about each try.
        code: that is shown and was not tried; empty for none.
        said: what became of the last code, in words; empty while one is shown.
        joined: the camera that joined by the last code; empty if none did.
    """

    site: SiteTable
    cameras: Sequence[str] | None
    log: Callable[[str], object]
    code: str = ""
    said: str = ""
    joined: str = ""
    _until_s: float = 0.0
    _rate: Rate = field(default_factory=lambda: Rate(1 / EVERY_S, CODES, time.monotonic))
    _door: asyncio.Task[None] | None = None
    _tried: asyncio.Event = field(default_factory=asyncio.Event)

    def possible(self) -> bool:
        """Return whether the site has an authority, and its key on this machine."""
        link = self.site.link
        keyed = link.keys is not None and (link.keys / AUTHORITY[1]).is_file()
        return link.endpoint.encrypted and keyed

    def body(self) -> dict[str, Any]:
        """Return the code, for how long somebody listens, and the cameras without certificates."""
        listens = self._door is not None and not self._door.done()
        left_s = max(1.0, self._until_s - time.monotonic()) if listens else 0.0
        known = read_roll(self.site.keys).cameras
        waiting = [camera for camera in self.cameras or () if camera not in known]
        return {"code": self.code, "left_s": left_s, "said": self.said, "waiting": waiting}

    def open(self) -> asyncio.Task[None]:
        """Show a code and listen; return the task, which ends once it was tried or is too old.

        Raises:
            InputError: while another code is shown, for too many, and where nobody can listen.
        """
        if find_spec("spake2") is None:
            raise InputError(not_installed("spake2", "join"))
        if self.body()["left_s"]:
            raise InputError("a code is shown already: use it, or wait until it is too old")
        endpoint = self.site.link.endpoint
        if not endpoint.here_alone and all(is_loopback(host) for host in self._hosts()):
            raise InputError(
                "the certificate of the edge is for this machine alone, expected one for a name "
                "that cameras know: `e3pose keys init` with --host"
            )
        if wait_s := self._rate.wait_s(""):
            raise InputError(f"too many codes: the next one in {wait_s:.0f} s")
        port = joining.join_port(endpoint.port)
        try:
            listening = open_socket(endpoint.host, port)
        except OSError:
            raise InputError(port_in_use(port, "and try again")) from None
        self.code = f"{secrets.randbelow(10**6):06d}"
        self.said, self.joined, self._tried = "", "", asyncio.Event()
        self._until_s = time.monotonic() + joining.CODE_S
        self._door = asyncio.create_task(self._listen(listening))
        return self._door

    async def _listen(self, listening: socket.socket) -> None:
        at = listening.getsockname()
        door = Listener(listening, lambda: _Guest(self._meet), BOUNDS).run()
        beside = [asyncio.create_task(door), asyncio.create_task(self._announce(*at[:2]))]
        try:
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._tried.wait(), self._until_s - time.monotonic())
            if self.code:
                self.said = "No camera typed the code in time."
            else:
                await self._tried.wait()
        finally:
            self.code = ""
            for task in beside:
                task.cancel()
            try:
                await asyncio.gather(*beside, return_exceptions=True)
            finally:
                listening.close()

    async def _announce(self, host: str, port: int) -> None:
        """Say in the network that the site lets a camera join; where that fails, log it."""
        here = [host] if host not in ("0.0.0.0", "::") else addresses()[:-1] or ["127.0.0.1"]
        name = f"{self.site.name[:40]}-{secrets.token_hex(3)}"
        said: dict[str, Any] = {"properties": {"site": self.site.name}, "parsed_addresses": here}
        try:
            from zeroconf.asyncio import AsyncServiceInfo, AsyncZeroconf

            info = AsyncServiceInfo(
                joining.SERVICE, f"{name}.{joining.SERVICE}", port, server=f"{name}.local.", **said
            )
            async with AsyncZeroconf(interfaces=here) as network:
                await network.async_register_service(info)
                await asyncio.Event().wait()
        except Exception as error:  # the library has its own, beside those of sockets
            self.log(f"join: not announced ({reason_of(error)}): cameras need --endpoint")

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Talk with who connected; the first whole message of a camera uses the code up."""
        tries, why = False, ""
        try:
            hello = joining.read_line(await reader.readline())
            check_camera_id(hello.name)
            if not self.code:
                raise InputError("no code is shown, or it was tried: have the site show a new one")
            code, self.code, tries = self.code, "", True
            guest: Any = writer.transport.get_protocol()
            guest.waiting_since_s = None
            await asyncio.wait_for(self._try(code, hello.name, hello.pake, reader, writer), TRY_S)
        except InputError as error:
            why = one_line(str(error))
            writer.write(joining.line_of(problem=why))
        except (OSError, ValueError, asyncio.TimeoutError):  # too long, cut, or silent
            why = "it did not finish"
        finally:
            writer.close()
            with suppress(OSError, asyncio.TimeoutError):
                await asyncio.wait_for(writer.wait_closed(), LINGER_S)
            if tries:
                where = (writer.get_extra_info("peername") or ("?",))[0]
                self.said = f"The code is used up, by {where}: {why}." if why else self.said
                self.log(f"join: {self.said}")
                self._tried.set()

    async def _try(
        self, code: str, name: str, pake: bytes, reader: Any, writer: asyncio.StreamWriter
    ) -> None:
        mine, key = joining.answer(code, name, pake)
        writer.write(joining.line_of(pake=mine))
        public = joining.unseal(
            key, joining.TO_EDGE, joining.read_line(await reader.readline()).sealed
        )

        async def seal(**said: Any) -> None:
            sealed = key.encrypt(joining.TO_CAMERA, joining.line_of(**said), None)
            writer.write(joining.line_of(sealed=sealed))
            await writer.drain()

        admitted = asyncio.ensure_future(asyncio.to_thread(self._admit, name, public))
        try:
            said = await asyncio.shield(admitted)
        except asyncio.CancelledError:  # the try is over, the thread goes on
            with suppress(InputError, OSError):
                await admitted
                await asyncio.to_thread(revoke_keys, self.site.keys, name, "camera")
            raise
        except (InputError, OSError) as error:
            problem = one_line(reason_of(error))
            self.said = f"{name} got no certificate: {problem}."
            await seal(problem=problem)
            return
        try:
            await seal(**said)
            kept = joining.read_line(await reader.readline())
            joining.unseal(key, joining.KEPT, kept.sealed)
        except BaseException:  # the camera may have kept nothing: its name is free again
            await asyncio.to_thread(revoke_keys, self.site.keys, name, "camera")
            raise
        self.joined, self.said = name, f"{name} joined."
        writer.write(joining.line_of())

    def _admit(self, name: str, public: bytes) -> dict[str, Any]:
        """Certify a camera as `e3pose keys add` does; return its files, the port and the hosts."""
        if name in read_roll(self.site.keys).cameras or name not in (self.cameras or [name]):
            free = ", ".join(self.body()["waiting"]) or f"after `e3pose keys revoke {name}`, {name}"
            raise InputError("camera", name, f"one without a certificate: {free}")
        now = datetime.datetime.now(datetime.timezone.utc)
        place = add_keys(self.site.keys, name, now, public=public)
        files = {"authority": place / AUTHORITY[0], "certificate": place / "camera.pem"}
        said = {key: read_bytes(path, MAX_PEM_BYTES).decode() for key, path in files.items()}
        port = self.site.link.endpoint.port
        return {"site": self.site.name, "port": port, "hosts": tuple(self._hosts()), **said}

    def _hosts(self) -> list[str]:
        from e3pose.wire.keys.authority import hosts_of

        return hosts_of(read_bytes(self.site.keys / "edge.pem", MAX_PEM_BYTES))


def let_one_join(site: SiteTable, say: Callable[[str], object]) -> None:
    """Show a code of a site, and wait until a camera joined.

    Args:
        site: its file.
        say: called with lines for the person.

    Raises:
        InputError: where that is not possible here, and when none joined, with the reason.
    """
    door = Joining(site, None, say)
    if not door.possible():
        wanted = "a tls endpoint, and keys with authority.key of `e3pose keys init` in [link]"
        raise InputError("link", "no way to sign certificates", wanted, str(site.path))

    async def let() -> None:
        ended = door.open()
        say(f"Type at the camera, within two minutes: {door.code}")
        await ended

    asyncio.run(let())
    if not door.joined:
        raise InputError(door.said)
