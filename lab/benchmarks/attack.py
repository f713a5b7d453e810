"""Attack decoders, files and a live site on loopback, and print what it took.

python lab/benchmarks/attack.py                    # about ten minutes
ATTACK_SECONDS=60 python lab/benchmarks/attack.py  # or --seconds 60; --decodes bounds the fuzzing
python lab/benchmarks/attack.py --only lies        # or fuzz, files, live, clocks, tested

Everything is sent to 127.0.0.1, to programs that this one starts, and it ends by itself. What does
not hold at a live site is tried once more, as other programs may have taken the cores. The exit
code is 1 where something did not hold then either.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import re
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from attack_clocks import clocks
from attack_doors import after, doors, operator_of
from attack_inputs import GROWTH_MB, Result, fuzz, hostile_files
from attack_lies import Seen, got, tell, viewer
from e3pose.settings.site_file import load_site
from e3pose.site.follow import Follower, viewer_link
from e3pose.wire.access import Link, zenoh_config
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in, revoke_keys
from e3pose.wire.network import open_network
from live_site import Site, live_site, wait

# Shares of the time; what has none takes as long as it does.
SHARES = {"fuzz": 0.15, "files": 0.1, "live": 0.25, "lies": 0.5, "clocks": 0.0, "tested": 0.0}
TESTS = Path(__file__).parents[2] / "tests"
LARGE_BYTES = 100_000_000
IDLE = 200  # connections that say nothing
ENTRY_S = 60.0  # after which somebody who does not get in gives up
STEP_S = 0.05  # between two looks at the edge
RATE_SHARE = 0.9  # of the poses per second, and of the views in them, before it is attacked
FPS = 25.0
# Attacks that are tests, each with a site of its own; what needs root says so elsewhere.
TESTED = {
    "disk of a whole site full, then free": "live/test_full_disk.py::"
    "test_up_outlasts_a_disk_that_is_full_or_read_only[full]",
    "disk of a whole site turned read-only": "live/test_full_disk.py::"
    "test_up_outlasts_a_disk_that_is_full_or_read_only[read-only]",
    "no file may grow, all output closed": "live/test_full_disk.py::"
    "test_up_runs_where_no_file_can_grow_and_nothing_can_be_said",
    "`keys` killed at every step": "wire/keys/test_renewal.py::"
    "test_command_that_is_killed_leaves_whole_pairs_and_can_be_repeated",
    "port of the page taken": "site/web/test_program.py::"
    "test_default_port_that_is_taken_gives_way_to_the_next_free_one",
    "slots published, not stored": "edge/test_publisher.py",
    "exit code of every program": "cli/test_exit_codes.py",
    "passwords of cameras, planted": "live/test_planted_secrets.py",
    "passwords in addresses of all makers": "base/test_masking.py",
    "camera that cannot start": "site/test_up.py::"
    "test_program_that_never_works_ends_a_site_that_needs_it",
    "target of a stream that is away": "cli/test_streaming.py",
    "networks without an end": "detectors/test_hostile_networks.py",
    "archives that unpack to gigabytes": "recording/test_arrays.py",
    "trainer killed, hung, lying": "edge/learn/test_learner_faults.py",
    "bytes of streams on the wire": "site/streams/test_wire.py",
    "one bad item in each queue": "test_one_bad_item.py",
    "slow and failing receivers of notices": "site/streams/test_webhook.py",
    "user revoked at a hub": "hub/test_page_tokens.py",
    "the same with edge, page and hub at work": "live/test_hub_tokens.py",
    "questions to a hub without an end": "hub/test_questions.py",
    "a day deleted across a hub": "hub/test_forgotten.py",
    "upgrade of a store killed": "store/test_versions.py",
    "person forgotten, edge stopped": "site/test_traces.py",
    "an ONVIF camera that answers by drops": "site/setup/test_onvif.py",
    "images on the wire that nobody asked for": "live/test_on_the_wire.py",
    "script in a person's name": "live/test_view_names.py::test_a_name_runs_no_script",
}
HONEST = ("cam0", "cam1", "cam2")  # of four


class Target:
    """A live site with a camera that lies and one whose certificate was revoked."""

    def __init__(self, site: Site) -> None:
        self.site, self.keys = site, site.folder / "keys"
        endpoint = load_site(site.folder / "site.toml").link.endpoint
        self.port = endpoint.port
        add_keys(self.keys, "stray", datetime.datetime.now(datetime.timezone.utc))
        revoke_keys(self.keys, "stray")
        self.camera_id = "cam3"
        wait(6.0)  # the edge joins anew by the changed list

    def join(self, camera_id: str) -> Any:
        """Return a session with a camera's certificate and none of our programs' limits."""
        files = certificates_in(self.keys / "cameras" / camera_id, "camera")
        link = Link("camera", "bench", read_endpoint(f"tls/localhost:{self.port}"), files)
        config = zenoh_config(link)
        config["transport"] = {"link": {"tls": config["transport"]["link"]["tls"]}}
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))

    def tls(self, camera_id: str) -> ssl.SSLSocket:
        """Return a connection that has shown a camera's certificate, and no more."""
        files = certificates_in(self.keys / "cameras" / camera_id, "camera")
        context = ssl.create_default_context(cafile=str(files.authority))
        context.load_cert_chain(str(files.certificate), str(files.key))
        return context.wrap_socket(self.tcp(), server_hostname="localhost")

    def tcp(self) -> socket.socket:
        """Return a connection that has shown nothing."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=5.0)

    def connections(self) -> int:
        """Return how many connections the edge holds."""
        open_now = self.site.edge().net_connections("tcp")
        return sum(c.status == "ESTABLISHED" and c.laddr.port == self.port for c in open_now)

    def topic(self, camera_id: str, what: str) -> str:
        return f"e3pose/bench/camera/{camera_id}/{what}"

    def entry_s(self) -> float:
        """Return how long a viewer who comes now waits for its first status."""
        path, begun_s = self.site.folder / "site.toml", time.monotonic()
        transport = open_network(viewer_link(load_site(path), None))
        follower = Follower("bench")
        follower.listen(transport)
        follower.fresh.wait(ENTRY_S)
        transport.close()
        return time.monotonic() - begun_s


@dataclass(frozen=True)
class Pace:
    """What a viewer gets of the honest cameras, whatever slots the edge computes.

    Attributes:
        poses: with a view, per second.
        views: of honest cameras, per second.
    """

    poses: float
    views: float

    @classmethod
    def since(cls, seen: Seen, begun_s: float) -> Pace:
        now_s = time.monotonic()
        found = got(seen, set(HONEST), begun_s, now_s)
        slots = sum(begun_s <= at_s < now_s for at_s, *_ in list(seen.poses))
        return cls(found.poses, found.views * slots / (now_s - begun_s))

    def summary(self) -> str:
        return f"{self.poses:.1f} poses per second from {self.views:.1f} honest views"


def under(
    target: Target,
    seen: Seen,
    name: str,
    seconds: float,
    attack: Callable[[float], str],
    usual: Pace,
) -> Result:
    """Run an attack on a thread and look at the edge and a viewer meanwhile.

    Args:
        target: who is attacked.
        seen: what the viewer gets.
        name: of the attack.
        seconds: how long.
        attack: takes the time at which to end, and says what it did.
        usual: without an attack.
    """
    said: list[str] = []
    edge = target.site.edge()
    rss = most = edge.memory_info().rss
    begun_s = time.monotonic()
    thread = threading.Thread(
        target=lambda: said.append(attack(begun_s + seconds)), name=name, daemon=True
    )
    thread.start()
    while thread.is_alive() and time.monotonic() < begun_s + seconds + 30:
        most = max(most, edge.memory_info().rss)
        wait(STEP_S)
    found = Pace.since(seen, begun_s)
    most, left = max(most, edge.memory_info().rss), edge.memory_info().rss
    figures = (
        f"{said[0] if said else 'did not end'}; {found.summary()}, edge "
        f"{rss / 1e6:.0f} MB before, {most / 1e6:.0f} MB at most, {left / 1e6:.0f} MB after"
    )
    flows = found.poses > RATE_SHARE * usual.poses and found.views > RATE_SHARE * usual.views
    return Result(name, figures, bool(said) and flows and (most - rss) / 1e6 < GROWTH_MB)


def flood(target: Target, camera_id: str) -> Callable[[float], str]:
    """Say as much nonsense as fits on a link, below the topics of a camera."""

    def attack(until_s: float) -> str:
        session, sent = target.join(camera_id), 0
        nonsense = (b"garbage", b"\x92\x01\x91\xa4view", b"x" * 200_000, b"")
        begun_s = time.monotonic()
        while time.monotonic() < until_s:
            for payload in nonsense:
                for what in ("view", "heartbeat", "hello"):
                    session.put(target.topic(camera_id, what), payload)
                    sent += 1
        session.close()
        return f"{sent / (time.monotonic() - begun_s):.0f} messages per second"

    return attack


def large(target: Target, camera_id: str, sessions: int) -> Callable[[float], str]:
    """Send messages of 100 MB at once over some sessions."""

    def attack(until_s: float) -> str:
        sent, payload = [0] * sessions, zenoh.ZBytes(b"x" * LARGE_BYTES)

        def one(index: int) -> None:
            session = target.join(camera_id)
            while time.monotonic() < until_s:
                session.put(
                    target.topic(camera_id, "view"),
                    payload,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                )
                sent[index] += LARGE_BYTES
            session.close()

        threads = [threading.Thread(target=one, args=(i,), daemon=True) for i in range(sessions)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return f"{sum(sent) / 1e9:.1f} GB by {sessions} sessions"

    return attack


def garbage(target: Target) -> Callable[[float], str]:
    """Send noise in place of a handshake, and after one."""

    def attack(until_s: float) -> str:
        sent, opened, noise = 0, 0, os.urandom(2**20)
        record = b"\x16\x03\x01\x40\x00\x01\x00\xff\xff" + noise[: 2**14 - 4]
        while time.monotonic() < until_s:
            for payload, shown in ((noise, False), (record * 64, False), (noise, True)):
                with suppress(OSError):
                    connection = target.tls("stray") if shown else target.tcp()
                    with connection:
                        opened += 1
                        while time.monotonic() < until_s:
                            connection.sendall(payload)
                            sent += len(payload)
            wait(0.5)  # the listener of Zenoh rests for 0.1 s after each
        return f"{sent / 1e6:.0f} MB of noise over {opened} connections"

    return attack


def silence(target: Target) -> Callable[[float], str]:
    """Connect and say nothing; with a certificate, and without."""

    def attack(until_s: float) -> str:
        before = target.connections()
        held: list[socket.socket] = []
        with suppress(OSError):
            for index in range(IDLE):
                held.append(target.tls("stray") if index % 10 == 0 else target.tcp())
        opened, begun_s, waited_s = target.connections() - before, time.monotonic(), 0.0
        while time.monotonic() < until_s and target.connections() > before:
            # Those that time out keep others waiting: each costs the listener 0.1 s.
            waited_s = max(waited_s, target.entry_s())
            wait(STEP_S)
        left, took_s = target.connections() - before, time.monotonic() - begun_s
        for connection in held:
            connection.close()
        return (
            f"{opened} silent connections, {max(left, 0)} left after {took_s:.0f} s, a viewer "
            f"waited {waited_s:.1f} s at most for its first status"
        )

    return attack


def live(seconds: float) -> list[Result]:
    """Attack a site of four cameras and three people that runs at 25 slots per second."""
    with live_site(cameras=4, people=3, fps=FPS, page=True) as site, viewer(site) as seen:
        operator_of(site)
        target, begun_s = Target(site), time.monotonic()
        wait(max(5.0, seconds * 0.1))
        usual = Pace.since(seen, begun_s)
        results = [Result("site at rest", usual.summary(), usual.poses > RATE_SHARE * FPS)]
        attacks = (
            ("flood of a revoked camera", 0.15, flood(target, "stray")),
            ("flood of a camera", 0.15, flood(target, target.camera_id)),
            ("large messages of a revoked camera", 0.1, large(target, "stray", 4)),
            ("large messages of a camera", 0.1, large(target, target.camera_id, 4)),
            ("noise", 0.1, garbage(target)),
            ("silence", 0.3, silence(target)),
            *doors(site),
        )
        report(results[-1])
        for name, share, attack in attacks:
            results.append(under(target, seen, name, seconds * share, attack, usual))
            if not results[-1].held:  # by another program that took the cores, perhaps
                report(results.pop())
                again = f"{name}, a second time"
                results.append(under(target, seen, again, seconds * share, attack, usual))
            report(results[-1])
        results += after(site)
        report(results[-1])
        recovered = False
        end_s = time.monotonic() + 30
        while not recovered and time.monotonic() < end_s:
            status = site.follower.status
            recovered = status is not None and all(c.online for c in status.cameras)
            wait(STEP_S)
        results.append(
            Result("afterwards", "all cameras there" if recovered else "not all there", recovered)
        )
        crashed = "Traceback" in Path(site.folder / "edge.log").read_text()
        results.append(
            Result("log of the edge", "a traceback" if crashed else "no traceback", not crashed)
        )
        report(results[-2])
        report(results[-1])
    return results


def tested(words: str) -> list[Result]:
    """Run the attacks that are tests, those whose name or place matches."""
    results = []
    for name, place in TESTED.items():
        if not re.search(words, f"{name} {place}"):
            continue
        begun_s, command = time.monotonic(), [sys.executable, "-m", "pytest", "-q", "-rs"]
        ended = subprocess.run([*command, TESTS / place], capture_output=True, text=True)
        lines = ended.stdout.strip().splitlines()
        said = next((line for line in lines if line.startswith("SKIPPED")), lines[-1])
        figures = f"{said[:120]}; {time.monotonic() - begun_s:.0f} s"
        results.append(Result(name, figures, ended.returncode == 0))
        report(results[-1])
    return results


def report(result: Result) -> None:
    print(f"{'held  ' if result.held else 'FAILED'}  {result.name}: {result.figures}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=os.environ.get("ATTACK_SECONDS", "600"))
    parser.add_argument("--only", choices=SHARES, action="append", help="leave out the rest")
    parser.add_argument(
        "--tested", default="", help="of the tests, those whose name or file matches"
    )
    parser.add_argument("--decodes", type=float, default=5e6, help="messages to fuzz at most")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    wanted = options.only or list(SHARES)
    total = sum(SHARES[part] for part in wanted) or 1.0
    seconds = {part: options.seconds * SHARES[part] / total for part in wanted}
    results = []
    if "fuzz" in wanted:
        results.append(fuzz(seconds["fuzz"], int(options.decodes), options.seed))
        report(results[-1])
    if "files" in wanted:
        results.append(hostile_files(seconds["files"], options.seed))
        report(results[-1])
    if "live" in wanted:
        results += live(seconds["live"])
    if "lies" in wanted:
        results += tell(seconds["lies"], report)
    if "clocks" in wanted:
        results += clocks(report)  # takes as long as it does
    if "tested" in wanted:
        results += tested(options.tested)
    missed = [result.name for result in results if not result.held]
    busy, cores = os.getloadavg()[2], os.cpu_count() or 1
    print(f"{len(missed)} of {len(results)} did not hold; load {busy:.1f} on {cores} cores")
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
