"""What tests of the writer of a store share."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.waiting import eventually

from e3pose.store import Store, WriterSettings, database

QUICK = WriterSettings(commit_s=0.02, spool_bytes=400_000)


def wait_for(condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
    assert eventually(condition, timeout_s), "it never came to pass"


def stored_slots(path: Path | str) -> list[int]:
    return [row["slot"] for row in Store(path).rows("slots")]


def limit_connections(monkeypatch: pytest.MonkeyPatch, pragma: Callable[[], str]) -> None:
    def limited(url: str) -> object:
        from sqlalchemy import event

        engine = database.writing_engine(url)

        @event.listens_for(engine, "connect")
        def _limit(connection: sqlite3.Connection, _record: object) -> None:
            connection.execute(f"PRAGMA {pragma()}")

        return engine

    monkeypatch.setattr("e3pose.store.saver.writing_engine", limited)
