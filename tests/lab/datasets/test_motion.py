from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case
from tests.cli.commands import run

from e3pose.base.errors import InputError
from e3pose.model.skeleton import CMU31
from e3pose.recording import load_recording
from e3pose_lab.datasets.motion import BONES, cmu_clips, default_ring, import_cmu


def _body(num_slots: int) -> NDArray[np.float64]:
    """A stick 1.8 m high that walks along x from 10 m on, with its fingers 0.6 m to the side."""
    joints = np.zeros((num_slots, 31, 3))
    joints[..., 0] = 10 + 0.04 * np.arange(num_slots)[:, None]
    joints[..., 2] = 1.0
    joints[:, CMU31.index("top_head"), 2] = 1.8
    joints[:, CMU31.index("left_ankle"), 2] = 0.1
    joints[:, CMU31.index("right_fingers"), 1] = -0.6
    return joints


def _save(path: Path, **change: Any) -> Path:
    arrays: dict[str, Any] = {
        "joint_names": np.array(BONES), "07_01": _body(40).astype(np.float32), "07_02": _body(3)
    } | change  # fmt: skip
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


def test_clip_is_one_person_with_truth_alone(tmp_path: Path) -> None:
    recording = import_cmu(_save(tmp_path / "clips.npz"), "07_01")
    assert recording.truth is not None
    assert recording.truth.skeleton == CMU31
    np.testing.assert_allclose(recording.truth.joints_m[:, 0], _body(40), atol=1e-5)
    assert (recording.num_slots, recording.fps) == (40, 30.0)
    assert [len(series.slots) for series in recording.views] == [0] * 5


def test_made_up_cameras_stand_around_the_path_and_see_it() -> None:
    body = _body(100)
    rig = default_ring(body[:, 0])
    distances = np.linalg.norm(rig.centers_m[:, :2] - [11.98, 0], axis=-1)
    np.testing.assert_allclose(distances, 4.2, rtol=0.05)
    np.testing.assert_allclose(rig.centers_m[:, 2], 2.0, rtol=0.15)
    middle = body[45:55, 0]
    assert all(camera.sees(middle).all() for camera in rig.cameras)
    for camera, again in zip(rig.cameras, default_ring(body[:, 0]).cameras, strict=True):
        np.testing.assert_array_equal(camera.T_world_camera, again.T_world_camera)


def test_a_long_path_has_a_wider_ring() -> None:
    path = np.zeros((2, 3))
    path[1, 0] = 8.0  # 4 m to either side of the middle
    distances = np.linalg.norm(default_ring(path).centers_m[:, :2] - [4, 0], axis=-1)
    np.testing.assert_allclose(distances, 8.0, rtol=0.05)


@each_case(
    ("change", "message"),
    [
        ({"07_01": None}, "array '07_01' is missing, found '07_02, joint_names'"),
        ({"07_01": _body(5)[:, :30]}, r"found shape \(5, 30, 3\)"),
        ({"07_01": _body(5) * 100}, "found 90 from the hips to the farthest joint"),
        ({"07_01": np.zeros((5, 31, 3))}, "found 0 from the hips"),
        ({"07_01": np.full((5, 31, 3), np.nan)}, "found a value that is not finite"),
        ({"07_01": np.zeros((0, 31, 3))}, "found 0 frames"),
        ({"joint_names": np.array(BONES[::-1])}, "found 'rfingers', expected 'root'"),
        ({"joint_names": None}, "array 'joint_names' is missing"),
    ],
)
def test_wrong_arrays_are_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        import_cmu(_save(tmp_path / "clips.npz", **change), "07_01")


@each_case("name", ["../07_01", "a/b", "", "joint_names", ".hidden", "x" * 65])
def test_a_clip_name_that_is_no_folder_name_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="clip: found"):
        import_cmu(_save(tmp_path / "clips.npz"), name)


def test_hostile_names_in_the_archive_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="clip: found"):
        cmu_clips(_save(tmp_path / "clips.npz", **{"../../evil": _body(3)}))


def test_an_archive_without_clips_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="found 0 clips"):
        cmu_clips(_save(tmp_path / "clips.npz", **{"07_01": None, "07_02": None}))
    (tmp_path / "broken.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"found no \.npz archive"):
        cmu_clips(tmp_path / "broken.npz")


def test_command_makes_a_recording_of_every_clip(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("import", "cmu", _save(tmp_path / "clips.npz"))
    assert run(*words, tmp_path / "cmu") == 0
    assert sorted(path.name for path in (tmp_path / "cmu").iterdir()) == ["07_01", "07_02"]
    assert load_recording(tmp_path / "cmu" / "07_01").num_slots == 40
    assert run(*words, tmp_path / "one", "--clip", "07_02") == 0
    assert load_recording(tmp_path / "one").num_slots == 3
    assert run(*words, tmp_path / "cmu") == 2
    assert "--overwrite" in capsys.readouterr().err


@pytest.mark.shared
def test_real_clips_are_people_on_the_floor(shared: Path) -> None:
    source = shared / "data/cmu_mocap/cmu_mocap_train_30fps.npz"
    assert "02_10" in cmu_clips(source)
    truth = import_cmu(source, "02_10").truth
    assert truth is not None
    height = truth.joints_m[:, 0, CMU31.index("top_head"), 2]
    assert 1.4 < np.median(height) < 2.0
    thigh = truth.joints_m[:, 0, CMU31.index("left_hip")] - truth.joints_m[:, 0, 4]
    assert np.linalg.norm(thigh, axis=-1).std() < 0.005  # a bone keeps its length
