"""How long networks take here, in processes of their own."""

from __future__ import annotations

from pathlib import Path

import pytest

from e3pose.base.errors import InputError
from e3pose.detectors.timing import Workload, time_detections

pytestmark = pytest.mark.slow

NAP_S = 0.05
NAPPER = f"""
import time
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17

class Napper:
    skeleton = COCO17

    def detect(self, image):
        assert image.shape == (48, 64, 3)
        time.sleep({NAP_S})
        return Poses2D.empty(17)
"""


def test_each_process_is_measured_alone_and_with_the_others(tmp_path: Path) -> None:
    (tmp_path / "napper.py").write_text(NAPPER)
    napper = Workload(f"{tmp_path}/napper.py:Napper", image_size=(64, 48))
    times = time_detections([napper, napper], seconds=0.2)
    assert times.alone_s.shape == times.together_s.shape == (2,)
    assert (times.alone_s >= NAP_S).all() and (times.together_s >= NAP_S).all()
    assert times.rate <= 2 / NAP_S and times.reach_fps(1) <= 1 / NAP_S


def test_network_that_is_not_there_is_reported() -> None:
    with pytest.raises(InputError, match=r"detector: .*no such file"):
        time_detections([Workload("missing.onnx")])
