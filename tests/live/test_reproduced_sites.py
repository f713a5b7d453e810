"""Sites that `e3pose reproduce` runs: their memory, their slots through a slow link, and faults."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.rigs import looking

from e3pose.base.errors import InputError
from e3pose.site.example import Example
from e3pose_lab.reproduce.site_run import running_site


def test_a_site_that_does_not_run_says_why(tmp_path: Path) -> None:
    rig = looking((3.0, 0.0), (0.0, 3.0))
    nothing = Example("broken", dict.fromkeys(rig.camera_ids, "none.mp4"), 10.0, "coco17")
    with pytest.raises(InputError, match=r"ended.*none\.mp4"), running_site(tmp_path, rig, nothing):
        pass
