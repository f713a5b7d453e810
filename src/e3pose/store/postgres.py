"""PostgreSQL stores: driver, deadlines, and the lock of the one edge of a site."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from sqlalchemy import URL, Connection, Engine, event, text
from sqlalchemy.exc import DBAPIError

from e3pose.base.errors import InputError

DRIVER = "postgresql+psycopg"
FORM = "postgresql://USER@HOST:PORT/NAME"
NAMES = ("postgres", "postgresql", DRIVER)  # of which users write any
# A server that is gone is noticed within seconds: until then nothing is spooled.
WAIT: dict[str, Any] = {
    "connect_timeout": 3,
    "keepalives_idle": 3,
    "keepalives_interval": 1,
    "keepalives_count": 2,
    "tcp_user_timeout": 5_000,
    "application_name": "e3pose",
}
LOCK_MS = 2_000  # that a statement waits for another session's lock
# Of a session, by the server: it ends what takes too long, and sessions of edges that are gone.
SESSION = {
    "lock_timeout": f"{LOCK_MS}ms",
    "statement_timeout": "3s",
    "tcp_keepalives_idle": "5s",
    "tcp_keepalives_interval": "2s",
    "tcp_keepalives_count": "3",
    "tcp_user_timeout": "10s",
}
OF_READERS = ("lock_timeout",)  # an export may take its time
LOCK_NOT_AVAILABLE = "55P03"  # the server's code
OWNER = """SELECT coalesce(host(a.client_addr), 'a local socket') || ', session ' || a.pid
    || ', since ' || date_trunc('second', a.backend_start)
    FROM pg_locks AS l JOIN pg_stat_activity AS a USING (pid)
    WHERE l.locktype = 'advisory' AND l.objsubid = 1 AND l.granted
    AND (l.classid::bigint << 32) | l.objid::bigint = {key}"""
ANSWER_S = 4.0  # that a call of the writer may take in all, where the server answers nothing


class Line:
    """The connection of a writer, which another thread can cut while it waits for an answer."""

    def __init__(self, engine: Engine) -> None:
        """Watch the connections of an engine; each takes the place of the one before."""
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None

        @event.listens_for(engine, "do_connect")
        def _connect(dialect: Any, _record: Any, words: Any, options: Any) -> Any:
            connection = dialect.connect(*words, **options)
            self._hold(connection.fileno())
            return connection

    def cut(self) -> None:
        """End the connection; waiting calls fail at once."""
        with self._lock:
            if self._socket is not None:
                with suppress(OSError):  # it ended by itself
                    self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Let the last connection go."""
        self._hold(None)

    def _hold(self, handle: int | None) -> None:
        # A handle of its own: the driver's may be closed and its number given to another file.
        made = None if handle is None else socket.socket(fileno=os.dup(handle))
        with self._lock:
            before, self._socket = self._socket, made
        if before is not None:
            before.close()


def set_deadlines(engine: Engine, url: URL, names: Iterable[str] = SESSION) -> None:
    """Give each connection of an engine the deadlines of `SESSION` that its URL does not set."""
    own = str(url.query.get("options", ""))
    wanted = {name: SESSION[name] for name in names if name not in own}

    @event.listens_for(engine, "connect")
    def _set(connection: Any, _record: Any) -> None:
        with connection.cursor() as cursor:
            for name, value in wanted.items():  # of those that this version of the server knows
                cursor.execute(
                    "SELECT set_config(name, %s, false) FROM pg_settings WHERE name = %s",
                    (value, name),
                )
        connection.commit()


def take_site(connection: Connection, site: str, where: str) -> None:
    """Take the lock of a site, which the server releases when the connection ends.

    Raises:
        InputError: when another edge holds it.
    """
    key = {"site": site}
    hashed = "hashtextextended(current_schema() || '/' || :site, 0)"
    try:  # a killed edge's session may take a moment to end
        with connection.begin():
            connection.execute(text(f"SELECT pg_advisory_lock({hashed})"), key)
    except DBAPIError as error:
        if getattr(error.orig, "sqlstate", "") != LOCK_NOT_AVAILABLE:
            raise
        with connection.begin():
            owner = connection.execute(text(OWNER.format(key=hashed)), key).scalar()
        other = f"the edge at {owner}" if owner else "another edge"
        raise InputError(
            f"{where}: {other} writes site {site!r} there already, expected one edge per site: "
            "stop it, or use another site name or database"
        ) from None


def with_driver(url: URL) -> URL:
    """Return a URL with the driver that is installed with the extra `postgres`."""
    return url.set(drivername=DRIVER) if url.drivername in NAMES else url


def shown_url(url: URL) -> str:
    """Return a URL without its password, and without the parameters that may hold one too."""
    kind = "postgresql" if url.drivername in NAMES else url.drivername
    bare = url.set(drivername=kind, query={})
    return str(bare.render_as_string(hide_password=True))


def engine_settings(url: URL, read_only: bool) -> dict[str, Any]:
    """Return the arguments of an engine; options in the URL take precedence.

    Args:
        url: of a PostgreSQL server.
        read_only: whether its connections must not write, and see one state of the data.
    """
    asked = {name: value for name, value in WAIT.items() if name not in url.query}
    if not read_only:
        return {"connect_args": asked}
    return {
        "connect_args": asked,
        "isolation_level": "REPEATABLE READ",
        "execution_options": {"postgresql_readonly": True},
    }
