"""Which network is chosen, where its weights are, and how long networks take here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.detectors.test_networks import write_onnx

from e3pose.base.errors import InputError
from e3pose.detectors import AUTO, DETECTORS, chooser, make_detector, skeleton_of
from e3pose.detectors.chooser import ORDER, QUICK, choose_network
from e3pose.detectors.timing import Workload, time_detections
from e3pose.detectors.weights import BOXES, MODELS, find_weights, is_installed, networks
from e3pose.model.skeleton import COCO17

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def offline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("E3POSE_MODELS", str(tmp_path))
    return tmp_path


def put(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).mkdir()
        (folder / name / "a.onnx").write_bytes(b"not read")


@pytest.mark.parametrize(
    ("here", "live", "gpu", "name", "why"),
    [
        ((), False, False, "movenet-multipose", "the best to fetch for a CPU"),
        ((), True, True, "rtmo-l", "the best to fetch for a GPU"),
        (("openpose-thin",), False, False, "openpose-thin", "better: e3pose models pull movenet"),
        (("openpose-thin", "movenet-multipose"), True, False, "movenet-multipose", "the best of"),
        (("rtmo-s", "openpose-thin"), True, False, "openpose-thin", "the best of those installed"),
        (("rtmo-s", "openpose-thin"), True, True, "rtmo-s", "the best of those installed"),
        (("rtmo-s", "openpose-thin"), False, False, "rtmo-s", "the best of those installed"),
        (("rtmpose-halpe26", "rtmo-l"), False, False, "rtmo-l", "the only one"),  # boxes lack
        (("rtmpose-halpe26", "yolox-tiny", "rtmo-l"), False, False, "rtmpose-halpe26", "the best"),
        (("yolox-tiny",), False, False, "movenet-multipose", "the best to fetch"),
        (("ours",), True, False, "ours", "the only one installed, your own"),
    ],
)
def test_the_best_that_is_here_else_the_best_to_fetch(
    offline: Path, here: tuple[str, ...], live: bool, gpu: bool, name: str, why: str
) -> None:
    put(offline, *here)
    choice = choose_network(live, gpu)
    assert choice.name == name and choice.installed == is_installed(name)
    assert why in str(choice) and str(choice).startswith(f"network: {name}, ")
    assert all(MODELS[other].sha256 for other in choice.others), "unasked only known files"
    assert choice.installed or choice.others[-1:] == ("openpose-thin",)


def test_every_network_to_choose_or_fetch_has_a_detector() -> None:
    assert set(QUICK) <= set(ORDER) <= set(MODELS)
    for model in MODELS.values():
        assert model.family in DETECTORS or model.family == BOXES
        assert not model.boxes or MODELS[model.boxes].family == BOXES
        assert model.tried <= (model.name in QUICK)


def test_offline_folder_has_networks_by_name(
    offline: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(offline, "movenet-multipose")
    assert find_weights("movenet-multipose") == offline / "movenet-multipose" / "a.onnx"
    published = offline / "movenet-multipose" / MODELS["movenet-multipose"].filename
    published.write_bytes(b"altered")
    assert not is_installed("movenet-multipose")
    with pytest.raises(InputError, match="not the published weights"):
        find_weights("movenet-multipose")
    put(offline, "ours")
    assert "yours, in" in networks()["ours"].title
    pin = offline / "ours" / "network.toml"
    pin.write_text('name = "ours"\n')
    with pytest.raises(InputError, match=r"network\.toml: missing: title"):
        networks()
    pin.unlink()
    monkeypatch.setenv("E3POSE_MODELS", str(offline / "gone"))
    with pytest.raises(InputError, match=r"E3POSE_MODELS: found .*gone"):
        networks()


def test_auto_runs_what_is_chosen(offline: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (offline / "ours").mkdir()
    people = np.zeros((1, 6, 56), dtype=np.float32)
    path = write_onnx(offline / "ours" / "m.onnx", (1, 288, 512, 3), people, kind=6)
    monkeypatch.setattr(chooser, "has_gpu", lambda: False)
    for name, model in ((AUTO, None), (AUTO, path), ("ours", None)):
        assert make_detector(name, model, "cpu", 1).skeleton == COCO17
        assert skeleton_of(name, model) == COCO17
    assert skeleton_of("rtmo-m") == COCO17 and skeleton_of("rtmpose-halpe26") is None


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
