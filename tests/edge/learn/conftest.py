"""An online trainer whose training is a script of a few lines."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.edge.learn.trainer import FAKE, SETTINGS, Make, live
from tests.manual_clock import ManualClock

from e3pose.edge.learn import OnlineTrainer
from e3pose.model.skeleton import COCO17


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(10**18)


@pytest.fixture
def make(tmp_path: Path, clock: ManualClock) -> Iterator[Make]:
    script = tmp_path / "fake.py"
    script.write_text(FAKE)
    made: list[OnlineTrainer] = []

    def trainer(mode: str, slots: int = 100) -> OnlineTrainer:
        command = (sys.executable, str(script), mode)
        one = OnlineTrainer(
            tmp_path / "site", COCO17, SETTINGS, clock, command=command, background=False
        )
        made.append(one)
        live(one, slots)
        return one

    yield trainer
    for one in made:
        one.close()
