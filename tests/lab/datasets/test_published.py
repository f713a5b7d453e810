"""Shelf and Campus as published, on a tiny folder made here."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.pose import Poses2D
from e3pose.model.rigs import ring_rig
from e3pose.model.skeleton import COCO17
from e3pose.recording import Recording, ViewSeries, save_recording
from e3pose_lab.datasets.published import CAMPUS, decomposed, import_published

RIG = ring_rig(3, 6.0, 2.5, (360, 288), np.random.default_rng(0))
FRAMES = 8


def write_published(
    folder: Path, matrices: Iterable[Floats], labels: Sequence[Sequence[Floats]]
) -> None:
    """Write projection matrices, folders of images, and poses `(14, 3)` by actor and frame."""
    (folder / "Calibration").mkdir(parents=True)
    for number, matrix in enumerate(matrices):
        np.savetxt(folder / "Calibration" / f"P{number}.txt", matrix, delimiter=",")
        (folder / f"Camera{number}").mkdir()
    actors = np.empty((1, len(labels)), dtype=object)
    for actor, frames in enumerate(labels):
        actors[0, actor] = np.empty((len(frames), 1), dtype=object)
        for frame, pose in enumerate(frames):
            actors[0, actor][frame, 0] = pose
    savemat(folder / "actorsGT.mat", {"actor3D": actors})


NOBODY = np.zeros((0, 0))


def publish(folder: Path) -> Path:
    """A data set of three cameras, two actors and eight frames; actor 2 is there in frame 5."""
    scales = (1.0, -3.0, 1.0)  # of any scale and sign
    first = [np.full((14, 3), 0.1 * frame) for frame in range(FRAMES)]
    second = [pose if frame == 5 else NOBODY for frame, pose in enumerate(first)]
    matrices = (k * c.projection for k, c in zip(scales, RIG.cameras, strict=True))
    write_published(folder, matrices, [first, second])
    for number in range(3):
        for frame in range(2, FRAMES):
            (folder / f"Camera{number}" / f"img_{frame:06d}.png").touch()
    return folder


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return publish(tmp_path_factory.mktemp("campus") / "CampusSeq1")


def test_labels_and_cameras_are_read(source: Path) -> None:
    recording = import_published(source, CAMPUS, (4, 6))
    assert recording.num_slots == 3 and recording.rig.camera_ids == (
        "Camera0",
        "Camera1",
        "Camera2",
    )
    for found, true in zip(recording.rig.cameras, RIG.cameras, strict=True):
        assert pytest.approx(true.K, abs=1e-6) == found.K
        assert found.center_m == pytest.approx(true.center_m, abs=1e-9)
        assert found.image_size == (360, 288)
    assert recording.truth is not None and np.isnan(recording.truth.joints_m).all()  # not scored


def test_frames_outside_the_protocol_are_not_scored(source: Path) -> None:
    layout = type(CAMPUS)("Campus", "calibration_campus.json", 3, (360, 288), (4, 6), ((5, 6),))
    recording = import_published(source, layout)
    assert recording.truth is not None
    joints = recording.truth.joints_m
    assert np.isnan(joints[0]).all() and np.isnan(joints[2, 1]).all()
    assert joints[1, :, 0, 0] == pytest.approx([0.5, 0.5])
    assert joints[2, 0, 0, 0] == pytest.approx(0.6)


def test_what_was_detected_on_the_images_joins_by_their_numbers(
    source: Path, tmp_path: Path
) -> None:
    views = []
    for camera in range(3):
        frames = [
            Poses2D(np.full((1, 17, 2), 10.0 * s + camera), np.ones((1, 17))) for s in range(6)
        ]
        views.append(ViewSeries.from_views(frames, range(6), [s / 25 for s in range(6)], 17))
    rig = import_published(source, CAMPUS, (4, 6)).rig
    found = Recording("found", rig, 25.0, 6, COCO17, tuple(views), detector="openpose-thin")
    save_recording(found, tmp_path / "found")
    recording = import_published(source, CAMPUS, (4, 6), tmp_path / "found")
    view = recording.view(0, 1)
    assert view is not None and view.keypoints_px[0, 0, 0] == 21.0  # images begin at 2: slot 2
    assert recording.detector == "openpose-thin"


@pytest.mark.parametrize("name", ["actorsGT.mat", "Calibration/P1.txt"])
def test_a_missing_part_is_named_with_its_place(tmp_path: Path, name: str) -> None:
    folder = publish(tmp_path / "Campus")
    (folder / name).unlink()
    with pytest.raises(InputError, match=r"missing: .*campar\.in\.tum\.de") as found:
        import_published(folder, CAMPUS, (4, 6))
    assert Path(name).name in str(found.value)


@each_case("content", [b"", b"1,2,3", b"\xff" * 50, b"0," * 11 + b"0"])
def test_a_broken_matrix_is_named(tmp_path: Path, content: bytes) -> None:
    folder = publish(tmp_path / "Campus")
    (folder / "Calibration" / "P0.txt").write_bytes(content)
    with pytest.raises(InputError, match=r"P0\.txt: found"):
        import_published(folder, CAMPUS, (4, 6))


def test_broken_labels_are_named(tmp_path: Path) -> None:
    folder = publish(tmp_path / "Campus")
    (folder / "actorsGT.mat").write_bytes(b"MATLAB 5.0 MAT-file" + b"\x00" * 200)
    with pytest.raises(InputError, match=r"actorsGT\.mat"):
        import_published(folder, CAMPUS, (4, 6))
    savemat(folder / "actorsGT.mat", {"actor2D": np.zeros(3)})
    with pytest.raises(InputError, match="actor3D: missing"):
        import_published(folder, CAMPUS, (4, 6))


def test_frames_beyond_the_labels_are_refused(source: Path) -> None:
    with pytest.raises(InputError, match="--frames: found 4-9, expected frames of 0 to 7"):
        import_published(source, CAMPUS, (4, 9))
    with pytest.raises(InputError, match="found nothing, expected the folder of Campus"):
        import_published(source / "none", CAMPUS)


def test_a_projection_matrix_is_parted() -> None:
    camera = RIG.cameras[2]
    K, R, t = decomposed(-0.01 * camera.projection)
    assert pytest.approx(camera.projection, abs=1e-9) == K @ np.column_stack([R, t])
    assert np.linalg.det(R) == pytest.approx(1.0)


def voxelpose(folder: Path, **changes: object) -> Path:
    """The same folder with VoxelPose's calibration in place of the projection matrices."""
    publish(folder)
    shutil.rmtree(folder / "Calibration")
    cameras = {
        str(number): {
            "R": camera.R.tolist(),
            "T": (1000 * camera.center_m)[:, None].tolist(),
            "fx": camera.K[0, 0], "fy": camera.K[1, 1], "cx": camera.K[0, 2], "cy": camera.K[1, 2],
            "k": [[0.01], [-0.02], [0.003]], "p": [[0.001], [-0.002]],
            **(changes if number == 1 else {}),
        }
        for number, camera in enumerate(RIG.cameras)
    }  # fmt: skip
    (folder / "calibration_campus.json").write_text(json.dumps(cameras))
    return folder


def test_cameras_of_voxelpose_are_read_where_there_are_no_matrices(tmp_path: Path) -> None:
    recording = import_published(voxelpose(tmp_path / "CampusSeq1"), CAMPUS, (4, 6))
    for found, true in zip(recording.rig.cameras, RIG.cameras, strict=True):
        assert pytest.approx(true.K) == found.K and pytest.approx(true.R) == found.R
        assert found.center_m == pytest.approx(true.center_m, abs=1e-9)
        assert found.distortion.tolist() == [0.01, -0.02, 0.001, -0.002, 0.003]


@each_case(
    ("changes", "words"),
    [
        ({"R": [[1.0]]}, r"camera 1: R: found numbers of shape \(1, 1\), expected \(3, 3\)"),
        ({"T": [[1], [2], [float("nan")]]}, r"camera 1: T: found a value that is not finite"),
        ({"fx": "wide"}, r"camera 1: fx: found 'wide', expected a number"),
        ({"R": np.zeros((3, 3)).tolist()}, r"camera 1: "),
    ],
)
def test_broken_cameras_of_voxelpose_are_named(
    tmp_path: Path, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError, match=r"calibration_campus\.json: " + words):
        import_published(voxelpose(tmp_path / "Campus", **changes), CAMPUS, (4, 6))
    (tmp_path / "Campus" / "calibration_campus.json").write_bytes(b"\xff{")
    with pytest.raises(InputError, match="calibration_campus"):
        import_published(tmp_path / "Campus", CAMPUS, (4, 6))
