"""What a hub takes: keeping, asking, catching up; and what of it ends first.

    python lab/benchmarks/bench_hub.py                       # some minutes; a few hundred MB
    python lab/benchmarks/bench_hub.py --live 8 --days 3     # smaller
    python lab/benchmarks/bench_hub.py --database postgresql://USER@HOST/NAME
    python lab/benchmarks/bench_hub.py --only-live --live 1000 --tls

Sites are made up (`simulated_sites.py`); their stores, their answers over Zenoh, the hub that asks
and its database are the real ones, all on this machine. Keeping and asking are measured with
`--days` of three sites through the hub's own code; for questions these are copied under other
names, `--sites` of them for sums by the hour and `--whole` for minutes. `--live` sites are asked
over the network, with certificates of their own where `--tls` says so.
"""

from __future__ import annotations

import argparse
import datetime
import os
import socket
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import psutil
from sqlalchemy import Engine, func, select, text

from e3pose.edge.consumers import Consumers
from e3pose.site.outbox_answers import OutboxAnswers
from e3pose.store.database import writing_engine
from e3pose.store.delivery import Delivery
from e3pose.store.rows import NS, Run
from e3pose.wire.access import Link
from e3pose.wire.endpoint import read_endpoint
from e3pose.wire.keys.folder import add_keys, certificates_in, init_keys, read_roll
from e3pose.wire.network import open_network
from e3pose.wire.topics import of_outbox
from e3pose_hub.database import Cursor, hours, keep, open_hub, summaries
from e3pose_hub.overview import overview
from e3pose_hub.pull import ANSWER_S, AT_ONCE, PAUSE_S, Pulling, pull
from e3pose_hub.question import answer
from e3pose_hub.settings import Hub, holder_at, load_hub
from simulated_sites import BEGIN_NS, CAMERAS, records_of, summaries_of

PART = 100  # summaries of an answer
OUTBOX_DAYS = 60
SERVED = 125  # sites of one process
TIMED = 24  # sites that are asked one after the other
UNTIL_S = 600.0
QUESTIONS = {
    "person-hours of each site, by day": "SELECT site, time_ns / 86400000000000 AS day, "
    "sum(person_h) FROM hours GROUP BY site, day ORDER BY 3 DESC LIMIT 100",
    "watts of each site": "SELECT site, sum(joules) / sum(span_s) FROM hours GROUP BY site",
    "hour of the day with most people": "SELECT time_ns / 3600000000000 % 24, max(most_people) "
    "FROM hours GROUP BY 1",
}


def store_with(path: Path, site: str, seed: int, first: int, minutes: int) -> None:
    """Store summaries as the writer of an edge does."""
    run = Run(site, site, BEGIN_NS, 0.04, "coco17", ("nose",), CAMERAS, "e3pose bench")
    delivery = Delivery(f"sqlite:///{path}", summaries=10**6)
    rows = [("summaries", row) for row in summaries_of(seed, first, minutes)]
    for at in range(0, len(rows), 1000):
        delivery.commit(rows[at : at + 1000], run)
    delivery.close()


def size_mb(*paths: Path) -> float:
    return sum(p.stat().st_size for path in paths for p in path.parent.glob(f"{path.name}*")) / 1e6


def bench_outbox(folder: Path) -> None:
    """Print what the summaries of `OUTBOX_DAYS` take in a store, by those of two."""
    path = folder / "outbox.db"
    writing_engine(f"sqlite:///{path}").dispose()
    store_with(path, "lab", 1, 0, 2 * 1440)
    per_day = size_mb(path) / 2
    print(f"outbox: {per_day:.2f} MB a day, {OUTBOX_DAYS * per_day:.0f} MB in {OUTBOX_DAYS} days")


def bench_keeping(engine: Engine, days: int) -> float:
    """Keep days of three sites in parts, as they come; return CPU of a summary, seconds."""
    spent_s, count = 0.0, 0
    for seed in range(3):
        rows = [*records_of(seed, 0, 1440 * days)]
        before_s = time.process_time()
        for at in range(0, len(rows), PART):
            part = rows[at : at + PART]
            keep(engine, f"real{seed}", part, Cursor(1, at + len(part)), 1)
        spent_s += time.process_time() - before_s
        count += len(rows)
    print(f"keeping: {1e3 * spent_s / count:.3f} ms of CPU a summary in parts of {PART}")
    one = [*records_of(9, 0, 240)]
    before_s = time.process_time()
    for at, row in enumerate(one):
        keep(engine, "single", [row], Cursor(1, at + 1), 1)
    single_s = (time.process_time() - before_s) / len(one)
    print(f"keeping: {1e3 * single_s:.2f} ms of CPU a summary that comes alone, as every minute")
    return single_s


def bench_questions(engine: Engine, hub: Hub, sites: int, whole: int, days: int) -> None:
    """Copy what is kept under other names, and ask."""
    for table, count in ((hours, sites), (summaries, whole)):
        others = ", ".join(c.name for c in table.columns if c.name != "site")
        for at in range(count):
            with engine.begin() as connection:
                connection.execute(text(
                    f"INSERT INTO {table.name} (site, {others}) SELECT 'site{at}', {others} "
                    f"FROM {table.name} WHERE site = 'real{at % 3}'"
                ))  # fmt: skip
    with engine.connect() as connection:
        num_hours = connection.scalar(select(func.count()).select_from(hours))
        num_rows = connection.scalar(select(func.count()).select_from(summaries))
    print(f"questions: {days} days; hours of {sites + 3} sites ({num_hours} rows), minutes of "
          f"{whole + 3} ({num_rows} rows)")  # fmt: skip
    for about, sql in QUESTIONS.items():
        begun_s = time.monotonic()
        rows = answer(hub.database, sql)[1]
        print(f"  {time.monotonic() - begun_s:6.2f} s  {about} ({len(rows)} rows)")
    sql = "SELECT site, sum(people * span_s) / 3600 FROM summaries GROUP BY site"
    begun_s = time.monotonic()
    answer(hub.database, sql)
    took_s = time.monotonic() - begun_s
    print(f"  {took_s:6.2f} s  the first by minutes, of {whole + 3} sites")
    names, now_ns = [f"site{at}" for at in range(sites)], BEGIN_NS + days * 86400 * NS
    known = {n: replace(hub.sites["real0"], name=n) for n in names}
    made = Hub(hub.path, hub.database, hub.every_s, (), hub.view, known)
    begun_s = time.monotonic()
    with engine.connect() as connection:
        overview(connection, made, names, now_ns)
    print(f"  {time.monotonic() - begun_s:6.2f} s  page over {sites} sites")


def serve(folder: Path, first: int, ports: list[int]) -> None:
    """Answer for some sites until killed, with certificates where they have some.

    It prints when each is asked.
    """
    kept = []
    for at, port in enumerate(ports, start=first):
        site = f"live{at}"
        box, keys = OutboxAnswers(folder / f"{site}.db", site), folder / "keys" / site

        def told(topic: str, asked: bytes, box: OutboxAnswers = box) -> bytes | None:
            os.write(1, f"{time.time():.3f}\n".encode())  # whole, from many threads
            return box.answer(topic, asked)

        link, roll = Link("edge", site, read_endpoint(f"tcp/127.0.0.1:{port}")), None
        if keys.is_dir():
            files, roll = certificates_in(keys, "edge"), read_roll(keys)
            link = Link("edge", site, read_endpoint(f"tls/127.0.0.1:{port}"), files)
        kept.append(open_network(link, roll))
        Consumers(outbox=told).listen(kept[-1], site)
    print("serving", flush=True)
    threading.Event().wait()


def free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        found = [stack.enter_context(socket.socket()) for _ in range(count)]
        for one in found:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in found]


def stores_of(folder: Path, sites: range, first: int, minutes: int) -> None:
    """Store minutes of sites: those of three of them, copied under the names of the others."""
    for at in sites:
        place, model = folder / f"live{at}.db", folder / f"live{at % 3}.db"
        if at < 3:
            store_with(place, f"live{at}", at, first, minutes)
            continue
        place.unlink(missing_ok=True)
        with sqlite3.connect(model) as source, sqlite3.connect(place) as dest:
            source.backup(dest)
            dest.execute("UPDATE runs SET site = ?", (f"live{at}",))
            dest.execute("UPDATE outboxes SET site = ?", (f"live{at}",))


def keys_of(folder: Path, sites: range) -> None:
    """Make an authority, and certificates of the edge and of the hub, for each site."""
    now = datetime.datetime.now(datetime.timezone.utc)
    for at in sites:
        init_keys(folder / "keys" / f"live{at}", f"live{at}", [], now)
        add_keys(folder / "keys" / f"live{at}", "house", now, kind="hub")


def start_sites(
    stack: ExitStack, folder: Path, ports: list[int], asked: list[float]
) -> list[psutil.Process]:
    """Start processes that answer for sites; add the time of each question to a list."""
    started = []
    for first in range(0, len(ports), SERVED):
        words = [sys.executable, __file__, "--serve", str(folder), str(first)]
        words += map(str, ports[first : first + SERVED])
        process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        stack.callback(process.wait)
        stack.callback(process.kill)
        started.append(process)
    for process in started:
        assert process.stdout is not None
        while (line := process.stdout.readline()).strip() != "serving":
            if not line:
                raise SystemExit("a process of sites ended")
        told = process.stdout
        threading.Thread(target=lambda t=told: asked.extend(map(float, t)), daemon=True).start()
    return [psutil.Process(process.pid) for process in started]


def bench_live(folder: Path, count: int, single_s: float, database: str, tls: bool) -> None:
    """Let a hub ask real sites; kill it for an hour; print what it takes and what ends first."""
    ports, asked = free_ports(count), list[float]()
    stores_of(folder, range(count), 0, 60)
    if tls:
        keys_of(folder, range(count))
    named = {f"live{at}": port for at, port in enumerate(ports)}
    hub = load_hub(write_hub(folder / "live.toml", named, 60, database, tls))
    with ExitStack() as stack:
        served = start_sites(stack, folder, ports, asked)
        engine, program = open_hub(hub.database, AT_ONCE), psutil.Process()
        stack.callback(engine.dispose)
        before_s, rss = sum(program.cpu_times()[:2]), program.memory_info().rss
        others_s = sum(sum(one.cpu_times()[:2]) for one in served)
        took_s = until_complete(hub, engine, count * 60)
        spent_s = sum(program.cpu_times()[:2]) - before_s
        others_s = sum(sum(one.cpu_times()[:2]) for one in served) - others_s
        grown_mb = (program.memory_info().rss - rss) / 1e6
        sites_mb = sum(one.memory_info().rss for one in served) / 1e6 / count
        most = max(Counter(int(at_s) for at_s in asked).values(), default=0)
        print(
            f"live: {count} sites{' over TLS' * tls} in {len(served)} processes, an hour of each "
            f"there {took_s:.0f} s after the hub began; most asked in a second {most}; hub "
            f"{1e3 * spent_s / count:.0f} ms of CPU a site, joining it included, "
            f"{spent_s / took_s:.0%} of a core, {grown_mb:.0f} MB more; sites "
            f"{1e3 * others_s / count:.0f} ms and {sites_mb:.1f} MB each; connections "
            f"open at once {AT_ONCE}; load {os.getloadavg()[0]:.1f}",
            flush=True,
        )
        pull_s = wall_of_pull(hub, engine)
        stores_of(folder, range(count), 60, 60)  # an hour passes without the hub
        asked.clear()
        took_s = until_complete(hub, engine, count * 120)
        most = max(Counter(int(at_s) for at_s in asked).values(), default=0)
        print(
            f"live: killed for an hour, complete {took_s:.0f} s after it began again, most asked "
            f"in one second {most}; load {os.getloadavg()[0]:.1f}"
        )
        per_site_s = spent_s / count + single_s
        print(
            f"once a minute: CPU of a core is enough for {60 / per_site_s:.0f} sites, "
            f"{1e3 * per_site_s:.0f} ms each; {AT_ONCE} asked at once for "
            f"{AT_ONCE * 60 / pull_s:.0f}, {pull_s:.2f} s each, no more connections"
        )


def wall_of_pull(hub: Hub, engine: Engine) -> float:
    """Return what joining a site, asking and leaving take, seconds."""
    begun_s = time.monotonic()
    sites = list(hub.sites)[:TIMED]
    for site in sites:
        link = hub.link(site)
        transport, topic = open_network(link), of_outbox(site, holder_at(link))
        while not transport.connected():
            time.sleep(0.05)
        pull(
            engine, site, lambda q, t=transport, of=topic: t.ask(of, q, ANSWER_S),  # type: ignore[misc]
            lambda: time.sleep(PAUSE_S), 1,
        )  # fmt: skip
        transport.close()
    return (time.monotonic() - begun_s) / len(sites)


def until_complete(hub: Hub, engine: Engine, wanted: int) -> float:
    """Run a hub until it has so many summaries; return how long that took."""
    begun_s = time.monotonic()
    with Pulling(hub, engine, lambda site, problem: print(f"  {site}: {problem}")):
        while True:
            with engine.connect() as connection:
                found = connection.scalar(select(func.count()).select_from(summaries))
            if (found or 0) >= wanted or time.monotonic() - begun_s > UNTIL_S:
                return time.monotonic() - begun_s
            time.sleep(0.2)


def write_hub(
    path: Path, ports: dict[str, int], every_s: float, database: str = "", tls: bool = False
) -> Path:
    lines = ['format = "e3pose-hub"', "version = 1", f"every_s = {every_s}"]
    lines.append(f'database = "{database or path.with_suffix(".db").name}"')
    where = "tls/localhost" if tls else "tcp/127.0.0.1"
    for name, port in ports.items():
        lines += ["[[site]]", f'name = "{name}"', f'endpoint = "{where}:{port}"']
        lines.append(f'keys = "keys/{name}/hubs/house"')
    path.write_text("\n".join(lines))
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--days", type=int, default=30, help="of each site that is kept")
    parser.add_argument("--sites", type=int, default=1000, help="with sums by the hour")
    parser.add_argument("--whole", type=int, default=7, help="with minutes")
    parser.add_argument("--live", type=int, default=24, help="that run for real")
    parser.add_argument("--database", default="", help="of the hub; SQLite in a folder by default")
    parser.add_argument("--live-database", default="", help="of the hub that asks real sites")
    parser.add_argument("--tls", action="store_true", help="with certificates for each site")
    parser.add_argument("--only-live", action="store_true", help="measure nothing else")
    parser.add_argument("--serve", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        folder, first, *ports = options.serve
        return serve(Path(folder), int(first), [int(port) for port in ports])

    def live(folder: Path, single_s: float) -> None:
        bench_live(folder, options.live, single_s, options.live_database, options.tls)

    with tempfile.TemporaryDirectory(prefix="e3pose-hub-") as name:
        folder = Path(name)
        if options.only_live:
            return live(folder, 0.0)
        bench_outbox(folder)
        hub = load_hub(write_hub(folder / "hub.toml", {"real0": 7447}, 60, options.database))
        engine = open_hub(hub.database)
        single_s = bench_keeping(engine, options.days)
        if not options.database:
            rows = 3 * 1440 * options.days
            print(f"keeping: {1e6 * size_mb(folder / 'hub.db') / rows:.0f} bytes a summary on disk")
        bench_questions(engine, hub, options.sites, options.whole, options.days)
        live(folder, single_s)


if __name__ == "__main__":
    main()
