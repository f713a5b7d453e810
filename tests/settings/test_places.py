"""Names of files in settings files start from the folder of the file, wherever they stand."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.cases import each_case
from tests.rigs import looking
from tests.site.tables import resolved_site, write_site

from e3pose.base.errors import InputError
from e3pose.settings.camera_file import load_node
from e3pose.settings.resolved import resolve

RIG = looking((4, 0), (0, 4))


def test_every_name_in_a_site_file_is_a_place_once_it_is_read(tmp_path: Path) -> None:
    (tmp_path / "own.onnx").write_text("")
    site = resolved_site(
        tmp_path,
        RIG,
        'learn = "learned"\n[link]\nkeys = "keys"\n[store]\npath = "live.db"\n'
        '[record]\npath = "/videos"\n'
        '[[camera]]\nid = "c1"\nsource = "recorded:walk"\n'
        'detector = "own.onnx"\nmodel = "m.onnx"\n',
    )
    assert (site.file.calibration, site.file.state) == (
        tmp_path / "rig.toml",
        tmp_path / "state.npz",
    )
    assert (site.file.learn, site.file.link.keys) == (tmp_path / "learned", tmp_path / "keys")
    assert site.file.store is not None and site.file.store.place == tmp_path / "live.db"
    assert (site.file.view.tokens, site.file.record.path) == (
        tmp_path / "view-tokens.toml",
        Path("/videos"),
    )
    camera = site.cameras["c1"]
    assert (camera.source, camera.model) == (f"recorded:{tmp_path}/walk", tmp_path / "m.onnx")
    assert camera.detector == str(tmp_path / "own.onnx")


def test_url_and_no_state_are_no_places(tmp_path: Path) -> None:
    site = write_site(tmp_path, 'state = ""\n[store]\npath = "postgresql:///poses"\n')
    assert site.state is None and site.store is not None
    assert site.store.place == "postgresql:///poses"


@each_case(
    ("keys", "message"),
    [
        ('state = "a.txt"\n', "state: found 'a.txt', expected a name that ends in .npz"),
        (
            'learn = "~nobody-here/x"\n',
            "learn: found '~nobody-here/x', expected the home",
        ),
        (
            '[link]\nkeys = "a\\u0007"\n',
            "link.keys: found 'a\\x07', expected the name of",
        ),
        ("[store]\npath = 3\n", "store.path: found a whole number, expected text"),
        (
            '[[camera]]\nid = "c0"\nsource = "recorded:"\n',
            "camera c0.source: found 'rec",
        ),
    ],
)
def test_name_that_is_no_place_is_refused_with_its_key(
    tmp_path: Path, keys: str, message: str
) -> None:
    with pytest.raises(InputError) as error:
        write_site(tmp_path, keys)
    assert str(error.value).startswith(f"{tmp_path / 'site.toml'}: {message}")


def test_camera_file_is_read_likewise(tmp_path: Path) -> None:
    path = tmp_path / "cam0.toml"
    path.write_text(
        'format = "e3pose-camera"\nversion = 1\nsite = "lab"\ncamera = "cam0"\n'
        'source = "walk.mp4"\nvideos = "videos"\n'
    )
    node = load_node(path)
    assert (node.source, node.videos) == (f"{tmp_path}/walk.mp4", tmp_path / "videos")
    assert node.state == tmp_path / "cam0.battery.json"
    assert load_node(path, {"state": ""}).state == ""


def test_site_that_is_not_calibrated_has_cameras_by_name_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    site = write_site(tmp_path, '[[camera]]\nid = "c0"\nsource = "usb:0"\n')
    with pytest.raises(InputError, match=r"calibration: found no .*rig.toml, expected one: let"):
        resolve(site)
    found = resolve(site, placed=False)
    assert not found.rig.placed and found.rig.camera_ids == ("c0",)
    assert found.cameras["c0"].detector == "movenet-multipose" and found.named_detector
    with pytest.raises(InputError, match=r"expected the file of a rig"):
        resolve(write_site(tmp_path), placed=False)
