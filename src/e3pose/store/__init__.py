"""The store: slot records in a database, written by a thread and queried at any time.

`StoreWriter` writes one run, `Store` answers questions. SQLite by default; other databases by URL.
The names below are imported when they are first used: rows and events need no SQLAlchemy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from e3pose.base.deferred import names_of

if TYPE_CHECKING:
    from e3pose.store.answers import StoredPoses as StoredPoses
    from e3pose.store.answers import StoredRun as StoredRun
    from e3pose.store.query import Store as Store
    from e3pose.store.retention import Retention as Retention
    from e3pose.store.rows import EnergyReading as EnergyReading
    from e3pose.store.rows import Event as Event
    from e3pose.store.rows import Run as Run
    from e3pose.store.writer import StoreWriter as StoreWriter
    from e3pose.store.writer import WriterSettings as WriterSettings
    from e3pose.store.writer import WriterStatus as WriterStatus

_HOMES = {
    "EnergyReading": "rows",
    "Event": "rows",
    "Retention": "retention",
    "Run": "rows",
    "Store": "query",
    "StoreWriter": "writer",
    "StoredPoses": "answers",
    "StoredRun": "answers",
    "WriterSettings": "writer",
    "WriterStatus": "writer",
}


__getattr__ = names_of(__name__, _HOMES)
