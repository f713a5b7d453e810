from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.camera.provenance import Provenance
from e3pose.camera.source import open_video
from e3pose.model.camera import Camera, Rig
from e3pose.model.people import People
from e3pose.model.pose import Poses2D
from e3pose.model.skeleton import Skeleton
from e3pose.model.slot_record import SlotRecord
from e3pose.output.report.overlay import (
    AWAKE_COLOR,
    BLIND_COLOR,
    camera_word,
    draw_poses,
    overlay_images,
    reproject,
    track_color,
    write_movie,
)
from e3pose.recording import Recording, ViewSeries

STICK = Skeleton("stick", ("top", "bottom"), ((0, 1),))
SIZE = (96, 128)  # width, height
RED = (255, 0, 0)


def blank() -> NDArray[np.uint8]:
    return np.full((SIZE[1], SIZE[0], 3), 200, dtype=np.uint8)


def stick(top: tuple[float, float], bottom: tuple[float, float]) -> Poses2D:
    return Poses2D(np.array([[top, bottom]]), np.ones((1, 2)))


def camera(camera_id: str, x_m: float = 0.0) -> Camera:
    """A camera at (x, 0, 0) that looks along z."""
    T = np.eye(4)
    T[0, 3] = x_m
    K = np.array([[100.0, 0, 48], [0, 100, 64], [0, 0, 1]])
    return Camera(camera_id, SIZE, K, T)


def standing(slot: int, selected: list[bool], track_id: int = 0, blind: str = "") -> SlotRecord:
    """A stick from (0, -0.5, 2) to (0, 0.5, 2) metres."""
    joints = np.array([[[0.0, -0.5, 2.0], [0.0, 0.5, 2.0]]])
    people = People(np.array([track_id]), joints)
    awake, nothing = np.array(selected), np.zeros(len(selected))
    return SlotRecord(slot, 0.1 * slot, awake, awake, people, nothing, nothing, awake, blind=blind)


def video(path: Path, levels: list[int], size: tuple[int, int] = SIZE) -> str:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height = size
        stream.pix_fmt, stream.time_base = "yuv420p", Fraction(1, 10)
        for level in levels:
            image = np.full((size[1], size[0], 3), level, dtype=np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    return str(path)


def recording(folder: Path, **videos: str) -> Recording:
    rig = Rig((camera("a"), camera("b", x_m=0.2)))
    views = tuple(ViewSeries.from_views([], [], [], 2) for _ in range(2))
    return Recording("test", rig, 10.0, 8, STICK, views, videos=videos)


def test_limb_is_painted_between_its_joints_only() -> None:
    image = blank()
    drawn = draw_poses(image, stick((48, 20), (48, 100)), STICK, [RED], thickness_px=3)
    assert (image == 200).all()  # the argument stays as it is
    assert [tuple(drawn[y, 48]) for y in (20, 60, 100)] == [RED] * 3
    # A joint's disc and its outline reach 8 px at this thickness.
    assert (drawn[:12] == 200).all() and (drawn[109:] == 200).all()
    assert (drawn[:, :40] == 200).all() and (drawn[:, 57:] == 200).all()


def test_missing_joint_is_not_drawn_nor_its_limb() -> None:
    poses = Poses2D(np.array([[[48.0, 20.0], [48.0, 100.0]]]), np.array([[1.0, 0.0]]))
    drawn = draw_poses(blank(), poses, STICK, [RED], thickness_px=3)
    assert tuple(drawn[20, 48]) == RED and (drawn[30:] == 200).all()
    assert (draw_poses(blank(), Poses2D.empty(2), STICK, []) == blank()).all(), "nobody"


@each_case("far", [(1e6, 50.0), (-1e12, -1e12), (48.0, 300.0)])
def test_joint_far_outside_does_no_harm(far: tuple[float, float]) -> None:
    drawn = draw_poses(blank(), stick((48, 20), far), STICK, [RED], thickness_px=3)
    assert drawn.shape == blank().shape and tuple(drawn[20, 48]) == RED


def test_reprojection_lands_on_the_pixels_of_the_pinhole() -> None:
    seen = reproject(standing(0, [True]).people, camera("a"))
    np.testing.assert_allclose(seen.keypoints_px[0], [[48, 39], [48, 89]])
    behind = People(np.array([0]), np.array([[[0.0, 0.0, -2.0], [0.0, 0.0, 2.0]]]))
    assert reproject(behind, camera("a")).scores.tolist() == [[0.0, 1.0]]
    assert len(reproject(People.empty(2), camera("a"))) == 0


def test_colors_of_tracks_are_stable_and_apart() -> None:
    colors = np.array([track_color(i) for i in range(8)], dtype=float)
    apart = np.linalg.norm(colors[:, None] - colors[None], axis=-1) + 1e3 * np.eye(8)
    assert apart.min() > 60
    assert track_color(5) == track_color(5)


def test_panels_show_each_slots_frame_with_its_skeleton(tmp_path: Path) -> None:
    files = {"a": video(tmp_path / "a.mp4", [60, 100, 140, 180]), "b": ""}
    files["b"] = video(tmp_path / "b.mp4", [180] * 4)
    records = [standing(1, [True, False]), standing(3, [True, True])]
    first, second = overlay_images(recording(tmp_path, **files), records, height_px=SIZE[1])
    width = SIZE[0]
    assert first.shape == (SIZE[1], 2 * width + 4, 3)
    corner = (110, 20)
    assert abs(int(first[corner][0]) - 100) < 4 and abs(int(second[corner][0]) - 180) < 4
    asleep, awake = first[corner[0], width + 4 + 20], second[corner[0], width + 4 + 20]
    assert int(asleep[0]) < 100 and abs(int(awake[0]) - 180) < 4
    color = np.array(track_color(0))
    assert np.abs(first[64, 48] - color).max() < 40  # the stick's middle in camera a
    assert np.abs(first[64, width + 4 + 38] - color).max() < 40  # 10 px to the left in camera b
    assert np.abs(first[64, width + 4 + 48].astype(int) - color).max() > 60


def test_a_picture_of_another_shape_has_its_skeleton_where_the_person_is(tmp_path: Path) -> None:
    files = {"a": video(tmp_path / "a.mp4", [180] * 2, (3 * SIZE[0], SIZE[1]))}
    records = [standing(1, [True, False])]
    (drawn,) = overlay_images(recording(tmp_path, **files), records, height_px=SIZE[1])
    apart = np.abs(drawn[64].astype(int) - track_color(0)).max(axis=1)  # of the stick's middle
    assert apart[3 * 48 + 1] < 40 and apart[48] > 60


def test_blind_slot_is_drawn_in_a_colour_of_its_own(tmp_path: Path) -> None:
    files = {"a": video(tmp_path / "a.mp4", [180] * 4)}
    records = [standing(0, [True]), standing(1, [True], blind="views-late"), standing(2, [False])]
    active, blind, idle = overlay_images(recording(tmp_path, **files), records, height_px=SIZE[1])
    assert active[64, 1].tolist() == list(AWAKE_COLOR)
    assert blind[64, 1].tolist() == list(BLIND_COLOR)
    assert int(blind[110, 20, 0]) < 100 and int(idle[64, 1, 0]) < 100
    assert camera_word(records[1], 0) == "blind: views late"


def test_video_start_moves_the_frames(tmp_path: Path) -> None:
    files = {"a": video(tmp_path / "a.mp4", [60, 100, 140, 180])}

    def levels(start_s: float, *slots: int) -> list[int]:
        source, begun = recording(tmp_path, **files), Provenance({}, {"a": start_s})
        records = [standing(slot, [True, True]) for slot in slots]
        images = overlay_images(source, records, height_px=SIZE[1], provenance=begun)
        return [int(image[110, 20, 0]) for image in images]

    assert levels(0.2, 0) == pytest.approx([140], abs=4)
    # Before its first frame it is black, and its last stays.
    black, *others = levels(-0.2, 0, 2, 7)
    assert black == 0 and others == pytest.approx([60, 180], abs=4)


@each_case("name", ["../../etc/passwd", "sub/a.mp4", "..", "gone.mp4"])
def test_video_name_stays_inside_the_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError):
        next(overlay_images(recording(tmp_path, a=name), [standing(0, [True, True])], tmp_path))
    with pytest.raises(InputError, match="no videos"):
        next(overlay_images(recording(Path()), [standing(0, [True, True])]))


@each_case("suffix", [".webm", ".mp4", ".mkv"])
def test_movie_can_be_read_back(tmp_path: Path, suffix: str) -> None:
    images = [np.full((49, 65, 3), 40 * i, dtype=np.uint8) for i in range(6)]
    path = tmp_path / f"movie{suffix}"
    assert write_movie(path, iter(images), fps=12.5) == 6
    source = open_video(path)
    frames = list(source)
    assert source.image_size == (64, 48) and len(frames) == 6
    np.testing.assert_allclose([f.time_s for f in frames], np.arange(6) / 12.5, atol=2e-3)
    levels = [float(frame.image.mean()) for frame in frames]
    np.testing.assert_allclose(levels, 40 * np.arange(6), atol=6)


def broken(shape: tuple[int, int, int]) -> Any:
    yield np.zeros((48, 64, 3), dtype=np.uint8)
    yield np.zeros(shape, dtype=np.uint8)


def test_movie_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    for images, words in [(iter([]), "no image"), (broken((10, 10, 3)), "image 1: found shape")]:
        with pytest.raises(InputError, match=words):
            write_movie(tmp_path / "a.webm", images, 10)
    with pytest.raises(InputError, match="suffix"):
        write_movie(tmp_path / "a.exe", broken((48, 64, 3)), 10)
    assert list(tmp_path.iterdir()) == []
