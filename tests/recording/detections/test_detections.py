from __future__ import annotations

import json
import pickle
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.model.skeleton import COCO17, SKELETONS
from e3pose.recording import Recording, load_recording, save_recording
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.recording.detections.forms import MAX_FILE_BYTES, SUFFIXES
from e3pose.recording.detections.importing import (
    ImportSettings,
    import_detections,
    read_detections,
)
from e3pose.recording.detections.layouts import LAYOUTS, named_layout
from e3pose.recording.problems import find_problems
from e3pose.recording.videos import frame_numbers

K = [[900, 0, 640], [0, 900, 360], [0, 0, 1]]
STRICT = ImportSettings(strict=True)
# A person who stands, by joint: x and y in pixels.
OWN = """format = "e3pose-skeleton"
version = 1
parts = ["coco17"]
joints = ["sternum"]
limbs = ["left_shoulder sternum right_shoulder"]
"""
BODY = {
    "nose": (300, 100), "left_eye": (306, 95), "right_eye": (294, 95), "left_ear": (314, 98),
    "right_ear": (286, 98), "left_shoulder": (336, 150), "right_shoulder": (264, 150),
    "left_elbow": (345, 212), "right_elbow": (255, 212), "left_wrist": (350, 265),
    "right_wrist": (250, 265), "left_hip": (321, 262), "right_hip": (279, 262),
    "left_knee": (323, 350), "right_knee": (277, 350), "left_ankle": (324, 438),
    "right_ankle": (276, 438), "neck": (300, 150), "mid_hip": (300, 262), "top_head": (300, 70),
    "left_heel": (322, 448), "right_heel": (278, 448), "left_big_toe": (330, 455),
    "right_big_toe": (270, 455), "left_small_toe": (336, 453), "right_small_toe": (264, 453),
}  # fmt: skip


def person(layout: str = "coco17", x: float = 0.0, score: float = 0.9) -> list[list[float]]:
    """Keypoints of somebody in an order of them; what the order has beyond is at (9, 9)."""
    name, _, count = layout.partition(" ")
    joints = SKELETONS[name].joints
    rows = [[9.0, 9.0, 0.5]] * int(count or len(joints))
    for column, joint in enumerate(joints):
        if joint in BODY:
            rows[column] = [BODY[joint][0] + x, BODY[joint][1], score]
    return rows


def openpose(*people: Sequence[Sequence[float]], **more: Any) -> dict[str, Any]:
    return {"people": [{"pose_keypoints_2d": np.ravel(p).tolist(), **more} for p in people]}


def write(path: Path, content: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    return rig_of(tmp_path, "cam1", "cam2")


def rig_of(tmp_path: Path, *camera_ids: str) -> Path:
    cameras = tuple(
        Camera.from_world_to_camera(name, (1280, 720), K, np.eye(3), [0.5 * n, 0, 3])
        for n, name in enumerate(camera_ids)
    )
    save_rig(Rig(cameras), tmp_path / "rig.toml")
    return tmp_path / "rig.toml"


def counts(recording: Recording) -> list[list[int | None]]:
    """People of each slot by camera; None where the view is lost."""
    found = []
    for camera in range(len(recording.rig)):
        views = [recording.view(slot, camera) for slot in range(recording.num_slots)]
        found.append([None if view is None else len(view) for view in views])
    return found


@each_case("layout", [f"{each.skeleton.name} {each.count}" for each in LAYOUTS])
def test_orders_of_keypoints_keep_all_joints(tmp_path: Path, layout: str) -> None:
    source, name = tmp_path / "json", layout.split()[0]
    for camera in ("cam1", "cam2"):
        write(source / camera / "0_keypoints.json", openpose(person(layout)))
    recording, notes = import_detections(source, rig_of(tmp_path, "cam1", "cam2"), 25)
    assert recording.skeleton == SKELETONS[name] and recording.detector == ""
    view = recording.view(0, 0)
    assert view is not None
    for joint, xy in zip(recording.skeleton.joints, view.keypoints_px[0], strict=True):
        assert xy.tolist() == pytest.approx(BODY.get(joint, (9.0, 9.0))), joint
    beyond = int(layout.split()[1]) - len(recording.skeleton)
    assert (f"{beyond} of {layout.split()[1]} joints not used" in "".join(notes)) == (beyond > 0)


def test_an_order_that_limbs_contradict_is_named(tmp_path: Path, calibration: Path) -> None:
    for layout, other in (("body25", "body25b"), ("coco17", "h36m17")):
        for wrong in (False, True):
            rows = person(other if wrong else layout)
            source = write(tmp_path / "json/cam1/0.json", openpose(*[rows] * 20)).parent.parent
            settings = ImportSettings(skeleton=layout)
            recording, _ = import_detections(source, calibration, 25, settings)
            found = [one.message for one in find_problems(recording) if one.kind == "skeleton"]
            assert bool(found) == wrong and all(f"--skeleton {other}" in one for one in found)


def test_a_recording_keeps_a_skeleton_of_its_own(tmp_path: Path, calibration: Path) -> None:
    write(tmp_path / "mine.toml", OWN)
    rows = [*person(), [300.0, 200.0, 0.7]]
    source = write(tmp_path / "json/cam1/0.json", openpose(rows)).parent.parent
    settings = ImportSettings(skeleton=str(tmp_path / "mine.toml"))
    recording, notes = import_detections(source, calibration, 25, settings)
    save_recording(recording, tmp_path / "walk")
    again = load_recording(tmp_path / "walk")
    assert again.skeleton == recording.skeleton and again.skeleton.name == "mine"
    assert again.skeleton.joints[-1] == "sternum" and not any("not used" in n for n in notes)
    view = again.view(0, 0)
    assert view is not None and view.keypoints_px[0, -1].tolist() == [300.0, 200.0]
    (tmp_path / "walk" / "skeleton-mine.toml").unlink()
    with pytest.raises(InputError, match="skeleton 'mine': found no such skeleton, expected skel"):
        load_recording(tmp_path / "walk")
    header = tmp_path / "walk" / "recording.toml"
    text = header.read_text()
    for name in ("../..", "../../etc/passwd", "a/b", ".", "", "x" * 300):
        header.write_text(text.replace('skeleton = "mine"', f'skeleton = "{name}"'))
        with pytest.raises(InputError, match="no such skeleton, expected one of coco17, "):
            load_recording(tmp_path / "walk")


def test_joints_that_are_left_are_named(tmp_path: Path, calibration: Path) -> None:
    source = write(tmp_path / "json/cam1/0.json", openpose(person("coco133"))).parent.parent
    settings = ImportSettings(skeleton="coco17")
    recording, notes = import_detections(source, calibration, 25, settings)
    assert recording.skeleton == COCO17
    assert "116 of 133 joints not used: left_big_toe, left_small_toe, " in "".join(notes)


def test_an_order_that_limbs_do_not_tell_is_asked_for(tmp_path: Path, calibration: Path) -> None:
    dots = [[9.0 * i, 50.0, 0.9 * (i in (0, 5, 6))] for i in range(25)]
    source = write(tmp_path / "json" / "cam1" / "0.json", openpose(dots)).parent.parent
    with pytest.raises(InputError, match="body25 or body25b, and limbs do not tell which"):
        import_detections(source, calibration, 25)
    settings = ImportSettings(skeleton="body25")
    assert import_detections(source, calibration, 25, settings)[0].skeleton.name == "body25"
    with pytest.raises(InputError, match="--skeleton: found 'coco17', expected of 25: body25, bo"):
        import_detections(source, calibration, 25, ImportSettings(skeleton="coco17"))


def test_people_land_in_their_camera_and_slot(tmp_path: Path, calibration: Path) -> None:
    source = tmp_path / "json"
    write(source / "cam1_json/w2_000005_keypoints.json", openpose(person()))
    write(source / "cam1_json/w2_000007_keypoints.json", openpose(person(), person(x=500)))
    write(source / "cam2_json/w2_000006_keypoints.json", {"people": []})
    recording, _ = import_detections(source, calibration, fps=50.0)
    assert counts(recording) == [[1, None, 2], [None, 0, None]]
    np.testing.assert_allclose(recording.views[0].times_s, [0, 0.04])


MMPOSE = {"frame_id": 4, "instances": [
    {"keypoints": [row[:2] for row in person()], "keypoint_scores": [0.9] * 17}]}  # fmt: skip
RESULT = {"image_id": "cam1/4.jpg", "category_id": 1, "keypoints": np.ravel(person()).tolist()}
WHOLE = {
    **RESULT,
    "foot_kpts": np.ravel(person("coco23")[17:]).tolist(),
    "face_kpts": [5.0, 5.0, 1.0] * 68,
    "lefthand_kpts": [5.0, 5.0, 1.0] * 21,
    "righthand_kpts": [5.0, 5.0, 1.0] * 21,
}
HANDS_AND_FACE = openpose(
    person("body25"),
    hand_left_keypoints_2d=[5.0, 5.0, 1.0] * 21,
    hand_right_keypoints_2d=[6.0, 6.0, 1.0] * 21,
    face_keypoints_2d=[7.0, 7.0, 1.0] * 70,
)
LANDMARKS = [{"x": x / 1280, "y": y / 720, "z": 0.1, "visibility": v}
             for x, y, v in person("mediapipe33")]  # fmt: skip
DLC_NAMES = [joint.title().replace("_", " ") for joint in COCO17.joints]
DLC = "\n".join([
    ",".join(["scorer", *["net"] * 51]),
    ",".join(["bodyparts", *[name for name in DLC_NAMES for _ in range(3)]]),
    ",".join(["coords", *["x", "y", "likelihood"] * 17]),
    ",".join(["4", *map(str, np.ravel(person()))]),
])  # fmt: skip
POINTS = "\n".join([
    "sync_index,port,frame_index,frame_time,point_id,img_loc_x,img_loc_y",
    *(f"4,1,7,0.1,{i},{x},{y}" for i, (x, y, _) in enumerate(person("mediapipe33"))),
])  # fmt: skip


ROWS = np.array(person())
COLUMNS = dict(zip(("x", "y", "visible"), ROWS.T.tolist(), strict=True))
SHARES = ROWS / [1280.0, 720.0, 1.0]
YOLO = " ".join(map(str, [0, 0.5, 0.5, 0.1, 0.1, *SHARES.ravel()]))
NODES = ",".join(f"{j}.x,{j}.y,{j}.score" for j in SKELETONS["coco17"].joints)
SLEAP = f"track,frame_idx,instance.score,{NODES}\na,4,0.9,{','.join(map(str, ROWS.ravel()))}\n"


@each_case(
    ("file", "content", "skeleton"),
    [
        ("cam1/4.json", [{"name": "person", "keypoints": COLUMNS}], "coco17"),
        ("cam1/4.json", {"bodies": [{"joints": ROWS.ravel().tolist()}]}, "coco17"),
        ("cam1/4.json", {"pose_landmarks": [LANDMARKS]}, "mediapipe33"),
        ("cam1/4.json", {"pose_landmarks": LANDMARKS}, "mediapipe33"),
        ("cam1/4.json", openpose((SHARES * [2, 2, 1] - [1, 1, 0]).tolist()), "coco17"),
        ("cam1/clip_4.txt", YOLO, "coco17"),
        ("cam1.csv", SLEAP, "coco17"),
        ("", {"images": [{"id": 1, "file_name": "cam1_004.jpg"}],
              "annotations": [{**RESULT, "image_id": 1}]}, "coco17"),
        ("cam1/x_04_keypoints.json", openpose(person()), "coco17"),
        ("cam1/4.json", MMPOSE, "coco17"),
        ("cam1.json", {"meta_info": {}, "instance_info": [MMPOSE]}, "coco17"),
        ("cam1.json", [{**RESULT, "image_id": "4.jpg"}], "coco17"),
        ("cam1/alphapose-results.json", [{**RESULT, "image_id": "4.jpg"}], "coco17"),
        ("cam1.json", {"4.jpg": openpose(person())}, "coco17"),
        ("", [RESULT], "coco17"),
        ("", [WHOLE], "coco133"),
        ("cam1/4.json", {"keypoints": [[row[:2] for row in person()]], "scores": [[0.9] * 17]},
         "coco17"),
        ("cam1/4.json", {"people": [{"landmarks": LANDMARKS}]}, "mediapipe33"),
        ("cam1.csv", DLC, "coco17"),
        ("", POINTS, "mediapipe33"),
        ("cam1/4_keypoints.json", HANDS_AND_FACE, "openpose137"),
    ],
)  # fmt: skip
def test_forms_of_tools_are_told_by_their_fields(
    tmp_path: Path, file: str, content: Any, skeleton: str
) -> None:
    calibration = rig_of(tmp_path, "cam1", "cam2")
    one = "all.csv" if isinstance(content, str) else "all.json"
    source = write(tmp_path / "in" / (file or one), content)
    recording, _ = import_detections(tmp_path / "in" if file else source, calibration, 25)
    view = recording.view(0, recording.rig.index("cam1"))
    assert view is not None and recording.skeleton.name == skeleton
    joints = recording.skeleton.joints
    for joint in ("left_wrist", "right_ankle", "left_shoulder", "nose"):
        xy = view.keypoints_px[0, joints.index(joint)]
        assert xy.tolist() == pytest.approx(BODY[joint], abs=1e-6), joint


def test_hands_of_mediapipe_are_people_of_21_joints(tmp_path: Path, calibration: Path) -> None:
    hands = [[{"x": x + i / 100, "y": 0.5, "z": 0.1, "visibility": 0.0} for i in range(21)]
             for x in (0.1, 0.6)]  # fmt: skip
    write(tmp_path / "json/cam1/4.json", {"hand_landmarks": hands, "handedness": ["Left", "Right"]})
    with pytest.raises(InputError, match="expected --skeleton left_hand21 or right_hand21"):
        import_detections(tmp_path / "json", calibration, 25)
    settings = ImportSettings(skeleton="left_hand21")
    view = import_detections(tmp_path / "json", calibration, 25, settings)[0].view(0, 0)
    assert view is not None and view.scores.tolist() == [[1.0] * 21] * 2
    assert view.keypoints_px[1, 0].tolist() == pytest.approx([0.6 * 1280, 360])


def test_arrays_of_cameras_and_frames_are_read(tmp_path: Path, calibration: Path) -> None:
    array = np.full((2, 3, 33, 3), np.nan)
    array[0, 2], array[1, 0] = person("mediapipe33"), person("mediapipe33")
    np.save(tmp_path / "mediapipe2d.npy", array)
    recording, _ = import_detections(tmp_path / "mediapipe2d.npy", calibration, 25)
    assert counts(recording) == [[0, 0, 1], [1, 0, 0]]
    (tmp_path / "each").mkdir()
    for camera, own in zip(("cam1", "cam2"), array, strict=True):
        np.save(tmp_path / "each" / f"{camera}.npy", own)
    assert counts(import_detections(tmp_path / "each", calibration, 25)[0]) == counts(recording)
    with pytest.raises(InputError, match="expected <camera>/<frame>"):  # whose it is nobody says
        import_detections(tmp_path / "each" / "cam1.npy", calibration, 25)
    np.save(tmp_path / "bad.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match=r"bad\.npy"):
        import_detections(tmp_path / "bad.npy", calibration, 25)


def deeplabcut_h5(path: Path, names: bytes, values: Any) -> Path:
    """A table as pandas writes it by PyTables."""
    rows = np.zeros(
        len(values), dtype=[("index", "<i8"), ("values_block_0", "<f8", len(values[0]))]
    )
    rows["index"], rows["values_block_0"] = range(4, 4 + len(values)), values
    with h5py.File(path, "w") as file:
        table = file.create_group("df_with_missing").create_dataset("table", data=rows)
        table.attrs["values_block_0_kind"] = np.bytes_(names)
    return path


def sleap_h5(path: Path, matlab: bool, **more: Any) -> Path:
    tracks = np.full((3, 2, 17, 3), np.nan)  # frames, tracks, nodes, x y score
    tracks[1, 0], tracks[2, 1] = person(), person(x=400)
    places, scores = tracks[..., :2], tracks[..., 2]
    if matlab:
        places, scores = places.transpose(1, 3, 2, 0), scores.transpose(1, 2, 0)
    with h5py.File(path, "w") as file:
        file["node_names"] = np.array([name.encode() for name in DLC_NAMES])
        for key, value in {"tracks": places, "point_scores": scores, **more}.items():
            file[key] = value
    return path


def test_hdf5_of_sleap_and_deeplabcut_is_read(tmp_path: Path) -> None:
    calibration = rig_of(tmp_path, "cam1", "cam2")
    columns = [
        ("net", who, name, coord)
        for who in ("a", "b") for name in DLC_NAMES for coord in ("x", "y", "likelihood")
    ]  # fmt: skip
    values = np.full((2, 102), np.nan)
    values[0, :51], values[1, 51:] = np.ravel(person()), np.ravel(person(x=400))
    (tmp_path / "in").mkdir()
    for protocol in (0, 2, 4):
        deeplabcut_h5(tmp_path / "in/cam1.h5", pickle.dumps(columns, protocol), values)
        for matlab in (True, False):
            sleap_h5(tmp_path / "in/cam2.analysis.h5", matlab)
            recording, _ = import_detections(tmp_path / "in", calibration, 25)
            # Frames 4 and 5 of one camera, 0 to 2 of the other.
            assert counts(recording)[0][4:] == [1, 1] and counts(recording)[1][:3] == [0, 1, 1]
            for slot, camera in ((4, 0), (1, 1)):
                view = recording.view(slot, camera)
                assert view is not None and recording.skeleton == COCO17
                assert view.keypoints_px[0].tolist() == [list(BODY[j]) for j in COCO17.joints]
                np.testing.assert_allclose(view.scores, 0.9)


class Runs:
    """What would write a file if it were unpickled."""

    def __reduce__(self) -> Any:
        return Path.touch, (Path("ran"),)


def test_hdf5_that_would_run_or_leave_the_file_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    calibration, values = rig_of(tmp_path, "cam1", "cam2"), np.zeros((2, 51))
    odd = {
        "runs": deeplabcut_h5(tmp_path / "a.h5", pickle.dumps([Runs()], 0), values),
        "broken": deeplabcut_h5(tmp_path / "b.h5", b"(lp0\n(VDLC", values),
        "nameless": deeplabcut_h5(tmp_path / "c.h5", b"", values),
        "shape": sleap_h5(tmp_path / "d.h5", True, tracks=np.zeros((2, 2))),
        "link": sleap_h5(tmp_path / "e.h5", True, tracks=h5py.ExternalLink("d.h5", "tracks")),
        "text": write(tmp_path / "f.h5", "no HDF5"),
    }
    with h5py.File(tmp_path / "g.h5", "w") as file:
        file["other"] = [1.0]
    for name, path in {**odd, "other": tmp_path / "g.h5"}.items():
        with pytest.raises(InputError, match=re.escape(str(path))) as caught:
            import_detections(path, calibration, 25)
        assert "\n" not in str(caught.value) and not Path("ran").exists(), name


@each_case("missing", [[None, None, None], [-1, -1, -1], [0, 0, 0], [9, 9, 0], ["", "", 1],
                       [5.0, float("nan"), 1.0]])  # fmt: skip
def test_what_tools_write_for_missing_is_missing(tmp_path: Path, missing: list[Any]) -> None:
    calibration = rig_of(tmp_path, "cam1", "cam2")
    rows: list[Any] = person()
    rows[3] = missing
    flat = [value for row in rows for value in row]
    content = {"people": [{"pose_keypoints_2d": flat}]}
    write(tmp_path / "json/cam1/0.json", content)
    view = import_detections(tmp_path / "json", calibration, 25)[0].view(0, 0)
    assert view is not None and view.scores[0, 3] == 0 and view.scores[0, 4] == 0.9


def test_scores_on_another_scale_are_divided(tmp_path: Path, calibration: Path) -> None:
    for scale, expected, told in ((1.04, 1.0, False), (4.0, 1.0, True), (0.5, 0.5, False)):
        write(tmp_path / "json/cam1/0.json", openpose(person(score=scale)))
        recording, notes = import_detections(tmp_path / "json", calibration, 25)
        view = recording.view(0, 0)
        assert view is not None and view.scores[0, 0] == expected
        assert ("divided by it (--score-scale)" in "".join(notes)) == told
    settings = ImportSettings(score_scale=2.0)
    view = import_detections(tmp_path / "json", calibration, 25, settings)[0].view(0, 0)
    assert view is not None and view.scores[0, 0] == 0.25


def test_one_odd_entry_among_many_costs_that_entry(tmp_path: Path, calibration: Path) -> None:
    good = [{**RESULT, "image_id": f"cam1/{i}.jpg"} for i in range(20)]
    flat = np.array(good[0]["keypoints"])
    shares = [{**one, "keypoints": (flat.reshape(-1, 3) / [1280, 720, 1]).ravel().tolist()}
              for one in good]  # fmt: skip
    far, high = [*shares[0]["keypoints"]], flat.tolist()
    far[3], high[2] = 1e7, 1e6
    for results, odd, why in (
        (good, {"keypoints": high}, "score: found 1e+06"),
        (shares, {"keypoints": far}, "beyond 1e+06 px"),
        (good, {"image_id": "eve/20.jpg"}, "found 'eve/20.jpg', expected <camera>/<frame>"),
        (good, {"image_id": "cam1/last.jpg"}, "'last.jpg': found no frame number"),
        (good, {"image_id": f"cam1/{'1' * 400}.jpg"}, "found no frame number"),
    ):
        results = [*results, {**results[0], "image_id": "cam1/20.jpg", **odd}]
        source = write(tmp_path / "all.json", results)
        recording, notes = import_detections(source, calibration, 25)
        assert "left out 1 item" in notes[0] and why in notes[0], notes
        for slot in range(20):
            view = recording.view(slot, 0)
            assert view is not None and view.scores[0, 0] == pytest.approx(0.9)
            assert view.keypoints_px[0, 0].tolist() == pytest.approx(BODY["nose"])
        with pytest.raises(InputError, match=re.escape(why)):
            import_detections(source, calibration, 25, STRICT)


def test_shares_of_the_image_are_taken_times_its_size(tmp_path: Path, calibration: Path) -> None:
    shares = [[x / 1280, y / 720, score] for x, y, score in person()]
    write(tmp_path / "json/cam1/0.json", openpose(shares))
    recording, notes = import_detections(tmp_path / "json", calibration, 25)
    view = recording.view(0, 0)
    assert view is not None and "shares of the image" in notes[-1]
    assert view.keypoints_px[0, 0].tolist() == pytest.approx(BODY["nose"])


@each_case(
    ("content", "message"),
    [
        ("", "an empty file"),
        ('{"people": [{"pose_keypoi', "truncated"),
        ("{}", "found fields"),
        ("3", "found int"),
        ({"people": [{"pose": []}]}, "found no keypoints"),
        ({"people": [{"pose_keypoints_2d": [1.0] * 50}]}, "found 50 numbers"),
        ({"people": [{"pose_keypoints_2d": ["left"] * 51}]}, "not numbers"),
        ({"people": [{"pose_keypoints_2d": [1e9, 5.0, 0.5] * 17}]}, r"beyond 1e\+06 px"),
        ({"people": [{"pose_keypoints_2d": [1.0] * 54}]}, "1 person without 51"),
        ({"people": [{"pose_keypoints_2d": [[1.0]] * 51}]}, "shape"),
        ({"keypoints": [{"0": [[1.0, 2.0, 0.5]] * 17}]}, "shape"),
        ({"people": 3}, "found fields"),
        ({"people": [3]}, "expected a person"),
        ('{"x": ' + "[" * 200_000, "expected people"),
        ('{"people": NaN}', "found fields"),
    ],
)
def test_one_bad_file_costs_that_view(tmp_path: Path, content: Any, message: str) -> None:
    calibration, source = rig_of(tmp_path, "cam1", "cam2"), tmp_path / "json"
    write(source / "cam1/0_keypoints.json", content)
    write(source / "cam1/.1_keypoints.json", "hidden")
    write(source / "cam2/0_keypoints.json", openpose(person()))
    write(source / "cam2/1_keypoints.json", openpose(person()))
    message = message.replace("without 51", "without 17 keypoints")
    recording, notes = import_detections(source, calibration, 25)
    assert recording.num_slots == 2 and "left out 1 item" in notes[0]
    with pytest.raises(InputError, match=message) as caught:
        import_detections(source, calibration, 25, STRICT)
    assert "\n" not in str(caught.value)


@each_case(
    ("names", "numbers"),
    [
        (["000000000012_keypoints.json"], [12]),
        (["cam2_walk3_000017_keypoints.json"], [17]),
        (["cam01.0007.json", "cam01.0008.json"], [7, 8]),
        (["c_000012_kpts_2d.json", "c_000013_kpts_2d.json"], [12, 13]),
        (["c_000012_kpts_2d.json"], [12]),
        (["12.json", "7.json"], [12, 7]),
    ],
)
def test_number_that_differs_is_the_frame(names: list[str], numbers: list[int]) -> None:
    assert frame_numbers(names) == numbers


@each_case(
    ("names", "message"),
    [
        (["a_keypoints.json"], "no frame number"),
        (["1_keypoints.json", "01_keypoints.json"], "frame number 1 of camera cam1 appears twice"),
        (["1_k.json", "99999999999_k.json"], "frame numbers: found 1 to 999999"),
    ],
)
def test_frame_numbers_are_checked(tmp_path: Path, names: list[str], message: str) -> None:
    calibration = rig_of(tmp_path, "cam1", "cam2")
    write(tmp_path / "json/cam2/1_keypoints.json", {"people": []})
    write(tmp_path / "json/cam2/2_keypoints.json", {"people": []})
    for name in names:
        write(tmp_path / "json/cam1" / name, openpose(person()))
    with pytest.raises(InputError, match=message):
        import_detections(tmp_path / "json", calibration, 25)


def test_an_enormous_file_is_refused_unread(tmp_path: Path) -> None:
    calibration = rig_of(tmp_path, "cam1")
    for suffix in SUFFIXES:
        huge = tmp_path / f"cam1{suffix}"
        with huge.open("wb") as file:
            file.truncate(MAX_FILE_BYTES + 1)
        with pytest.raises(InputError, match=re.escape(str(huge))):
            import_detections(huge, calibration, 25)


def test_a_long_file_name_takes_no_time() -> None:
    with pytest.raises(InputError, match="no frame number"):
        frame_numbers(["1" * 1_000_000])


def test_every_fifth_frame_is_a_slot(tmp_path: Path, calibration: Path) -> None:
    for number in range(3, 30, 5):
        write(tmp_path / f"json/cam1/{number}.json", openpose(person()))
    recording, notes = import_detections(tmp_path / "json", calibration, 50)
    assert (recording.num_slots, recording.fps) == (6, 10.0) and "steps of 5" in notes[-1]


def test_cameras_without_detections_are_left_out(tmp_path: Path) -> None:
    calibration = rig_of(tmp_path, "cam1", "cam2", "cam3")
    for camera in ("cam1", "cam3"):
        write(tmp_path / f"json/{camera}/0.json", openpose(person()))
    recording, notes = import_detections(tmp_path / "json", calibration, 25)
    assert recording.rig.camera_ids == ("cam1", "cam3")
    assert notes == ["cameras without detections are left out: cam2"]
    with pytest.raises(InputError, match="cameras without detections are left out: cam2"):
        read_detections(tmp_path / "json", load_rig(calibration), {})


def test_a_recording_with_nobody_is_refused(tmp_path: Path, calibration: Path) -> None:
    write(tmp_path / "json/cam1/0.json", {"people": []})
    with pytest.raises(InputError, match="found nobody, expected a person"):
        import_detections(tmp_path / "json", calibration, 25)
    with pytest.raises(InputError, match="found nothing, expected a folder"):
        import_detections(tmp_path / "absent", calibration, 25)
    for fps in (0.0, -1.0, float("nan"), float("inf"), 1e6):
        with pytest.raises(InputError, match="--fps"):
            import_detections(tmp_path / "json", calibration, fps)


def test_names_of_body_parts_are_known_in_many_spellings() -> None:
    for spell in ("{s}_{p}", "{S}{P}", "{p}_{a}", "{A} {p}"):
        names = []
        for joint in SKELETONS["coco17"].joints:
            side, _, part = joint.rpartition("_")
            words = {"s": side, "S": side.title(), "a": side[:1], "A": side[:1].upper(),
                     "p": part, "P": part.title()}  # fmt: skip
            names.append(spell.format(**words).strip("_ "))
        layout = named_layout(names)
        assert layout is not None and sum(c >= 0 for c in layout.columns) == 17, spell
    assert named_layout(["snout", "tail"]) is None


TABLE = {
    "images": [
        {"id": 7, "file_name": "cam1/1.jpg"},
        {"id": 8, "file_name": "data/cam1/3.jpg"},
        {"id": 9, "file_name": "cam2\\2.png"},
    ]
}


def result(image_id: int | str, **more: Any) -> dict[str, Any]:
    return {**RESULT, "image_id": image_id, **more}


def test_images_of_a_table_without_people_are_empty_views(tmp_path: Path) -> None:
    calibration = rig_of(tmp_path, "cam1", "cam2")
    results = [result(7), result(7), result(9), result(7, category_id=2)]
    source = write(tmp_path / "r.json", results)
    settings = ImportSettings(images=write(tmp_path / "i.json", TABLE))
    recording, _ = import_detections(source, calibration, 30, settings)
    assert counts(recording) == [[2, None, 0], [None, 1, None]]
    whole = write(tmp_path / "w.json", {**TABLE, "annotations": [result(8)]})
    assert counts(import_detections(whole, calibration, 30)[0]) == [[0, None, 1], [None, 0, None]]
    listed = write(tmp_path / "l.json", [result("cam1/3.jpg"), result("cam2\\5.png")])
    assert counts(import_detections(listed, calibration, 30)[0]) == [[1, 0], [0, 1]]


@each_case(("more", "score"), [({}, 1.0), ({"scores": [0.25] * 17}, 0.25)])
def test_flags_of_annotations_are_no_scores(
    tmp_path: Path, more: dict[str, Any], score: float
) -> None:
    calibration, annotation = rig_of(tmp_path, "cam1", "cam2"), result(8, **more)
    annotation["keypoints"] = list(annotation["keypoints"])
    annotation["keypoints"][2::3] = [2, 1, 0] + [2] * 14
    source = write(tmp_path / "r.json", {**TABLE, "annotations": [annotation]})
    view = import_detections(source, calibration, 30)[0].view(2, 0)
    assert view is not None
    assert view.scores[0].tolist() == pytest.approx([score, score, 0.0] + [score] * 14)


@each_case(
    ("results", "table", "message"),
    [
        ([], None, "r.json: found nobody"),
        ([result(3)], None, "file name: found '3', expected <camera>/<frame>"),
        ([result("middle/3.jpg")], None, "file name: found 'middle/3.jpg'"),
        ([result("cam1/cam2/3.jpg")], None, "file name: found 'cam1/cam2/3.jpg'"),
        ([result("cam1/a.jpg")], None, "'a.jpg': found no frame number"),
        ([result("cam1/1.jpg"), result("cam1/9999999999.jpg")], None, "frame numbers"),
        ([{"image_id": "cam1/1.jpg"}], None, r"\[0\]: found no keypoints"),
        ([result(70)], TABLE, r"\[0\].image_id: found '70'"),
        ([result(7)], {"images": [TABLE["images"][0]] * 2}, r"images\[1\]: image 7 appears twice"),
        ([result(7)], {"images": [{"id": 7}]}, r"i.json: images\[0\]: found no id"),
        ([result(7)], {"images": [{"id": 7, "file_name": "eve/1.jpg"}]}, "file name: found 'eve"),
    ],
)
def test_broken_results_and_tables_are_named(
    tmp_path: Path, results: Any, table: Any, message: str
) -> None:
    calibration = rig_of(tmp_path, "cam1", "cam2")
    images = None if table is None else write(tmp_path / "i.json", table)
    source = write(tmp_path / "r.json", results)
    with pytest.raises(InputError, match=message) as caught:
        import_detections(source, calibration, 30, ImportSettings(images=images))
    assert "\n" not in str(caught.value)


ODD: tuple[Any, ...] = (
    None,
    [],
    {},
    "",
    "x",
    -1,
    0,
    1e308,
    10**400,
    True,
    [[]],
    [None],
    {"keypoints": []},
    "1e5",
    [0.5] * 5000,
)


def mutated(value: Any, rng: np.random.Generator) -> Any:
    """A copy with one part missing, doubled, renamed, or replaced by something odd or huge."""
    odd = ODD[int(rng.integers(len(ODD)))]
    if isinstance(value, dict) and value:
        key = list(value)[int(rng.integers(len(value)))]
        kind = int(rng.integers(7))
        rest = {k: v for k, v in value.items() if k != key}
        if kind < 3:
            more = {f"{key}_": value[key]} if kind else {}
            return {**(rest if kind < 2 else value), **more}
        return {**value, key: odd if kind == 3 else mutated(value[key], rng)}
    if isinstance(value, list) and value:
        at, kind = int(rng.integers(len(value))), int(rng.integers(6))
        if kind == 0:
            return value[:at] + value[at + 1 :]
        if kind == 1:
            return [*value, *value]
        return [*value[:at], odd if kind == 2 else mutated(value[at], rng), *value[at + 1 :]]
    return odd


ARRAY = np.where(np.arange(66).reshape(1, 1, 33, 2) > 0, 300.0, 0.0)


def mutated_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """A copy cut short, with a part doubled, or with some bytes replaced."""
    at, kind = int(rng.integers(len(content))), int(rng.integers(4))
    if kind == 0:
        return content[:at]
    if kind == 1:
        return content[:at] + content[at // 2 :]
    odd = [b"", b"nan", b",,,", b"1e999", b"-1", b"\n", b"x", b"\xff\xfe", b"\0" * 8, b"9" * 30]
    return content[:at] + odd[int(rng.integers(len(odd)))] + content[at + kind :]


CONTENTS: dict[str, Any] = {
    "openpose": openpose(person(), person()), "results": [RESULT, RESULT], "whole": [WHOLE],
    "mmpose": {"instance_info": [MMPOSE, MMPOSE]},
    "images": {**TABLE, "annotations": [{**RESULT, "image_id": 7}]},
    "arrays": {"keypoints": [[row[:2] for row in person()]], "scores": [[0.9] * 17]},
    "landmarks": {"people": [{"landmarks": LANDMARKS}]},
    "columns": [{"keypoints": COLUMNS}],
    "alphapose": [{**RESULT, "image_id": f"{i}.jpg"} for i in (4, 4, 5)],
    "named": {f"{i}.jpg": {"version": 0.1, **openpose(person())} for i in (4, 5)},
    "hands": HANDS_AND_FACE, "deeplabcut": DLC, "caliscope": POINTS, "sleap": SLEAP, "yolo": YOLO,
}  # fmt: skip
PLACES = {
    "alphapose": "cam1.json", "named": "cam1.json", "yolo": "cam1.txt", "array": "cam1.npy",
    **dict.fromkeys(("deeplabcut", "caliscope", "sleap"), "cam1.csv"),
    **dict.fromkeys(("results", "whole", "images"), "all.json"),
    **dict.fromkeys(("deeplabcut.h5", "sleap.h5"), "cam1.h5"),
}  # fmt: skip


@each_case("form", [*CONTENTS, "array", "deeplabcut.h5", "sleap.h5"])
def test_odd_files_of_every_form_are_read_or_named(tmp_path: Path, form: str) -> None:
    file = write(tmp_path / "in" / PLACES.get(form, "cam1/4.json"), CONTENTS.get(form, ""))
    if form == "array":
        np.save(file, ARRAY)
    elif form == "deeplabcut.h5":
        names = [("net", name, coord) for name in DLC_NAMES for coord in ("x", "y", "likelihood")]
        deeplabcut_h5(file, pickle.dumps(names, 0), [np.ravel(person())] * 2)
    elif form == "sleap.h5":
        sleap_h5(file, True)
    content, rng = CONTENTS.get(form), np.random.default_rng(len(form))
    whole = file.read_bytes()
    calibration = rig_of(tmp_path, *(("a1", "b2") if form == "caliscope" else ("cam1",)))
    read = 0
    for _ in range(24):
        changed: Any = whole if isinstance(content, str | None) else content
        for _ in range(int(rng.integers(1, 4))):
            if isinstance(changed, bytes):
                changed = mutated_bytes(changed, rng) or b" "
            else:
                changed = mutated(changed, rng)
        file.write_bytes(changed if isinstance(changed, bytes) else json.dumps(changed).encode())
        try:
            in_folder = file.parent.name == "cam1" or file.name == "cam1.json"
            source = tmp_path / "in" if in_folder else file
            read += import_detections(source, calibration, 25)[0].num_slots > 0
        except InputError as error:
            assert "\n" not in str(error) and len(str(error)) < 1000
    assert read > 0
