"""Several edges in one process: nothing is shared by mistake, and each starts again by itself."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from tests.cases import each_case
from tests.rigs import looking
from tests.site.tables import write_site
from tests.waiting import eventually

from e3pose.base.errors import InputError
from e3pose.recording.calibration import save_rig
from e3pose.settings.resolved import ResolvedSite, resolve_site
from e3pose.site import many_edges
from e3pose.site.many_edges import Keeper, check_apart, load_apart

RIG = looking((4, 0), (0, 4), (-4, 0), (0, -4))
OWN = 'name = "{name}"\nmetrics_port = {metrics}\n[link]\nendpoint = "tcp/127.0.0.1:{port}"\n'


def place(folder: Path, more: str) -> Path:
    folder.mkdir(exist_ok=True)
    save_rig(RIG, folder / "rig.toml")
    path = write_site(folder).path
    path.write_text(path.read_text().replace('name = "lab"\n', "") + more)
    return path


def house(folder: Path, of_hall: str = "", of_lab: str = "") -> list[ResolvedSite]:
    """Return two sites with all of their own, but for some lines."""
    sites = []
    for name, port, more in (("lab", 7441, of_lab), ("hall", 7443, of_hall)):
        lines = OWN.format(name=name, metrics=port + 1, port=port)
        for line in more.splitlines():
            key = line.partition(" = ")[0]
            lines = "".join(x for x in lines.splitlines(True) if not x.startswith(f"{key} = "))
            lines = lines + line + "\n" if key in ("endpoint", "keys") else line + "\n" + lines
        sites.append(resolve_site(place(folder / name, lines)))
    return sites


@each_case(
    ("of_hall", "of_lab", "said"),
    [
        ('name = "lab"', "", "name: found lab"),
        ('endpoint = "tcp/127.0.0.1:7441"', "", "link.endpoint: found port 7441"),
        ("metrics_port = 7442", "", "metrics_port: found port 7442"),
        ("metrics_port = 7441", "", "metrics_port: found port 7441"),
        ('state = "../lab/state.npz"', "", "state: found "),
        ('learn = "../lab/learned"', 'learn = "learned"', "learn: found "),
    ],
)
def test_what_must_be_a_sites_own_is_refused_with_both_names(
    of_hall: str, of_lab: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as error:
        check_apart(house(tmp_path, of_hall, of_lab))
    text = str(error.value)
    assert said in text and str(tmp_path / "lab" / "site.toml") in text
    assert text.startswith(str(tmp_path / "hall" / "site.toml"))


def test_one_file_that_cannot_be_read_stops_no_other(tmp_path: Path) -> None:
    check_apart(house(tmp_path))
    paths = [tmp_path / "lab", tmp_path / "nowhere"]
    load_apart(paths, resolve_site)
    with pytest.raises(InputError, match="nowhere"):
        load_apart(paths[1:], resolve_site)


class Told:
    """Keeps what is logged."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, dict[str, Any]]] = []

    def info(self, event: str, **fields: Any) -> None:
        self.lines.append((event, fields))

    warning = info


def test_edge_that_cannot_start_is_tried_again_less_and_less_often_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts = list[str]()

    def start_edge(*_: object) -> None:
        starts.append("")
        raise InputError("no") if len(starts) % 2 else KeyError("odd")

    monkeypatch.setattr(many_edges, "start_edge", start_edge)
    monkeypatch.setattr(many_edges, "FIRST_WAIT_S", 0.01)
    told = Told()
    site = house(tmp_path)[0]
    keeper = Keeper(site.file.path, lambda _: site, told, threading.Lock())
    keeper.start()
    assert eventually(lambda: len(told.lines) >= 4)
    keeper.stop()
    assert keeper.join(10.0) and keeper.tried.is_set() and not keeper.summary
    waits_s = [fields["after_s"] for _, fields in told.lines]
    assert waits_s[:4] == [0.01, 0.02, 0.04, 0.08]
    assert "KeyError: 'odd'" in told.lines[1][1]["error"]
    assert "start_edge" in told.lines[1][1]["where"] and "where" not in told.lines[0][1]


def test_site_that_starts_forever_keeps_no_other_from_starting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = threading.Event()

    def start_edge(*_: object) -> None:
        begun.set()
        raise InputError("it is this test's")

    monkeypatch.setattr(many_edges, "start_edge", start_edge)
    monkeypatch.setattr(many_edges, "START_S", 0.1)
    site, starting = house(tmp_path)[0], threading.Lock()
    with starting:  # another site is starting, and does not end
        keeper = Keeper(site.file.path, lambda _: site, Told(), starting)
        keeper.start()
        assert begun.wait(30.0)
        keeper.stop()
        assert keeper.join(10.0)


STARTING = """
import sys, threading
from e3pose.cli import main
from e3pose.site import many_edges

def start_edge(*_):
    print("starting", flush=True)
    threading.Event().wait()

many_edges.start_edge = start_edge
sys.argv[1:1] = ["edge"]
main()
"""


def test_ctrl_c_ends_sites_that_start_at_once_and_says_so(tmp_path: Path) -> None:
    """A compiling thread cannot be asked to end, and would abort a process that ends by itself."""
    paths = [str(site.file.path) for site in house(tmp_path)]
    command = [sys.executable, "-c", STARTING, *paths]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None and program.stdout.readline() == "starting\n"
        program.send_signal(signal.SIGINT)
        said, _ = program.communicate(timeout=20.0)
    assert program.returncode == 0
    assert sorted(line.rpartition(": ")[2] for line in said.splitlines()) == [
        "ended while it started", "no slots",
    ]  # fmt: skip
