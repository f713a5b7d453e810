"""A wand of two or three markers places cameras, in metres; a faulty wand is reported."""

from __future__ import annotations

import io
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import format as npy
from tests.calibrate.people_scenes import distances
from tests.calibrate.wand_scenes import carried, ring
from tests.cases import each_case
from tests.cli.commands import run

from e3pose.base.errors import InputError
from e3pose.calibrate.places import from_wand_seen
from e3pose.calibrate.points_file import load_points
from e3pose.calibrate.wand import Wand
from e3pose.recording.calibration import load_rig, save_rig

pytestmark = pytest.mark.slow

TWO, THREE = "green,red=500mm", "green,blue,red=200mm,500mm"


@each_case("word", [TWO, THREE])
@each_case("seed", [751, 752, 753])
def test_wand_places_cameras_in_metres(word: str, seed: int) -> None:
    rig, wand = ring(seed), Wand.parse(word)
    found = from_wand_seen(rig, wand, carried(rig, wand, seed))
    degrees, millimetres, _ = distances(found.rig, rig, with_scale=False)
    assert degrees < 0.1 and millimetres < 10
    assert abs(distances(found.rig, rig)[2] - 1) < 0.002
    assert found.scale is not None and found.scale.share < 0.005
    assert (found.errors_px < 1.5).all()


def test_names_of_a_wand_are_read() -> None:
    wand = Wand.parse("green, blue,red=20cm,0.5m")
    assert wand.markers == ("green", "blue", "red")
    assert wand.places_m.tolist() == pytest.approx([0, 0.2, 0.5])


@each_case(
    ("word", "output"),
    [
        ("500mm", "found '500mm', expected markers and lengths such as green,red=500mm"),
        ("green=500mm", "expected markers and lengths"),
        ("green,red=500", "expected a number and mm, cm, m"),
        ("green,green=500mm", "found green twice, expected markers that can be distinguished"),
        ("green,blue,red=500mm,200mm", "each larger than the one before"),
        ("green,red=5mm", "found 0.005 m, expected a wand of 0.05 to 5 m"),
        ("a,b,c,d,e,f=1m,2m,3m,4m,5m", "found 6 markers, expected at most 5"),
    ],
)
def test_what_is_no_wand_is_reported(word: str, output: str) -> None:
    with pytest.raises(InputError, match=re.escape(output)) as caught:
        Wand.parse(word)
    assert str(caught.value).startswith("--wand: ")


def test_markers_in_another_order_are_reported() -> None:
    rig, wand = ring(751), Wand.parse(THREE)
    pixels = carried(rig, wand, 751)[:, :, [1, 0, 2]]
    with pytest.raises(InputError, match="name the markers in their order along the wand"):
        from_wand_seen(rig, wand, pixels)


def test_markers_that_are_no_wand_are_reported() -> None:
    """A red ball that lies on the floor while the green one is carried about."""
    rig, wand = ring(752), Wand.parse(TWO)
    pixels = carried(rig, wand, 752)
    pixels[:, :, 1] = rig.project(np.array([[0.3, -0.2, 0.05]]))
    with pytest.raises(
        InputError, match=r"green to red changes its length by \d+ % .* expected a stiff wand"
    ):
        from_wand_seen(rig, wand, pixels)


def test_too_few_views_are_reported() -> None:
    rig, wand = ring(753), Wand.parse(TWO)
    pixels = carried(rig, wand, 753, 60)
    lost = pixels.copy()
    lost[:, 10:, 1] = np.nan
    with pytest.raises(
        InputError, match=r"two of its markers were placed at 9 times \(green \d\d, red 10\)"
    ):
        from_wand_seen(rig, wand, lost)
    lost = pixels.copy()
    lost[2] = np.nan
    with pytest.raises(InputError, match="cam2: never see the wand as cam0, cam1, cam3"):
        from_wand_seen(rig, wand, lost)
    lost = pixels.copy()
    lost[2] = np.roll(pixels[2], 7, axis=0)
    with pytest.raises(
        InputError, match=r"camera cam2: shares \d+ points with others, but they fit"
    ):
        from_wand_seen(rig, wand, lost)
    with pytest.raises(InputError, match="no two cameras agree, expected one wand"):
        from_wand_seen(rig, wand, np.full_like(pixels, np.nan))


def test_points_of_a_wand_are_read_from_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, wand = ring(751), Wand.parse("tip,tail=500mm")
    pixels = carried(rig, wand, 751)
    lines = ["time,camera,point,u,v"]
    for camera, time, marker in np.argwhere(np.isfinite(pixels[..., 0])).tolist():
        u, v = pixels[camera, time, marker]
        lines.append(f"{time},{rig.camera_ids[camera]},{wand.markers[marker]},{u},{v}")
    (tmp_path / "wand.csv").write_text("\n".join(lines))
    np.savez(tmp_path / "wand.npz", **dict(zip(rig.camera_ids, pixels, strict=True)))
    save_rig(rig, tmp_path / "lenses.toml")
    for name in ("wand.csv", "wand.npz"):
        words = ("calibrate", "extrinsics", tmp_path / name, tmp_path / "rig.toml")
        lenses = ("--intrinsics", tmp_path / "lenses.toml")
        assert run(*words, *lenses, "--wand", "tip,tail=500mm") == 0, capsys.readouterr().err
        assert "scale: a wand of 500 mm, placed" in capsys.readouterr().out
        degrees, millimetres, _ = distances(load_rig(tmp_path / "rig.toml"), rig, False)
        assert degrees < 0.1 and millimetres < 10
        assert run(*words, *lenses, "--wand", "tip,end,tail=1cm,50cm") == 2
        output = capsys.readouterr().err
        assert output.count("\n") == 1 and f"{name}: points of one time: found" in output
        for more in (("--distance", "cam0,cam1=3m"), ("--ball", "green")):
            assert run(*words, *lenses, "--wand", "tip,tail=500mm", *more) == 2
            assert "wand" in capsys.readouterr().err


def test_points_that_unpack_to_gigabytes_are_refused_unread(tmp_path: Path) -> None:
    rig = ring(751)
    with zipfile.ZipFile(tmp_path / "wand.npz", "w", zipfile.ZIP_DEFLATED) as file:
        head = io.BytesIO()
        npy.write_array_header_1_0(
            head, {"descr": "<f8", "fortran_order": False, "shape": (10**8, 2)}
        )
        file.writestr(f"{rig.camera_ids[0]}.npy", head.getvalue())
    with pytest.raises(InputError, match=r"wand.npz: cannot be read .*promises 1600000000 bytes"):
        load_points(tmp_path / "wand.npz", rig)
    (tmp_path / "wand.npz").write_bytes(b"no archive")
    with pytest.raises(InputError, match=r"wand.npz: found no .npz archive"):
        load_points(tmp_path / "wand.npz", rig)
