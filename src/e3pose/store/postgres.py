"""PostgreSQL stores: driver and timeouts."""

from __future__ import annotations

from typing import Any

from sqlalchemy import URL

DRIVER = "postgresql+psycopg"
FORM = "postgresql://USER@HOST:PORT/NAME"
NAMES = ("postgres", "postgresql", DRIVER)  # of which users write any
# A server that is gone is noticed within seconds: until then nothing is spooled.
WAIT: dict[str, Any] = {
    "connect_timeout": 5,
    "keepalives_idle": 5,
    "keepalives_interval": 2,
    "keepalives_count": 3,
    "tcp_user_timeout": 10_000,
    "application_name": "e3pose",
}


def with_driver(url: URL) -> URL:
    """Return a URL with the driver that is installed with the extra `postgres`."""
    return url.set(drivername=DRIVER) if url.drivername in NAMES else url


def shown_url(url: URL) -> str:
    """Return a URL without its password, and without the parameters that may hold one too."""
    kind = "postgresql" if url.drivername in NAMES else url.drivername
    bare = url.set(drivername=kind, query={})
    return str(bare.render_as_string(hide_password=True))


def engine_settings(url: URL, read_only: bool) -> dict[str, Any]:
    """Return the arguments of an engine; what a URL says of its own stays.

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
