"""What is asked, tried and measured of a site, in which order, and what is not."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from tests.rigs import looking
from tests.site.tables import resolved_site

from e3pose.base.errors import InputError
from e3pose.camera.probe import Probe
from e3pose.settings.resolved import ResolvedSite
from e3pose.site.check import parts as listed
from e3pose.site.check import site as checking
from e3pose.site.check.finding import Finding, problem, report
from e3pose.site.check.parts import PARTS, start_problems
from e3pose.site.check.site import examine_site
from e3pose.wire.site_messages import Status

CAMERAS = """
[[camera]]
id = "c0"
source = "usb:90"
detector = "movenet-multipose"
[[camera]]
id = "c1"
source = "usb:91"
detector = "movenet-multipose"
"""


@dataclass(eq=False)
class House:
    """What a check does to a machine, in order; its cameras are there, its edge as told."""

    status: Status | None = None
    done: list[str] = field(default_factory=list)

    @contextmanager
    def does(self, what: str) -> Iterator[Callable[[int, int], None]]:
        self.done.append(what)
        yield lambda done, total: None

    def examine(self, site: ResolvedSite, quick: bool = False) -> list[Finding]:
        counting, measuring = self.does("count frames"), self.does("measure")
        return examine_site(site, None, 0.1, counting, measuring, quick)


@pytest.fixture
def house(monkeypatch: pytest.MonkeyPatch) -> House:
    house = House()

    def ask(*_: object) -> Status | None:
        house.done.append("ask")
        return house.status

    monkeypatch.setattr(checking, "status_of", ask)
    monkeypatch.setattr(checking, "source_problems", lambda site: [])
    monkeypatch.setattr(checking, "measure_detections", lambda site: None)
    seen = Probe("usb:90", (640, 480), 30.0, dark=False)
    rates = {"c0": seen, "c1": seen}
    monkeypatch.setattr("e3pose.site.check.sources.probe_all", lambda asked, progress: rates)
    return house


def site_of(folder: Path, more: str = "") -> ResolvedSite:
    return resolved_site(folder, looking((4, 0), (0, 4)), more + CAMERAS)


def test_all_is_asked_counted_and_measured_once(house: House, tmp_path: Path) -> None:
    found = house.examine(site_of(tmp_path))
    assert house.done == ["ask", "count frames", "measure"]
    assert [one.what for one in found if one.what in ("calibration", "clock", "edge")] == [
        "calibration",
        "clock",
        "edge",
    ]


def test_every_part_is_named_by_check_and_heard_at_the_start(
    tmp_path: Path, house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Break each part in turn: `e3pose check` and the start of a site say the same of it."""
    site = site_of(tmp_path)
    parts = dict(PARTS)
    named = {one.what for one in house.examine(site, quick=True)}
    assert {*parts} - {"disks"} <= named, "a part without a finding is named as well"
    for name in parts:
        broken = lambda site, name=name: [problem(f"the {name}", "is broken", "mend it")]  # noqa: E731
        monkeypatch.setattr(checking, "PARTS", {**parts, name: broken})
        monkeypatch.setattr(listed, "PARTS", {**parts, name: broken})
        assert f"the {name}" in [one.what for one in house.examine(site, quick=True)]
        said: list[str] = []
        report(start_problems(site), said.append)
        assert f"the {name}: is broken: mend it" in said


def test_frames_of_a_site_that_runs_are_not_counted(house: House, tmp_path: Path) -> None:
    house.status = Status("lab", 3, 25.0, 2, 2, ())
    found = house.examine(site_of(tmp_path))
    assert house.done == ["ask", "measure"]
    assert found[-1] == Finding("ok", "edge", "running, slot 3, lead 2")


def test_quick_measures_nothing(house: House, tmp_path: Path) -> None:
    house.examine(site_of(tmp_path), quick=True)
    assert house.done == ["ask"]


def test_what_keeps_an_edge_from_starting_is_said_first(house: House, tmp_path: Path) -> None:
    (tmp_path / "poses.db").mkdir()
    with pytest.raises(InputError, match=r"poses\.db"):
        house.examine(site_of(tmp_path, '[store]\npath = "poses.db"\n'))
    assert house.done == []
