"""Where people were when is for the owner alone, unless the folder is shared with its group."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.store.conftest import record, run

from e3pose.base.private import append_to, make_file, make_folder
from e3pose.energy.meters.charge_file import save_charge
from e3pose.store import StoreWriter, WriterSettings
from e3pose.store.export import write_tables


@pytest.fixture(params=[0o755, 0o2755], ids=["alone", "shared"])
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path]:
    """A folder that everybody may look into, with or without the setgid bit."""
    folder = tmp_path / "site"
    folder.mkdir()
    folder.chmod(request.param)
    old = os.umask(0o022)
    yield folder
    os.umask(old)


def modes(place: Path) -> set[int]:
    return {path.stat().st_mode & 0o777 for path in place.rglob("*") if path.is_file()}


def expected(place: Path) -> int:
    return 0o640 if place.stat().st_mode & 0o2000 else 0o600


def test_store_and_its_log_and_exports_are_private(place: Path) -> None:
    path = place / "live.db"
    with StoreWriter(path, run(), WriterSettings(commit_s=0.02)) as writer:
        writer.append(record(1))
        assert writer.flush()
        parts = [path, Path(f"{path}-wal"), Path(f"{path}-shm")]
        assert {part.stat().st_mode & 0o777 for part in parts} == {expected(place)}
    write_tables([{"x_m": [1.0]}], place / "found.csv", "csv")
    assert modes(place) == {expected(place)}


def test_charge_of_a_battery_and_logs_are_private(place: Path) -> None:
    save_charge(place / "batteries" / "cam1.json", "cam1", 50.0, 1000.0)
    make_folder(place / "logs")
    with append_to(place / "logs" / "edge.log") as log:
        log.write(b"said\n")
    with append_to(place / "logs" / "edge.log") as log:
        log.write(b"more\n")
    assert (place / "logs" / "edge.log").read_bytes() == b"said\nmore\n"
    assert modes(place) == {expected(place)}
    folders = {path.stat().st_mode & 0o777 for path in place.iterdir()}
    assert folders == {0o750 if expected(place) == 0o640 else 0o700}


def test_what_somebody_set_stays(place: Path) -> None:
    (place / "live.db").touch(0o644)
    make_file(place / "live.db")
    make_folder(place)
    assert (place / "live.db").stat().st_mode & 0o777 == 0o644
    assert place.stat().st_mode & 0o777 == 0o755


def test_standard_output_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    with StoreWriter(tmp_path / "live.db", run(), WriterSettings(commit_s=0.02)) as writer:
        writer.append(record(1))
        assert writer.flush()
    code = (
        "import sys\nfrom e3pose.store.export import write_tables\n"
        "write_tables([{'x': [1]}], None, sys.argv[1])"
    )
    for form in ("csv", "json"):
        with (tmp_path / form).open("wb") as file:
            subprocess.run([sys.executable, "-c", code, form], stdout=file, check=True)
    assert (tmp_path / "csv").read_text() == "x\n1\n"
    assert json.loads((tmp_path / "json").read_text()) == [{"x": 1}]
    query = [sys.executable, "-m", "e3pose", "query", str(tmp_path / "live.db"), "--json", "-"]
    said = subprocess.run(query, capture_output=True, check=True).stdout  # a pipe
    assert len(json.loads(said)) > 1
