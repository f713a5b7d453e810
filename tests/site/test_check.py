"""What `e3pose check` says of the store and the state of a site."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from e3pose.settings.site_file import SiteTable, StoreTable
from e3pose.site.check import check_places


def found(folder: Path) -> dict[str, str]:
    """Return the level of what is found, by its name; the worst of each."""
    site = SiteTable("e3pose-site", 1, "lab", "rig.toml", 25.0, store=StoreTable("live.db"))
    worst: dict[str, str] = {}
    for finding in check_places(folder / "site.toml", site):
        if worst.get(finding.what) != "problem":
            worst[finding.what] = finding.level
    return worst


def make_database(path: Path) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE slots (slot INTEGER, joints BLOB)")
        connection.executemany(
            "INSERT INTO slots VALUES (?, ?)", [(i, bytes(99)) for i in range(999)]
        )
    connection.close()
    path.chmod(0o600)


def test_whole_store_is_no_finding(tmp_path: Path) -> None:
    make_database(tmp_path / "live.db")
    assert "store-corrupt" not in found(tmp_path)


def test_damaged_store_is_a_problem_and_one_set_aside_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "live.db"
    make_database(path)
    with path.open("r+b") as file:
        file.seek(8192)
        file.write(b"\xff" * 20_000)
    assert found(tmp_path)["store-corrupt"] == "problem"
    path.rename(tmp_path / "live.db.corrupt-20261122T070000Z")
    (tmp_path / "live.db.corrupt-20261122T070000Z-wal").touch()
    make_database(path)
    assert found(tmp_path)["store-corrupt"] == "warning"


def test_files_that_everybody_may_read_are_told_of(tmp_path: Path) -> None:
    make_database(tmp_path / "live.db")
    (tmp_path / "state.npz").touch(0o600)
    assert found(tmp_path).items() >= {"store": "ok", "state": "ok"}.items()
    (tmp_path / "live.db").chmod(0o644)
    (tmp_path / "state.npz").chmod(0o640)
    assert found(tmp_path).items() >= {"store": "warning", "state": "ok"}.items()
