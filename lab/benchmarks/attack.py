"""Attack decoders, files and a live site on loopback: what was tried, what must be, what was.

python lab/benchmarks/attack.py                    # 40 minutes; says how long is left
ATTACK_SECONDS=60 python lab/benchmarks/attack.py  # or --seconds 60; --decodes bounds the fuzzing
python lab/benchmarks/attack.py --only lies        # or fuzz, files, live, clocks, tested
python lab/benchmarks/attack.py --rows flood       # of live, lies and tested, rows that match
python lab/benchmarks/attack.py --write            # and write attack.md and security.md

Everything is sent to 127.0.0.1, to programs that this one starts, and it ends by itself. What a
site gives under an attack is compared with what the same site gave just before, so that a slower
machine changes both; what does not hold is tried once more. The exit code is 1 where something did
not hold then either.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import re
import shlex
import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import zenoh

from attack_clocks import clocks
from attack_doors import Attack, after, doors, operator_of
from attack_inputs import GROWTH_MB, SECOND, Report, Result, fuzz, hostile_files
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
# What each takes for 600 seconds on two cores that do nothing else.
TAKES_S = {"fuzz": 90, "files": 240, "live": 340, "lies": 660, "clocks": 380, "tested": 600}
ROOT = Path(__file__).resolve().parents[2]
TESTS, PAGE = ROOT / "tests", ROOT / "docs" / "research" / "security.md"
ROWS = Path(__file__).with_suffix(".md")  # every attack of the last run
TABLE = re.compile("(?<=<!-- attack -->\n\n).*?(?=\n<!-- end of attack -->)", re.DOTALL)
IDLE = 200  # connections that say nothing
ENTRY_S = 60.0  # after which somebody who does not get in gives up
STEP_S = 0.05  # between two looks at the edge
RATE_SHARE = 0.9  # of the poses per second, and of the views in them, without the attack
QUIET_S, SETTLE_S = 5.0, 2.0  # without an attack, before each; and before that
BACK_S = 30.0  # for all cameras to be there afterwards
FPS = 25.0
ROOTS = "needs root: "
# Attacks that are tests, each with a site of its own.
TESTED = {
    f"{ROOTS}disk of a whole site full, then free": "live/test_full_disk.py::"
    "test_up_outlasts_a_disk_that_is_full_or_read_only[full]",
    f"{ROOTS}disk of a whole site turned read-only": "live/test_full_disk.py::"
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
    "films, streams and sources without an end": "camera/test_never_answers.py",
    "phone that is a camera, attacked at work": "live/test_on_the_wire.py"
    "::test_the_phone_sends_on_and_the_site_goes_on",
    f"{ROOTS}every program, its output hung or closed, its disk full": "live/"
    "test_channel_faults.py",
    "archives that unpack to gigabytes": "recording/test_arrays.py",
    "trainer killed, hung, lying": "edge/learn/test_learner_faults.py",
    f"{ROOTS}bytes of streams on the wire": "site/streams/test_wire.py",
    "one bad item in each queue": "test_one_bad_item.py",
    "slow and failing receivers of notices": "site/streams/test_webhook.py",
    "user revoked at a hub": "hub/test_page_tokens.py",
    "the same with edge, page and hub at work": "live/test_outside.py"
    "::test_right_at_a_hub_opens_a_site_and_ends_there_when_it_is_revoked",
    "questions to a hub without an end": "hub/test_questions.py",
    "a day deleted across a hub": "hub/test_forgotten.py",
    "upgrade of a store killed": "store/test_versions.py",
    "person forgotten, edge stopped": "site/test_traces.py",
    "an ONVIF camera that answers by drops": "site/setup/test_onvif.py",
    "images on the wire that nobody asked for": "live/test_on_the_wire.py"
    "::test_cameras_send_no_image_unless_somebody_asks",
    "camera that joins by a code": "site/test_joining.py",
    "the same with edge, page and camera at work": "live/test_outside.py"
    "::test_camera_joins_by_the_code_of_the_page_and_works_at_once",
    "the same by a terminal of the edge": "live/test_outside.py"
    "::test_camera_joins_by_a_terminal_of_the_edge",
    "script in a person's name": "live/test_view_names.py::test_a_name_runs_no_script",
}
HONEST = ("cam0", "cam1", "cam2")  # of four


class Target:
    """A live site with a camera that lies and one whose certificate was revoked."""

    camera_id = "cam3"

    def __init__(self, site: Site) -> None:
        self.site, self.keys = site, site.folder / "keys"
        endpoint = load_site(site.folder / "site.toml").link.endpoint
        self.port = endpoint.port
        add_keys(self.keys, "stray", datetime.datetime.now(datetime.timezone.utc))
        revoke_keys(self.keys, "stray")
        wait(6.0)  # the edge joins anew by the changed list

    def config(self, camera_id: str) -> str:
        """Return how to join with a camera's certificate and none of our programs' limits."""
        files = certificates_in(self.keys / "cameras" / camera_id, "camera")
        link = Link("camera", "bench", read_endpoint(f"tls/localhost:{self.port}"), files)
        config = zenoh_config(link)
        config["transport"] = {"link": {"tls": config["transport"]["link"]["tls"]}}
        return json.dumps(config)

    def join(self, camera_id: str) -> Any:
        """Return a session with a camera's certificate."""
        return zenoh.open(zenoh.Config.from_json5(self.config(camera_id)))

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
    """Rates of poses and views of honest cameras at a viewer, whatever slots the edge computes.

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

    @classmethod
    def quiet(cls, seen: Seen) -> Pace:
        """Measure the pace without an attack, from now on."""
        wait(SETTLE_S)
        begun_s = time.monotonic()
        wait(QUIET_S)
        return cls.since(seen, begun_s)

    @classmethod
    def mean(cls, paces: list[Pace]) -> Pace:
        poses, views = ([getattr(one, each) for one in paces] for each in ("poses", "views"))
        return cls(sum(poses) / len(paces), sum(views) / len(paces))

    def keeps(self, usual: Pace) -> bool:
        """Return whether it is nearly what came without an attack."""
        poses, views = RATE_SHARE * usual.poses, RATE_SHARE * usual.views
        return self.poses > poses and self.views > views

    def summary(self) -> str:
        return f"{self.poses:.1f} poses per second from {self.views:.1f} honest views"


MUST_KEEP = f"at least {RATE_SHARE:.0%} of the poses and honest views without it"
MUST = f"{MUST_KEEP}; the edge grows by less than {GROWTH_MB:.0f} MB"


def under(
    target: Target,
    seen: Seen,
    name: str,
    seconds: float,
    rounds: int,
    attack: Attack,
    must: str,
) -> Result:
    """Run an attack on a thread and look at the edge and a viewer meanwhile, and before.

    Args:
        target: who is attacked.
        seen: what the viewer gets.
        name: of the attack.
        seconds: how long.
        rounds: in which it is done, with quiet before each.
        attack: takes the time at which to end, and says what it did; fails where it got through.
        must: what else must be.
    """
    said, broke, usual, found = list[str](), list[str](), list[Pace](), list[Pace]()

    def run(until_s: float) -> None:
        try:
            said.append(attack(until_s))
        except Exception as error:  # what this looks for
            broke.append(f"{type(error).__name__}: {error}")

    edge = target.site.edge()
    rss = most = edge.memory_info().rss
    for _ in range(rounds):
        usual.append(Pace.quiet(seen))
        begun_s = time.monotonic()
        end_s = begun_s + seconds / rounds
        thread = threading.Thread(target=run, args=(end_s,), daemon=True)
        thread.start()
        while thread.is_alive() and time.monotonic() < end_s + BACK_S:
            most = max(most, edge.memory_info().rss)
            wait(STEP_S)
        found.append(Pace.since(seen, begun_s))
    most, left = max(most, edge.memory_info().rss), edge.memory_info().rss
    came, without = Pace.mean(found), Pace.mean(usual)
    figures = (
        f"{(broke or said or ['it did not end'])[-1]}; {came.summary()}, without it "
        f"{without.summary()}; edge {rss / 1e6:.0f} MB before, {most / 1e6:.0f} MB at most, "
        f"{left / 1e6:.0f} MB after"
    )
    kept = came.keeps(without) and (most - rss) / 1e6 < GROWTH_MB
    held, share = len(said) == rounds and kept, came.poses / max(without.poses, 1e-9)
    return Result(name, figures, held, f"{MUST}{must}", share)


# What sends as fast as it can is a program of its own that takes what the site leaves of the cores:
# an attacker has its own, and a loop here would hold up the viewer, which counts the poses.
SENDER = """
import os, sys, threading, time, zenoh
config, place, seconds, kind, sessions = sys.argv[1:]
os.nice(19)
end_s, sent = time.monotonic() + float(seconds), [0] * int(sessions)
nonsense = (b"garbage", b"\\x92\\x01\\x91\\xa4view", b"x" * 200_000, b"")
large = zenoh.ZBytes(b"x" * (100_000_000 if kind == "large" else 0))
def send(index):
    session = zenoh.open(zenoh.Config.from_json5(config))
    while time.monotonic() < end_s:
        if kind == "large":
            block = zenoh.CongestionControl.BLOCK
            session.put(f"{place}/view", large, congestion_control=block)
            sent[index] += 1
            continue
        for payload in nonsense:
            for what in ("view", "heartbeat", "hello"):
                session.put(f"{place}/{what}", payload)
                sent[index] += 1
    session.close()
threads = [threading.Thread(target=send, args=(i,), daemon=True) for i in range(int(sessions))]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(sum(sent))
"""


def sender(target: Target, camera_id: str, kind: str, sessions: int) -> Attack:
    """Send nonsense below the topics of a camera, or messages of 100 MB, over some sessions."""

    def attack(until_s: float) -> str:
        begun_s, place = time.monotonic(), target.topic(camera_id, "")[:-1]
        words = target.config(camera_id), place, str(until_s - begun_s), kind, str(sessions)
        command = [sys.executable, "-c", SENDER, *words]
        ended = subprocess.run(command, capture_output=True, text=True, check=True)
        sent, spent_s = int(ended.stdout), time.monotonic() - begun_s
        if kind == "large":
            return f"{sent / 10:.1f} GB by {sessions} sessions"
        return f"{sent / spent_s:.0f} messages per second"

    return attack


def garbage(target: Target) -> Attack:
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


def silence(target: Target) -> Attack:
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
        said = (
            f"{opened} silent connections, {max(left, 0)} left after {took_s:.0f} s, a viewer "
            f"waited {waited_s:.1f} s at most for its first status"
        )
        assert left <= 0, said
        return said

    return attack


def live(seconds: float, words: str, report: Report) -> None:
    """Attack a site of four cameras and three people that runs at 25 slots per second."""
    with live_site(cameras=4, people=3, fps=FPS, page=True) as site, viewer(site) as seen:
        operator_of(site)
        target, cam = Target(site), Target.camera_id
        usual = Pace.quiet(seen)
        report(Result("site at rest", usual.summary(), usual.poses > 0, "poses come"))
        attacks: list[tuple[str, float, int, Attack, str]] = [
            ("flood of a revoked camera", 0.15, 3, sender(target, "stray", "flood", 1), ""),
            ("flood of a camera", 0.15, 3, sender(target, cam, "flood", 1), ""),
            ("large messages of a revoked camera", 0.1, 1, sender(target, "stray", "large", 4), ""),
            ("large messages of a camera", 0.1, 1, sender(target, cam, "large", 4), ""),
            ("noise", 0.1, 1, garbage(target), ""),
            ("silence", 0.3, 1, silence(target), "; no silent connection left at the end"),
            *((name, share, 1, attack, must) for name, share, attack, must in doors(site)),
        ]
        for name, share, rounds, attack, must in attacks:
            if not re.search(words, name):
                continue
            result = under(target, seen, name, seconds * share, rounds, attack, must)
            if not result.held:  # by another program that took the cores, perhaps
                report(replace(result, again=True))
                again = f"{name}{SECOND}"
                result = under(target, seen, again, seconds * share, rounds, attack, must)
            report(result)
        report(after(site))
        recovered, end_s = False, time.monotonic() + BACK_S
        while not recovered and time.monotonic() < end_s:
            status = site.follower.status
            recovered = status is not None and all(c.online for c in status.cameras)
            wait(STEP_S)
        found = Pace.quiet(seen)
        found = found if found.keeps(usual) else Pace.quiet(seen)
        figures = f"{'all' if recovered else 'not all'} cameras there, {found.summary()}"
        held = recovered and found.keeps(usual)
        report(Result("afterwards", figures, held, f"all cameras there, {MUST_KEEP}"))
        crashed = "Traceback" in Path(site.folder / "edge.log").read_text()
        said = "a traceback" if crashed else "no traceback"
        report(Result("log of the edge", said, not crashed, "no traceback"))


def tested(words: str, report: Report) -> None:
    """Run the attacks that are tests, those whose name or place matches."""
    for name, place in TESTED.items():
        if not re.search(words, f"{name} {place}"):
            continue
        begun_s, command = time.monotonic(), [sys.executable, "-m", "pytest", "-q", "-rs"]
        ended = subprocess.run([*command, TESTS / place], capture_output=True, text=True)
        lines = ended.stdout.strip().splitlines() or ["no output"]
        ran = " passed" in lines[-1]
        skipped = [line for line in lines if line.startswith("SKIPPED") and not ran]
        figures = f"{(skipped or lines[-1:])[0][:120]}; {time.monotonic() - begun_s:.0f} s"
        must = f"`tests/{place.partition('::')[0]}` passes"
        passed = ended.returncode == 0
        report(Result(name, figures, passed, must, left_out=bool(skipped) and passed))


@dataclass
class Course:
    """Results of the rows so far, and the time left for the others.

    Attributes:
        left_s: by part, what it takes; those that are over are not in it.
        parts: results by part.
    """

    left_s: dict[str, float]
    parts: dict[str, list[Result]] = field(default_factory=dict)
    _part: str = ""
    _begun_s: float = 0.0

    def begin(self, part: str) -> None:
        self.left_s.pop(self._part, None)
        self._part, self._begun_s = part, time.monotonic()
        print(f"-- {part}, {self.left_words()}", flush=True)

    def left_words(self) -> str:
        """Return how long the rest takes, in words."""
        took_s = time.monotonic() - self._begun_s
        left_s = sum(s for part, s in self.left_s.items() if part != self._part)
        left_s += max(self.left_s.get(self._part, 0.0) - took_s, 0.0)
        return f"about {left_s / 60:.0f} min left"

    def report(self, result: Result) -> None:
        """Take the result of a row, and say it in a line."""
        if not result.again:
            self.parts.setdefault(self._part, []).append(result)
        word = "held" if result.held else "AGAIN" if result.again else "FAILED"
        word = "left out" if result.left_out else word
        said = f"{word:8}  {result.name}; must be: {result.must}; was: {result.figures}"
        print(f"{said} ({self.left_words()})", flush=True)

    def rows(self, command: str) -> str:
        """Return the page of all rows."""
        lines = [_head(command), "", "| tried | must be | was |", "|---|---|---|"]
        for one in chain(*self.parts.values()):
            word = "**left out**: " if one.left_out else "" if one.held else "**did not hold**: "
            cells = (one.name, one.must, f"{word}{one.figures}")
            lines.append(f"| {' | '.join(' '.join(c.replace('|', '/').split()) for c in cells)} |")
        return "\n".join(["# What was tried last", "", *lines, ""])

    def sums(self, command: str) -> str:
        """Return the table of the page: a row for each part."""
        heads = "part", "held", "at the second try", "least poses, % of those just before"
        lines = [_head(command), "", f"| {' | '.join(heads)} |", "|---|---|---|---|"]
        for part, found in self.parts.items():
            tried = [one for one in found if not one.left_out]
            again = sum(one.name.endswith(SECOND) for one in tried)
            kept = [100 * one.kept for one in tried if one.kept == one.kept]
            cells = f"{sum(one.held for one in tried)} of {len(tried)} | {again}"
            lines.append(f"| `{part}` | {cells} | {f'{min(kept):.0f}' if kept else ''} |")
        return "\n".join([*lines, ""])


def _head(command: str) -> str:
    day, busy = datetime.date.today().isoformat(), os.getloadavg()[2]
    return f"{day}, {os.cpu_count()} cores, load {busy:.1f}: `{command}`"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=os.environ.get("ATTACK_SECONDS", "600"))
    parser.add_argument("--only", choices=SHARES, action="append", help="leave out the rest")
    parser.add_argument("--rows", default="", help="of live, lies and tested, those that match")
    parser.add_argument("--write", action="store_true", help=f"write {ROWS.name}, and {PAGE.name}")
    parser.add_argument("--decodes", type=float, default=5e6, help="messages to fuzz at most")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    wanted = options.only or list(SHARES)
    total = sum(SHARES[part] for part in wanted) or 1.0
    seconds = {part: options.seconds * SHARES[part] / total for part in wanted}
    course = Course({part: TAKES_S[part] * 1.0 for part in SHARES if part in wanted})
    parts: dict[str, Callable[[], object]] = {
        "fuzz": lambda: course.report(fuzz(seconds["fuzz"], int(options.decodes), options.seed)),
        "files": lambda: course.report(hostile_files(seconds["files"], options.seed)),
        "live": lambda: live(seconds["live"], options.rows, course.report),
        "lies": lambda: tell(seconds["lies"], options.rows, course.report),
        "clocks": lambda: clocks(course.report),
        "tested": lambda: tested(options.rows, course.report),
    }
    for part in list(course.left_s):
        course.begin(part)
        parts[part]()
    results = [*chain(*course.parts.values())]
    missed = [one.name for one in results if not one.held]
    left_out = sum(one.left_out for one in results)
    busy, cores = os.getloadavg()[2], os.cpu_count() or 1
    print(
        f"{len(missed)} of {len(results)} did not hold, {left_out} were left out; load "
        f"{busy:.1f} on {cores} cores" + "".join(f"\n  {name}" for name in missed)
    )
    if options.write:
        command = shlex.join(["python", "lab/benchmarks/attack.py", *sys.argv[1:]])
        ROWS.write_text(course.rows(command))
        PAGE.write_text(TABLE.sub(lambda _: course.sums(command), PAGE.read_text()))
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
