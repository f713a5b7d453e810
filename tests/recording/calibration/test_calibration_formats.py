"""Calibrations of other programs, their worlds, and how deep their values may be nested."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from tests.cases import each_case
from tests.recording.calibration.known_rigs import KNOWN, POINTS_M, pixels, with_second, write
from tests.rigs import looking

from e3pose.base.errors import InputError
from e3pose.model.camera import Camera, Rig
from e3pose.recording.calibration import FORMATS, load_calibration, load_rig, save_rig
from e3pose.recording.calibration.easymocap import guess_size
from e3pose.recording.calibration.nodes import MAX_DEPTH, parse
from e3pose.recording.calibration.world import world_problem

NAMES = sorted(FORMATS)


@each_case("name", NAMES)
@each_case("forced", [True, False], ids=["forced", "recognised"])
def test_known_points_land_on_known_pixels(tmp_path: Path, name: str, forced: bool) -> None:
    path = write(name, tmp_path)
    rig = load_rig(path, format=name if forced else None)
    assert rig.camera_ids == ("hall_1", "hall_2", "03")
    for camera, known in zip(rig.cameras, KNOWN, strict=True):
        assert camera.image_size == known.size
        np.testing.assert_allclose(camera.project(POINTS_M), pixels(known), atol=1e-6)
        np.testing.assert_allclose(camera.center_m, -known.R.T @ known.t, atol=1e-9)


def test_angle_up_to_which_a_lens_is_known_is_kept(tmp_path: Path) -> None:
    K = np.array([[400.0, 0, 320], [0, 400, 240], [0, 0, 1]])
    camera = Camera("fish", (640, 480), K, np.eye(4), np.zeros(4), True, known_to=1.1)
    save_rig(Rig((camera, replace(camera, camera_id="all", known_to=None))), tmp_path / "rig.toml")
    first, second = load_rig(tmp_path / "rig.toml").cameras
    assert first.known_to == pytest.approx(1.1) and second.known_to is None
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(text.replace("known_to_deg = 63", "known_to_deg = 363"))
    with pytest.raises(InputError, match="known_to: found 6"):
        load_rig(tmp_path / "rig.toml")


def test_recognition_does_not_need_the_file_name(tmp_path: Path) -> None:
    for name in set(NAMES) - {"pose2sim", "easymocap"}:
        path = write(name, tmp_path).rename(tmp_path / "unnamed")
        known = load_calibration(path)
        assert known.format == name and known.rotations == {}


def test_easymocap_opens_from_its_folder_and_either_file(tmp_path: Path) -> None:
    write("easymocap", tmp_path)
    extrinsics = tmp_path / "extri.yml"
    for path in (tmp_path, tmp_path / "intri.yml", extrinsics):
        assert load_rig(path).camera_ids == ("hall_1", "hall_2", "03")
    # Where there is no matrix, the rotation vector serves.
    extrinsics.write_text(extrinsics.read_text().replace("Rot_", "Unused_"))
    camera = load_rig(tmp_path).cameras[1]
    np.testing.assert_allclose(camera.project(POINTS_M), pixels(KNOWN[1]), atol=1e-6)


@each_case(
    ("center", "size"),
    [
        ((960.6, 542.9), (1920, 1080)),
        ((533.0, 948.1), (1080, 1920)),
        ((1019.0, 1041.0), (2048, 2048)),
        ((300.0, 300.0), (600, 600)),
        ((516.0, 388.0), (1032, 776)),
    ],
)
def test_size_follows_from_the_principal_point(
    center: tuple[float, float], size: tuple[int, int]
) -> None:
    notes: list[str] = []
    assert guess_size(*center, "a", notes) == size and "no image size" in notes[0]


def test_opencv_folder_has_a_camera_a_file(tmp_path: Path) -> None:
    for known in KNOWN:
        text = write("opencv", tmp_path, (known,)).read_text()
        body = [line[5:] for line in text.splitlines()[3:] if "camera_name" not in line]
        (tmp_path / "rig.yaml").unlink()
        (tmp_path / "one").mkdir(exist_ok=True)
        (tmp_path / "one" / f"{known.name}.yml").write_text("%YAML:1.0\n---\n" + "\n".join(body))
    rig = load_rig(tmp_path / "one")
    assert sorted(rig.camera_ids) == ["03", "hall_1", "hall_2"]
    expected = pixels(KNOWN[0])
    camera = rig.cameras[rig.index("hall_1")]
    np.testing.assert_allclose(camera.project(POINTS_M), expected, atol=1e-6)


def test_opencv_reads_what_cv2_writes(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    known = KNOWN[0]
    path = tmp_path / "left.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1920)
    storage.write("image_height", 1080)
    storage.write("camera_matrix", known.K)
    storage.write("distortion_coefficients", known.distortion)
    storage.write("rvec", cv2.Rodrigues(known.R)[0])
    storage.write("tvec", known.t)
    storage.release()
    rig = load_rig(path)
    assert rig.camera_ids == ("left",)
    np.testing.assert_allclose(rig.project(POINTS_M)[0], pixels(known), atol=1e-6)


@each_case(("units", "factor"), [("mm", 1000.0), ("cm", 100.0), ("metres", 1.0)])
@each_case("name", ["anipose", "caliscope"])
def test_stated_units_are_converted_to_metres(
    tmp_path: Path, name: str, units: str, factor: float
) -> None:
    cameras = tuple(replace(known, t=known.t * factor) for known in KNOWN)
    path = write(name, tmp_path, cameras)
    text = path.read_text().replace("[metadata]\n", "")
    path.write_text(f'{text}\n[metadata]\nunits = "{units}"\n'.replace("adjusted = false\n", ""))
    rig = load_rig(path)
    expected = [-known.R.T @ known.t for known in KNOWN]
    np.testing.assert_allclose(rig.centers_m, expected, atol=1e-9)


def test_caliscope_leaves_out_ignored_cameras_and_names_by_port(tmp_path: Path) -> None:
    path = write("caliscope", tmp_path, with_second(extra={"ignore": True}))
    path.write_text("\n".join(line for line in path.read_text().splitlines() if "name" not in line))
    assert load_rig(path).camera_ids == ("cam_0", "cam_2")


@each_case(
    ("count", "degrees"), [(1, 90), (2, 180), (3, 270), (-1, 270), (-2, 180), (-3, 90), (0, None)]
)
def test_turned_caliscope_camera_has_the_calibration_of_its_unturned_images(
    tmp_path: Path, count: int, degrees: int | None
) -> None:
    path = write("caliscope", tmp_path, with_second(extra={"rotation_count": count}))
    rig = load_rig(path)
    np.testing.assert_allclose(rig.project(POINTS_M)[1], pixels(KNOWN[1]))
    assert load_calibration(path).rotations == ({} if degrees is None else {"hall_2": degrees})


def test_older_caliscope_tables_are_read(tmp_path: Path) -> None:
    path = write("caliscope", tmp_path)
    text = path.read_text().replace("[cameras.", "[cam_") + "\n[charuco]\ncolumns = 4\n"
    path.write_text(text)
    assert load_calibration(path).format == "caliscope"
    assert load_rig(path).camera_ids == ("hall_1", "hall_2", "03")


def test_qualisys_marker_cameras_and_inactive_ones_are_left_out(tmp_path: Path) -> None:
    cameras = with_second(extra={"model": "Miqus M3"})
    path = write("qualisys", tmp_path, cameras)
    assert load_rig(path).camera_ids == ("hall_1", "03")
    cameras = with_second(extra={"active": "0"})
    path = write("qualisys", tmp_path, cameras)
    assert load_rig(path).camera_ids == ("hall_1", "03")


def mixed_rig() -> Rig:
    generator = np.random.default_rng(3)
    lenses: list[tuple[list[float], bool]] = [
        ([], False),
        ([-0.2, 0.05, 0.001, -0.002], False),
        ([-0.2, 0.05, 0.001, -0.002, 0.01], False),
        ([0.3, 0.1, 0.001, 0.002, 0.01, 0.4, 0.08, 0.002], False),
        ([0.03, -0.01, 0.004, -0.001], True),
    ]
    cameras = []
    for index, (distortion, fisheye) in enumerate(lenses):
        rotation = np.linalg.qr(generator.normal(size=(3, 3)))[0]
        rotation *= np.linalg.det(rotation)
        K = np.array([[900.0 + index, 0.25, 640.0], [0.0, 905.0, 355.0], [0.0, 0.0, 1.0]])
        t = generator.normal(size=3)
        name = f"camera-{index}.x"
        cameras.append(
            Camera.from_world_to_camera(name, (1280, 720), K, rotation, t, distortion, fisheye)
        )
    turned = Camera.from_world_to_camera("half-turn", (64, 48), K / 8 + np.diag([0, 0, 0.875]),
                                         np.diag([1.0, -1.0, -1.0]), np.zeros(3))  # fmt: skip
    return Rig((*cameras, turned))


def test_native_format_keeps_every_camera(tmp_path: Path) -> None:
    rig = mixed_rig()
    path = tmp_path / "calibration.toml"
    save_rig(rig, path)
    assert 'units = "m"' in path.read_text()
    again = load_rig(path)
    assert again.camera_ids == rig.camera_ids
    for camera, original in zip(again.cameras, rig.cameras, strict=True):
        assert camera.image_size == original.image_size
        assert camera.fisheye == original.fisheye
        np.testing.assert_array_equal(camera.K, original.K)
        np.testing.assert_array_equal(camera.distortion, original.distortion)
        np.testing.assert_allclose(camera.T_world_camera, original.T_world_camera, atol=1e-12)


@pytest.mark.shared
def test_published_panoptic_calibration_stands_on_its_floor(tmp_path: Path, shared: Path) -> None:
    with np.load(shared / "data/panoptic/160906_band1.npz", allow_pickle=False) as data:
        K, dist, R, t = (data[key] for key in ("K", "dist", "R", "t_cm"))
        joints = data["joints19_cm_conf"]
    file_from_world = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    known = tuple(
        replace(
            KNOWN[0],
            name=f"hd_{n}",
            K=K[n],
            R=R[n] @ file_from_world,
            t=t[n].reshape(3) / 100,
            distortion=dist[n].reshape(-1),
        )
        for n in range(len(K))
    )
    path = write("panoptic", tmp_path, known)
    rig = load_rig(path)
    assert (rig.centers_m[:, 2] > 0).all(), "every camera hangs above the floor"
    seen = joints[..., :3][joints[..., 3] > 0.1]
    points_m = seen @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]).T / 100
    assert points_m[:, 2].min() > -0.2
    assert points_m[:, 2].max() < 2.5
    # The same joints, by the published arithmetic in centimetres.
    in_camera = seen @ R[0].T + t[0].reshape(3)
    x, y = in_camera[:, 0] / in_camera[:, 2], in_camera[:, 1] / in_camera[:, 2]
    k1, k2, p1, p2, k3 = dist[0].reshape(-1)
    r2 = x * x + y * y
    u = x * (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    expected_u = K[0, 0, 0] * u + K[0, 0, 2]
    np.testing.assert_allclose(rig.project(points_m)[0, :, 0], expected_u, atol=0.5)


def _rows(cameras: Any) -> list[dict[str, Any]]:
    return [
        {
            "name": c.name, "K": c.K.tolist(), "DC": c.distortion.tolist(), "R": c.R.tolist(),
            "T": [[float(v)] for v in c.t], "width": c.size[0], "height": c.size[1],
        }
        for c in cameras
        if c.size is not None
    ]  # fmt: skip


def _multical(cameras: Any) -> dict[str, Any]:
    entries = {c.name: {"model": "standard", "image_size": c.size, "K": c.K.tolist(),
                        "dist": [c.distortion.tolist()]} for c in cameras}  # fmt: skip
    poses = {f"{c.name}_to_hall_1": {"R": c.R.tolist(), "T": c.t.tolist()} for c in cameras}
    return {"cameras": entries, "camera_poses": poses}


def _kalibr(cameras: Any) -> dict[str, Any]:
    chain, last = {}, np.eye(4)
    for index, camera in enumerate(cameras):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = camera.R, camera.t
        chain[f"cam{index}"] = {
            **({"T_cn_cnm1": (T @ np.linalg.inv(last)).tolist()} if index else {}),
            "distortion_coeffs": camera.distortion[:4].tolist(), "distortion_model": "radtan",
            "intrinsics": camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(),
            "resolution": list(camera.size),
        }  # fmt: skip
        last = T
    return chain


def _voxelpose(cameras: Any) -> dict[str, Any]:
    return {
        str(number): {
            "R": c.R.tolist(), "T": (-1000 * c.R.T @ c.t)[:, None].tolist(),
            "fx": c.K[0, 0], "fy": c.K[1, 1], "cx": c.K[0, 2], "cy": c.K[1, 2],
            "k": [[c.distortion[0]], [c.distortion[1]], [c.distortion[4]]],
            "p": c.distortion[2:4, None].tolist(),
        }
        for number, c in enumerate(cameras)
    }  # fmt: skip


# What tools write as JSON or as YAML, which holds it as well.
CONTENTS: dict[str, Callable[[Any], Any]] = {
    "list": _rows,
    "table": lambda cameras: {"cameras": {row["name"]: row for row in _rows(cameras)}},
    "names": lambda cameras: {"version": 1, **{row["name"]: row for row in _rows(cameras)},
                              "capture": {"fps": 60}},
    "multical": _multical,
    "kalibr": _kalibr,
    "voxelpose": _voxelpose,
}  # fmt: skip


def same_cameras(rig: Rig) -> None:
    for camera, known in zip(rig.cameras, KNOWN, strict=True):
        np.testing.assert_allclose(camera.R, known.R, atol=1e-9)
        np.testing.assert_allclose(camera.t, known.t, atol=1e-9)
        np.testing.assert_allclose(camera.distortion, known.distortion)


@each_case("form", ["list", "table", "names", "multical"])
def test_json_of_named_fields_is_read(tmp_path: Path, form: str) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(CONTENTS[form](KNOWN), indent=1))
    known = load_calibration(path)
    assert known.format == "opencv" and known.notes == ()
    assert known.rig.camera_ids == tuple(wanted.name for wanted in KNOWN)
    assert {camera.image_size for camera in known.rig.cameras} == {KNOWN[0].size}
    same_cameras(known.rig)


def test_a_camera_of_unknown_fields_is_named(tmp_path: Path) -> None:
    first, second, *_ = _rows(KNOWN)
    path = tmp_path / "rig.json"
    path.write_text(
        json.dumps({"cam7": first, "cam8": {"Kmat": second["K"]}, "capture": {"fps": 60}})
    )
    known = load_calibration(path)
    assert len(known.rig) == 1
    assert known.notes == (f"{path}: cam8: left out, it has no field of a camera",)


def test_chain_of_kalibr_is_placed_from_its_first_camera(tmp_path: Path) -> None:
    text = yaml.safe_dump({**_kalibr(KNOWN), "imu0": {"rate": 200}, "camera_info": {}})
    path = tmp_path / "camchain.yaml"
    path.write_text(text)
    rig = load_rig(path)
    first = np.eye(4)
    first[:3, :3], first[:3, 3] = KNOWN[0].R, KNOWN[0].t
    assert rig.camera_ids == ("cam0", "cam1", "cam2")
    for camera, known in zip(rig.cameras, KNOWN, strict=True):
        np.testing.assert_allclose(camera.R @ first[:3, :3], known.R, atol=1e-9)
        np.testing.assert_allclose(camera.t + camera.R @ first[:3, 3], known.t, atol=1e-9)
    path.write_text(text.replace("T_cn_cnm1", "T_other"))
    with pytest.raises(InputError, match="camera cam1: T_cn_cnm1: found nothing"):
        load_rig(path)


def test_what_tools_leave_in_a_file_is_passed_over(tmp_path: Path) -> None:
    path = write("anipose", tmp_path)
    path.write_text(path.read_text() + "\n[capture_volume]\nstage = 1\nRMSE = { overall = 0.7 }\n")
    assert len(load_rig(path)) == 3
    longer = with_second(distortion=[*KNOWN[1].distortion, *[0.0] * 9])
    rig = load_rig(write("anipose", tmp_path, longer))
    assert rig.cameras[1].distortion.tolist() == [*KNOWN[1].distortion, 0, 0, 0]
    for more in ([1e-4], [1e-4, 0.0, 0.0]):  # thin prism, and a sensor without tilt
        prism = with_second(distortion=[*KNOWN[1].distortion, *[0.0] * 6, *more])
        assert len(load_rig(write("anipose", tmp_path, prism)).cameras[1].distortion) == 12
    for more, message in (([0.0, 0.1], "found 13 coeff"), ([0.0, 0.0, 1.6], "found a tilt of")):
        odd = with_second(distortion=[*KNOWN[1].distortion, *[0.0] * 6, *more])
        with pytest.raises(InputError, match=f"hall_2: distortion: {message}"):
            load_rig(write("anipose", tmp_path, odd))


@each_case("form", ["caliscope", "anipose", "json"])
def test_cameras_without_a_place_are_kept_unplaced(tmp_path: Path, form: str) -> None:
    if form == "json":
        rows = _rows(KNOWN)
        del rows[2]["R"], rows[2]["T"]
        path = tmp_path / "rig.json"
        path.write_text(json.dumps(rows))
    else:
        path = write(form, tmp_path)
        text = path.read_text()
        last = text.rindex("[cam")
        lines = [
            line for line in text[last:].splitlines() if not line.startswith(("rotation =", "tra"))
        ]
        path.write_text(text[:last] + "\n".join(lines) + "\n")
    rig = load_rig(path)
    save_rig(rig, tmp_path / "again.toml")
    for read in (rig, load_rig(tmp_path / "again.toml")):
        assert (len(read), read.placed, read.unplaced) == (3, False, (read.camera_ids[2],))
        assert read.subset([0, 1]).placed and not read.subset([2]).placed
    world = world_problem(rig.subset(rig.placed_ones))
    assert world == world_problem(load_rig(write("caliscope", tmp_path)).subset([0, 1]))


def test_cameras_of_voxelpose_are_read(tmp_path: Path) -> None:
    path = tmp_path / "calibration_room.json"
    path.write_text(json.dumps({**_voxelpose(KNOWN), "note": {"by": "hand"}}))
    known = load_calibration(path)
    assert "the file says no image size" in known.notes[0]
    same_cameras(known.rig)
    sized = {name: {**one, "size": 3} for name, one in _voxelpose(KNOWN).items()}
    path.write_text(json.dumps(sized))
    with pytest.raises(InputError, match="camera 0: size: found numbers of shape"):
        load_rig(path)


def test_names_are_kept_as_titles_beside_safe_ids(tmp_path: Path) -> None:
    path = write("anipose", tmp_path, with_second(name="Küche 1\t"))
    rig = load_rig(path)
    save_rig(rig, tmp_path / "again.toml")
    for read in (rig, load_rig(tmp_path / "again.toml")):
        assert read.titles == {**{c: c for c in rig.camera_ids}, "Kuche_1": "Küche 1"}
    known = replace(KNOWN[0], name="a")
    for names, ids in (
        (("Cam_1", "Cam 1", "日本", "中国"), ("Cam_1", "Cam_1_2", "cam", "cam_2")),
        (("Küche", "Kuche", "☎"), ("Kuche_2", "Kuche", "cam")),  # an exact name stays
    ):
        cameras = [replace(known, name=n, t=known.t + i) for i, n in enumerate(names)]
        found = load_calibration(write("anipose", tmp_path, tuple(cameras)))
        assert found.rig.camera_ids == ids, found.notes


def test_json_with_parts_of_matrices_is_read(tmp_path: Path) -> None:
    entries: list[dict[str, Any]] = []
    for true in KNOWN:
        lens = dict(
            zip(("fx", "cx", "fy", "cy"), (*true.K[0, [0, 2]], *true.K[1, 1:]), strict=True)
        )
        place = np.vstack([np.column_stack([true.R, true.t]), [0, 0, 0, 1]])
        entries.append({
            "camera_id": true.name, "intrinsics": lens, "extrinsics": place.tolist(),
            "distortion": np.asarray(true.distortion).tolist(),
            "size": np.asarray(true.size).tolist(),
        })  # fmt: skip
    entries.append({**entries[0], "camera_id": "new", "extrinsics": None})
    (tmp_path / "rig.json").write_text(json.dumps(entries))
    rig = load_rig(tmp_path / "rig.json")
    assert rig.unplaced == ("new",)
    for camera, true in zip(rig.cameras, KNOWN, strict=False):
        np.testing.assert_allclose(camera.K, true.K)
        np.testing.assert_allclose(camera.t, true.t, atol=1e-9)


PATH = Path("rig.yml")
# Each way of nesting, once more than is allowed: what opens, and what closes.
NESTINGS = {
    "lists in brackets": ("[\n", "]\n"),
    "tables in braces": ("{a:\n", "}\n"),
    "lists of dashes": ("- ", ""),
    "keys that are tables": ("? ", ""),
}


@each_case("nesting", NESTINGS)
def test_values_nested_too_deep_are_refused(nesting: str) -> None:
    opens, closes = NESTINGS[nesting]
    depth = MAX_DEPTH + 1
    with pytest.raises(InputError, match=rf"^rig.yml: line \d+: .*at most {MAX_DEPTH} levels$"):
        parse(PATH, "a:\n  " + opens * depth + "x " + closes * depth)


def test_values_are_read_as_deep_as_calibrations_nest_them() -> None:
    assert parse(PATH, "a: [[{b: [[c], [d]]}]]") == {"a": [[{"b": [["c"], ["d"]]}]]}
    with pytest.raises(InputError, match=f"line {MAX_DEPTH}:"):  # and no farther
        parse(PATH, "a: " + "[\n" * 50_000)


UPRIGHT = looking((4, 0), (0, 4), (-4, 0))


def rolled(degrees: int) -> Rig:
    """Return cameras whose images must be turned by this much, clockwise, to be upright."""
    # Image x is right and y is down, so that a positive angle about z turns the image clockwise.
    back = Rotation.from_euler("z", -degrees, degrees=True).as_matrix()
    cameras = []
    for camera in UPRIGHT.cameras:
        size = camera.image_size[::-1] if degrees in (90, 270) else camera.image_size
        cameras.append(
            Camera.from_world_to_camera(
                camera.camera_id, size, camera.K, back @ camera.R, back @ camera.t
            )
        )
    return Rig(tuple(cameras))


@each_case("degrees", [90, 180, 270])
def test_cameras_on_their_side_are_upright_once_turned(degrees: int) -> None:
    rig = rolled(degrees)
    point_m = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.5]])
    low_px, high_px = rig.cameras[0].project(point_m)
    towards = {90: (-1, 0), 180: (0, 1), 270: (1, 0)}[degrees]  # of the image, where heads are
    assert (high_px - low_px) @ towards > 0.9 * np.linalg.norm(high_px - low_px)
    assert world_problem(rig)[0] == "not-z-up"
    said = dict.fromkeys(rig.camera_ids, degrees)
    assert world_problem(rig, rotations=said) == world_problem(UPRIGHT) == ("", "")
    assert degrees != 180 or world_problem(UPRIGHT, rotations=said)[0] == "not-z-up"
