"""Fetch the summaries of sites from their cursors: what was interrupted continues there."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from enum import Enum, auto

from msgspec.structs import replace as replace_field
from sqlalchemy import Engine

from e3pose.base.errors import InputError
from e3pose.base.rate_limit import Rate
from e3pose.store.database import REFUSALS, refusal_of
from e3pose.wire.access import Link
from e3pose.wire.codec import decode, encode
from e3pose.wire.network import open_network
from e3pose.wire.site_messages import OutboxPart, OutboxQuestion
from e3pose.wire.topics import of_outbox
from e3pose_hub.database import Cursor, cursor_of, keep, note_problem
from e3pose_hub.records import summaries_in, tombstones_in
from e3pose_hub.settings import Hub, holder_at
from e3pose_hub.users import users_of

Ask = Callable[[bytes], bytes | None]
ANSWER_S = 10.0
JOIN_S = 5.0
PAUSE_S = 0.25  # between two parts: a site answers four a second
NOTHING = OutboxQuestion()
TRIES = 3  # of a part that gets lost
SLOWEST = 16  # of a site that does not answer: the usual time between two questions times this
SOON = 0.25  # of it, after the first failure
AT_ONCE = 16  # sites that are asked at a time
TURN_S = 10.0  # of a site; then it is the turn of others that wait
SLOW_S = 2.0  # for a part: who takes longer is asked less often, as who does not answer
# Of each site: 60 days of many names at once, then some hundred times what a minute takes. Without
# such a bound one site could fill the disk of all.
MOST_BYTES, BYTES_PER_S = 200_000_000, 2000


class Outcome(Enum):
    """The result of the turn of a site."""

    WHOLE = auto()
    MORE = auto()  # is there
    SLOW = auto()
    FAILED = auto()


@dataclass(slots=True, eq=False)
class Turn:
    """The turn of a site, bounded in time and bytes.

    Attributes:
        site: its name.
        sizes: bounds the bytes of each site.
        now_s: a clock.
        parts: answers so far.
        whole: whether nothing is left to fetch.
    """

    site: str
    sizes: Rate
    now_s: Callable[[], float] = time.monotonic
    parts: int = 0
    whole: bool = False
    _begun_s: float = field(init=False)

    def __post_init__(self) -> None:
        self._begun_s = self.now_s()

    def over(self) -> bool:
        """Return whether it is the turn of others."""
        return self.now_s() - self._begun_s > TURN_S

    def take(self, size: int) -> None:
        """Count a part; raise `InputError` where the site brings too much."""
        self.parts += 1
        if wait_s := self.sizes.wait_s(self.site, size):
            found = f"found more than {MOST_BYTES / 1e6:.0f} MB and what a site may add to it"
            raise InputError(f"{self.site}: summaries: {found}, expected more in {wait_s:.0f} s")

    def outcome(self) -> Outcome:
        """Return the result."""
        if self.now_s() - self._begun_s > SLOW_S * (self.parts + 1):
            return Outcome.SLOW
        return Outcome.WHOLE if self.whole else Outcome.MORE


def pull(
    engine: Engine,
    site: str,
    ask: Ask,
    pause: Callable[[], object],
    now_ns: int,
    turn: Turn | None = None,
    question: OutboxQuestion = NOTHING,
) -> int:
    """Fetch the new summaries of a site; return how many.

    Args:
        engine: of the hub's database.
        site: its name.
        ask: sends a question to it and returns the answer, None where none came.
        pause: waits between two questions.
        now_ns: the time.
        turn: bounds it; None for no bounds.
        question: with the users who may open the site's page.

    Raises:
        InputError: when the site does not answer, or sends what no edge sends.
    """
    with engine.connect() as connection:
        cursor = cursor_of(connection, site)
    count = 0
    while turn is None or not turn.over():
        part = _asked(site, ask, pause, replace_field(question, after=cursor.taken), turn)
        if part.problem:
            raise InputError(f"{site}: {part.problem}")
        if part.begun_ns != cursor.begun_ns:  # another outbox: from its beginning
            begun = Cursor(part.begun_ns, 0, cursor.lost)
            again, cursor = cursor.taken > 0, begun
            if again:
                pause()
                continue
        rows = summaries_in(part, cursor.taken, site)
        deletions = tombstones_in(part, cursor.taken, site)
        came = [*(row.number for row in rows), *(one.number for one in deletions)]
        taken = max(came) if came else max(part.newest, cursor.taken)
        gone = taken - cursor.taken - len(came)
        cursor = replace(cursor, taken=taken, lost=cursor.lost + max(gone, 0))
        keep(engine, site, rows, cursor, now_ns, deletions)
        count += len(rows)
        if cursor.taken >= part.newest:
            if turn is not None:
                turn.whole = True
            break
        pause()
    return count


def _asked(
    site: str,
    ask: Ask,
    pause: Callable[[], object],
    question: OutboxQuestion,
    turn: Turn | None,
) -> OutboxPart:
    for _ in range(TRIES):
        answer = ask(encode(question))
        if answer is not None:
            if turn is not None:
                turn.take(len(answer))
            return decode(answer, OutboxPart, site)
        if turn is not None and turn.over():
            break
        pause()
    wanted = "an edge of that name with a [store], and a certificate of keys add --hub"
    raise InputError(f"{site}: no answer, expected {wanted}")


def _unreachable(link: Link) -> str:
    """Return the message for a link where nothing lets the hub in."""
    wanted = "a running edge"
    if link.certificates is not None:
        wanted += f" that accepts the certificate in {link.certificates.certificate.parent}"
    return f"no connection to {link.endpoint}, expected {wanted}"


def wait_s(every_s: float, failures: int, share: float) -> float:
    """Return seconds until a site is asked again, never all at once.

    That is soon after one failure, as a busy machine makes now and then, and longer after each
    further one.

    Args:
        every_s: the usual time.
        failures: in a row.
        share: random, [0, 1).
    """
    times = min(2.0 ** (failures - 1) * SOON, SLOWEST) if failures else 1.0
    return times * every_s * (0.5 + share)


class Pulling:
    """Asks all sites of a hub, again and again, until it is closed. Use it as a context manager."""

    def __init__(self, hub: Hub, engine: Engine, said: Callable[[str, str], None]) -> None:
        """Start.

        Args:
            hub: its file.
            engine: of its database.
            said: called with a site and why it cannot be asked, or that it can again.
        """
        self._hub, self._engine, self._said = hub, engine, said
        self._users, self._stop = users_of(hub), threading.Event()
        self._pool = ThreadPoolExecutor(AT_ONCE, "pull")
        self._problems: dict[str, str] = {}
        self._sizes = Rate(BYTES_PER_S, MOST_BYTES, time.monotonic)
        self._thread = threading.Thread(target=self._run, name="hub")
        self._thread.start()

    def __enter__(self) -> Pulling:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._pool.shutdown(cancel_futures=True)

    def _run(self) -> None:
        every_s, now_s = self._hub.every_s, time.monotonic()
        # Not all at once when the hub starts: within the first ten seconds.
        due = {site: now_s + random.random() * min(every_s, 10.0) for site in self._hub.sites}
        failures = dict.fromkeys(due, 0)
        running = dict[str, Future[Outcome]]()
        while not self._stop.is_set():
            now_s = time.monotonic()
            for site in [site for site, future in running.items() if future.done()]:
                found = running.pop(site).result()
                went_well = found in (Outcome.WHOLE, Outcome.MORE)
                failures[site] = 0 if went_well else failures[site] + 1
                wait = wait_s(every_s, failures[site], random.random())
                due[site] = now_s + (0.0 if found is Outcome.MORE else wait)
            for site, at_s in due.items():
                if at_s <= now_s and site not in running:
                    running[site] = self._pool.submit(self._pull, site)
            self._stop.wait(0.05)

    def _pull(self, site: str) -> Outcome:
        """Ask a site; return the result of its turn."""
        problem, turn = "", Turn(site, self._sizes)
        try:
            link = self._hub.link(site)
            transport = open_network(link)
            try:
                until_s = time.monotonic() + JOIN_S
                while not transport.connected() and time.monotonic() < until_s:
                    if self._stop.wait(0.05):
                        return Outcome.FAILED
                if not transport.connected():
                    raise InputError(f"{site}: {_unreachable(link)}")
                topic = of_outbox(site, holder_at(link))
                asked = self._users.page_tokens(site, self._hub.sites[site].group)
                pull(
                    self._engine, site, lambda q: transport.ask(topic, q, ANSWER_S),
                    lambda: self._stop.wait(PAUSE_S), time.time_ns(), turn,
                    OutboxQuestion(0, *asked),
                )  # fmt: skip
            finally:
                transport.close()
        except InputError as error:
            problem = str(error)
        except (*REFUSALS, OSError) as error:
            problem = f"database: {refusal_of(error)}"
        except Exception as error:  # one site must not end the others
            problem = f"{type(error).__name__}: {error}"
        self._tell(site, problem)
        return Outcome.FAILED if problem else turn.outcome()

    def _tell(self, site: str, problem: str) -> None:
        if problem:
            try:
                note_problem(self._engine, site, problem)
            except (*REFUSALS, OSError):
                pass  # a database that takes nothing is the problem
        if problem != self._problems.get(site, ""):
            self._problems[site] = problem
            self._said(site, problem)
