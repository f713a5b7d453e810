"""The store: slot records in a database, written by a thread and queried at any time.

`StoreWriter` writes one run, `Store` answers questions. SQLite by default; other databases by URL.
"""

from e3pose.store.answers import StoredPoses, StoredRun
from e3pose.store.query import Store
from e3pose.store.retention import Retention
from e3pose.store.rows import EnergyReading, Event, Run
from e3pose.store.writer import StoreWriter, WriterSettings, WriterStatus

__all__ = [
    "EnergyReading",
    "Event",
    "Retention",
    "Run",
    "Store",
    "StoreWriter",
    "StoredPoses",
    "StoredRun",
    "WriterSettings",
    "WriterStatus",
]
