"""A run of known slots: what is stored must come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.postgres import Server

from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.pipeline import SlotRecord
from e3pose.store import Run

STARTED_NS = 1_795_000_000_000_000_000
KINDS = ("sqlite", "postgresql")
CAMERAS = ("north", "east", "south")


def record(slot: int, num_persons: int = 2, fps: float = 25.0) -> SlotRecord:
    """Return a slot in which person k stands at (slot, k, joint) metres; joint 3 is missing."""
    joints = np.zeros((num_persons, 17, 3))
    joints[..., 0] = slot
    joints[..., 1] = np.arange(num_persons)[:, None]
    joints[..., 2] = np.arange(17)
    scores = np.full((num_persons, 17), 0.5)
    scores[:, 3] = 0.0
    measured = scores > 0
    measured[:, 5] = slot % 2 == 0  # in other slots it is only expected
    selected = np.array([True, slot % 2 == 0, False])
    arrived, tracks = selected & [True, False, True], np.arange(num_persons) + 10
    dynamics = np.where(scores[..., None] > 0, [0.5, -1.0, slot / 8, 0.02, 0.4, 0.5], np.nan)
    wide = np.tile(np.diag([0.25, 0.5, 0.75]), (num_persons, 17, 1, 1))
    people = People(tracks, joints, scores, measured, full_covariance_m2=wide, dynamics=dynamics)
    occlusion, deficit = np.array([0.25, 0.5, slot / 1024]), np.array([1.5, 0.0, 2.0])
    of_slot = slot, slot / fps, selected, arrived, people, occlusion, deficit, ~selected
    return SlotRecord(*of_slot, stage_s={"match": 0.001, "predict": 0.002})


def run(site: str = "hall", started_ns: int = STARTED_NS) -> Run:
    return Run(site, "trial", started_ns, 0.04, "coco17", COCO17.joints, CAMERAS, "test")


def new_place(request: pytest.FixtureRequest, folder: Path) -> Path | str:
    """Return where a store of the request's kind may be: a new file, or a place on a server."""
    if request.param == "sqlite":
        return folder / "hall.db"
    server: Server = request.getfixturevalue("postgres")
    return server.new_store()


@pytest.fixture(params=KINDS)
def place(request: pytest.FixtureRequest, tmp_path: Path) -> Path | str:
    """Where a store may be."""
    return new_place(request, tmp_path)
