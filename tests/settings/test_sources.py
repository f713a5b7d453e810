"""Settings files: names of files, sources of cameras, shares of the slots."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.rigs import looking
from tests.site.tables import resolved_site, write_site

from e3pose.base.errors import InputError
from e3pose.settings.camera_file import load_node
from e3pose.settings.loop import LoopSettings
from e3pose.settings.parts import row_of, shares
from e3pose.settings.resolved import resolve
from e3pose.settings.sources import is_live, is_recorded, located, place_of, put_away, revealed


def near(name: str) -> Path:
    return Path("/site") / name


@each_case(
    ("source", "place", "at"),
    [
        *((each, None, each) for each in ("usb:0", "rtsp://10.0.0.2/stream", "udp://@:5000")),
        ("gstreamer:v4l2src ! appsink", None, "gstreamer:v4l2src ! appsink"),
        ("cam1.mp4", "cam1.mp4", "/site/cam1.mp4"),
        ("/films/cam1.mp4", "/films/cam1.mp4", "/films/cam1.mp4"),
        ("recorded:take 1", "take 1", "recorded:/site/take 1"),
    ],
)
def test_files_and_recordings_have_a_place_near_the_settings_file(
    source: str, place: str | None, at: str
) -> None:
    assert place_of(source) == place and located(source, near) == at
    assert is_recorded(source) == source.startswith("recorded:") and not is_recorded(None)
    with pytest.raises(InputError, match="recorded:RECORDING"):
        located("recorded:", near)


SECRET = "rtsp://admin:s3cret@10.0.0.7/1"


def test_an_address_with_a_password_moves_to_a_private_file(tmp_path: Path) -> None:
    named = put_away(SECRET, tmp_path, "cam0")
    assert named == "secret:secrets/cam0" and is_live(named)
    assert (tmp_path / "secrets" / "cam0").stat().st_mode & 0o777 == 0o600
    assert revealed(located(named, lambda name: tmp_path / name)) == SECRET
    assert put_away(SECRET, tmp_path, "cam0") == "secret:secrets/cam0-2"  # another camera's stays
    for source in ("usb:0", "rtsp://10.0.0.7/1", named):
        assert put_away(source, tmp_path, "cam1") == source


def test_an_address_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOOR", SECRET)
    assert is_live("env:DOOR") and located("env:DOOR", near) == "env:DOOR"
    assert revealed("env:DOOR") == SECRET
    with pytest.raises(InputError, match="env:NO_DOOR: missing: the camera's address"):
        revealed("env:NO_DOOR")


def test_a_secret_that_others_read_or_that_is_no_address_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "cam0"
    for mode, text, words in (
        (0o644, SECRET, "others can read"),
        (0o600, "walk.mp4", "no address"),
        (0o600, "", "empty"),
    ):
        file.write_text(text)
        file.chmod(mode)
        with pytest.raises(InputError, match=words) as refused:
            revealed(f"secret:{file}")
        assert "s3cret" not in str(refused.value)
    with pytest.raises(InputError, match="secret:FILE"):
        place_of("secret:")


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
        ('learn = "~nobody-here/x"\n', "learn: found '~nobody-here/x', expected the home"),
        ('[link]\nkeys = "a\\u0007"\n', "link.keys: found 'a\\x07', expected the name of"),
        ("[store]\npath = 3\n", "store.path: found a whole number, expected text"),
        ('[[camera]]\nid = "c0"\nsource = "recorded:"\n', "camera c0.source: found 'rec"),
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


Budget = float | tuple[float, ...]


@each_case(
    ("budget", "count"), [(0.6, 3), ((1.0, 0.7, 0.5, 0.4, 0.4), 3), (1.0, 5), ((0.2,) * 5, 1)]
)
def test_budget_that_pays_is_what_every_camera_has(budget: Budget, count: float) -> None:
    settings = LoopSettings(budget=budget, num_selected=count)
    found = shares(settings, row_of(settings), 5)
    np.testing.assert_array_equal(found, np.broadcast_to(budget, 5))


@each_case(
    ("budget", "count", "said"),
    [
        (0.59, 3, "budget: found 0.59, expected at least 0.6 for 3 of 5 cameras per slot"),
        ((0.8, 0.8, 0.5, 0.4, 0.4), 3, "found 2.9 cameras per slot in all, expected at least 3"),
        ((0.8,) * 4, 3, "found 4 shares, expected 5"),
    ],
)
def test_budget_that_does_not_pay_is_said(budget: Budget, count: float, said: str) -> None:
    settings = LoopSettings(budget=budget, num_selected=count)
    with pytest.raises(InputError) as error:
        shares(settings, row_of(settings), 5)
    assert said in str(error.value)
