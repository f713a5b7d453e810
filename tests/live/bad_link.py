"""Links between cameras and their edge that lose, delay, and are cut: real ones, and a stand-in."""

from __future__ import annotations

import contextlib
import random
import socket
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence

NAMESPACE, HERE, THERE = "e3pose-test", "e3pose-a", "e3pose-b"
EDGE, AWAY = "10.213.77.1", "10.213.77.2"
INSIDE = ("ip", "netns", "exec", NAMESPACE)
FAR_S, FAR_LOSS = 0.15, 0.01  # each way, of a link to a site that is far away
RESEND_S = 0.2  # what TCP waits, at least, before it sends again what was lost


class Netem:
    """A link to another network namespace, which the kernel lets misbehave.

    Attributes:
        host: where the edge listens.
        inside: the command that runs a camera at the far end.
    """

    host: str = EDGE
    inside: Sequence[str] = INSIDE

    def port_for(self, port: int) -> int:
        """Return the port at which cameras find the edge that listens on one."""
        return port

    def far(self) -> None:
        """Lose 1 % and delay by 300 ms there and back from now on."""
        self._behave("delay", f"{FAR_S}s", "loss", f"{FAR_LOSS:.0%}")

    def cut(self) -> None:
        self._behave("loss", "100%")

    def heal(self) -> None:
        self._behave("delay", "1ms")

    def _behave(self, *how: str) -> None:
        _run("tc", "qdisc", "replace", "dev", HERE, "root", "netem", *how)
        _run(*INSIDE, "tc", "qdisc", "replace", "dev", THERE, "root", "netem", *how)


class Relay:
    """Passes on what comes, late as a far link and repeated sending make it, or not at all.

    In place of `Netem`. Over a namespace the link itself is cut; otherwise the relay holds back.
    """

    def __init__(self, host: str, inside: Sequence[str]) -> None:
        self.host, self.inside = host, inside
        self._delay_s, self._loss = 0.0, 0.0
        self._open = threading.Event()
        self._open.set()
        self._rng = random.Random(1)
        self._listener = socket.create_server((host, 0))

    def port_for(self, port: int) -> int:
        threading.Thread(target=self._accept, args=(port,), daemon=True).start()
        return int(self._listener.getsockname()[1])

    def far(self) -> None:
        self._delay_s, self._loss = FAR_S, FAR_LOSS

    def cut(self) -> None:
        if self.inside:
            _everything_to("nobody")
        else:
            self._open.clear()

    def heal(self) -> None:
        self._delay_s, self._loss = 0.0, 0.0
        if self.inside:
            _everything_to("somebody")
        self._open.set()

    def close(self) -> None:
        self._open.set()
        self._listener.close()

    def _accept(self, port: int) -> None:
        with contextlib.suppress(OSError):  # until the listener is closed
            while True:
                near, _ = self._listener.accept()
                try:
                    far = socket.create_connection((self.host, port), timeout=5.0)
                except OSError:
                    near.close()
                    continue
                far.settimeout(None)
                for one, other in ((near, far), (far, near)):
                    one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    threading.Thread(target=self._pump, args=(one, other), daemon=True).start()

    def _pump(self, source: socket.socket, target: socket.socket) -> None:
        """Pass on in order, as TCP does: what follows a late piece is late as well."""
        due: list[tuple[float, bytes]] = []
        change = threading.Condition()

        def send() -> None:
            with contextlib.suppress(OSError):
                while True:
                    with change:
                        while not due:
                            change.wait()
                        due_s, piece = due.pop(0)
                    if not piece:
                        break
                    time.sleep(max(0.0, due_s - time.monotonic()))
                    self._open.wait()
                    target.sendall(piece)
            for end in (source, target):
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
                end.close()

        threading.Thread(target=send, daemon=True).start()
        piece = b"x"
        while piece:
            try:
                piece = source.recv(65536)
            except OSError:
                piece = b""
            with change:
                due.append((time.monotonic() + self._late_s(), piece))
                change.notify()

    def _late_s(self) -> float:
        lost = self._rng.random() < self._loss
        return self._delay_s + RESEND_S * lost


BadLink = Netem | Relay


@contextlib.contextmanager
def bad_link() -> Iterator[BadLink]:
    """Make the most real link that this machine permits."""
    try:
        _run("ip", "netns", "add", NAMESPACE)
    except OSError:
        relay = Relay("127.0.0.1", ())
        yield relay
        relay.close()
        return
    try:
        _run("ip", "link", "add", HERE, "type", "veth", "peer", "name", THERE)
        _run("ip", "link", "set", THERE, "netns", NAMESPACE)
        _run("ip", "addr", "add", f"{EDGE}/24", "dev", HERE)
        _run("ip", "link", "set", HERE, "up")
        _run(*INSIDE, "ip", "addr", "add", f"{AWAY}/24", "dev", THERE)
        _run(*INSIDE, "ip", "link", "set", THERE, "up")
        netem = Netem()
        try:
            netem.heal()
        except OSError:  # a kernel without netem
            relay = Relay(EDGE, INSIDE)
            yield relay
            relay.close()
        else:
            yield netem
    finally:
        for command in (("ip", "link", "del", HERE), ("ip", "netns", "del", NAMESPACE)):
            with contextlib.suppress(OSError):
                _run(*command)


def _everything_to(whom: str) -> None:
    """Let both ends send to a machine that is not there: lost without a word, as in the air."""
    for inside, device, address in ((INSIDE, THERE, EDGE), ((), HERE, AWAY)):
        neighbour = (*inside, "ip", "neigh")
        if whom == "nobody":
            place = ("to", address, "lladdr", "02:00:00:00:00:99", "dev", device)
            _run(*neighbour, "replace", *place, "nud", "permanent")
        else:
            with contextlib.suppress(OSError):  # it was never cut
                _run(*neighbour, "del", address, "dev", device)


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    if done.returncode:
        raise OSError(f"{' '.join(command)}: {done.stderr.strip()[:200]}")
