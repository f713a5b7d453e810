"""The two published networks on real frames: against an eye's reading and each other."""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from e3pose.base.errors import InputError
from e3pose.detectors import Detector, make_detector
from e3pose.detectors.weights import MODELS, FromIndex, extract_member, fetch_from_index
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import COCO17, convert

VIDEOS = "Pose2Sim/Demo_MultiPerson/videos/"
WHEEL_SHA256 = "403e0dc4065898ba6a595e72a8970950310979253d60e24c2e00b16b36bf21e1"
FRAME = 30

# Read by eye off frame 30 of cam03 (1088 x 1920 pixels): a man bending, a woman standing.
MAN = {
    "left_elbow": (388, 885), "right_elbow": (675, 575), "left_knee": (503, 1012),
    "left_ankle": (555, 1185), "right_ankle": (700, 1075),
}  # fmt: skip
WOMAN = {
    "right_elbow": (177, 715), "right_wrist": (205, 797), "right_ankle": (255, 1000),
    "nose": (265, 555), "right_shoulder": (187, 625), "left_shoulder": (305, 615),
}  # fmt: skip
EYE_PX = 40  # how well an eye and a network agree on where a joint is; people are 800 px tall

pytestmark = [pytest.mark.network, pytest.mark.shared]


def shared_model(folder: str, sha256: str) -> Path:
    shared = os.environ.get("E3POSE_SHARED")
    if not shared:
        pytest.skip("E3POSE_SHARED is not set")
    for path in (Path(shared) / "models" / folder).glob("*.onnx"):
        if hashlib.sha256(path.read_bytes()).hexdigest() == sha256:
            return path
    pytest.skip(f"no {folder} with sha256 {sha256}")


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> list[NDArray[np.uint8]]:
    """Frame 30 of the four cameras of Pose2Sim's demonstration, from its wheel."""
    import av

    folder = tmp_path_factory.mktemp("frames")
    try:
        wheel = fetch_from_index("pose2sim", "0.10.49", "wheel", WHEEL_SHA256, folder / "w.whl")
    except InputError as error:
        pytest.skip(str(error))
    images = []
    with zipfile.ZipFile(wheel) as archive:
        for camera in range(1, 5):
            with av.open(archive.open(f"{VIDEOS}cam{camera:02d}.mp4")) as video:
                for index, frame in enumerate(video.decode(video=0)):
                    if index == FRAME:
                        images.append(frame.to_ndarray(format="rgb24"))
                        break
    return images


@pytest.fixture(scope="module")
def movenet() -> Detector:
    name = "movenet-multipose"
    return make_detector(name, shared_model(name, MODELS[name].sha256), "cpu")


THIN_ONNX_SHA256 = "68d9f90a9d216847cf9d3b47b0bd955385a8c02847f96364801f25adaf6ec069"


@pytest.fixture(scope="module")
def openpose() -> Detector:
    return make_detector("openpose-thin", shared_model("openpose-thin", THIN_ONNX_SHA256), "cpu")


def coco17(detector: Detector, image: NDArray[np.uint8]) -> Poses2D:
    poses = detector.detect(image)
    return Poses2D(*convert(poses.keypoints_px, poses.scores, detector.skeleton, COCO17))


def nearest(poses: Poses2D, keypoints_px: NDArray[np.float64]) -> tuple[int, NDArray[np.float64]]:
    """The pose nearest to `(17, 2)` keypoints, and its distance joint by joint."""
    errors = np.linalg.norm(poses.keypoints_px - keypoints_px, axis=-1)
    return int(np.argmin(np.nanmedian(errors, axis=1))), errors


@pytest.mark.parametrize("which", ["movenet", "openpose"])
def test_skeletons_sit_on_the_people(
    which: str, request: pytest.FixtureRequest, frames: list[NDArray[np.uint8]]
) -> None:
    poses = coco17(request.getfixturevalue(which), frames[2])
    assert len(poses) == 2
    rows = set()
    for joints in (MAN, WOMAN):
        truth = np.full((17, 2), np.nan)
        for joint, where in joints.items():
            truth[COCO17.index(joint)] = where
        row, errors = nearest(poses, truth)
        assert np.nanmax(errors[row]) < EYE_PX
        assert np.isfinite(errors[row]).sum() >= len(joints) - 1
        rows.add(row)
    assert len(rows) == 2


def test_two_independent_networks_agree(
    movenet: Detector, openpose: Detector, frames: list[NDArray[np.uint8]]
) -> None:
    distances = []
    for image in frames:
        one, other = coco17(movenet, image), coco17(openpose, image)
        assert len(one) == len(other) >= 2
        for person in one.keypoints_px:
            row, errors = nearest(other, person)
            distances.append(errors[row, 5:])  # the body; faces here are small or turned away
    joined = np.concatenate(distances)
    joined = joined[np.isfinite(joined)]
    assert len(joined) > 100 and np.median(joined) < 15 and (joined < 60).mean() > 0.9


@pytest.mark.parametrize("which", ["movenet", "openpose"])
def test_a_mirrored_image_gives_mirrored_people(
    which: str, request: pytest.FixtureRequest, frames: list[NDArray[np.uint8]]
) -> None:
    """An offset in the pixel convention would show twice: 4 image pixels are one of the input."""
    detector: Detector = request.getfixturevalue(which)
    swapped = [
        COCO17.index(
            joint.replace("left", "L").replace("right", "left").replace("L", "right")
        )
        for joint in COCO17.joints
    ]  # fmt: skip
    offsets = []
    for image in frames[1:3]:
        plain = coco17(detector, image)
        mirrored = coco17(detector, np.ascontiguousarray(image[:, ::-1]))
        back = mirrored.keypoints_px[:, swapped]
        back[..., 0] = image.shape[1] - 1 - back[..., 0]
        for person in plain.keypoints_px:
            row, errors = nearest(Poses2D(back, mirrored.scores[:, swapped]), person)
            same = errors[row] < 60
            offsets.append((person[same, 0] - back[row][same, 0]) / 2)
    assert abs(np.median(np.concatenate(offsets))) < 2.5


def test_the_published_graph_equals_the_onnx(
    openpose: Detector, frames: list[NDArray[np.uint8]], pulled_graph: Callable[[], Path]
) -> None:
    graph = make_detector("openpose-thin", pulled_graph())
    for image in frames[:2]:
        one, other = openpose.detect(image), graph.detect(image)
        np.testing.assert_allclose(one.keypoints_px, other.keypoints_px, atol=0.05)
        np.testing.assert_allclose(one.scores, other.scores, atol=1e-3)


@pytest.fixture
def pulled_graph(tmp_path: Path) -> Callable[[], Path]:
    def pull() -> Path:
        source = MODELS["openpose-thin"].source
        assert isinstance(source, FromIndex)
        try:
            archive = fetch_from_index(
                source.project, source.version, "sdist", source.sha256, tmp_path / "a.tar.gz"
            )
        except InputError as error:
            pytest.skip(str(error))
        return extract_member(
            archive,
            source.member,
            MODELS["openpose-thin"].size_bytes,
            MODELS["openpose-thin"].sha256,
            tmp_path / "graph_opt.pb",
        )

    return pull


def test_a_dark_frame_has_nobody(movenet: Detector, openpose: Detector) -> None:
    for detector in (movenet, openpose):
        assert len(detector.detect(np.zeros((480, 640, 3), np.uint8))) == 0
