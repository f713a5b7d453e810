"""`e3pose check` says what is wrong with a site and what to do about it."""

from __future__ import annotations

import datetime
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from tests.calibrate.people_scenes import walk
from tests.cli.commands import run
from tests.cli.test_replaying import moved

from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.model.slot_record import SlotRecord
from e3pose.settings.site_file import load_site
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.example import write_recorded
from e3pose.store import Run, StoreWriter
from e3pose.wire.keys.authority import LEAF_DAYS
from e3pose.wire.keys.folder import add_keys, init_keys

pytestmark = pytest.mark.slow

NOW = datetime.datetime.now(datetime.timezone.utc)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("good")
    write_recorded(folder, simulate(SceneSettings(people=1, seconds=0.2, cameras=2), seed=0), "lab")
    init_keys(folder / "keys", "lab", [], NOW)
    for camera_id in ("cam0", "cam1"):
        add_keys(folder / "keys", camera_id, NOW)
    add_keys(folder / "keys", "wall", NOW, kind="viewer")
    path = folder / "site.toml"
    path.write_text(
        path.read_text()
        .replace("tcp/127.0.0.1", "tls/0.0.0.0")
        .replace("[link]", '[link]\nkeys = "keys"')
    )
    return folder


@pytest.fixture
def site(good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(good, tmp_path / "lab")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    return Path("lab")


def checked(site: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    capsys.readouterr()
    code = run("check", site, "--timeout", "0")
    said = capsys.readouterr()
    return code, " ".join(said.out.split()), said.err


def test_good_site_has_no_problem(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = checked(site, capsys)
    assert (code, err) == (0, "")
    assert "Ready: 0 problems" in out
    assert out.count("ok store") == 1
    assert "warning edge not running at tls/localhost:" in out


def test_people_are_compared_with_the_calibration_of_a_site_that_does_not_run(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "nothing to compare the calibration with" in checked(site, capsys)[1]
    walking = walk(3, seconds=4.0, fps=12.0)
    for scale, said in (
        (1.0, "people of people's size and upright, by "),
        (10.0, "people would be 1"),
    ):
        made = walking if scale == 1 else moved(walking, scale=scale)
        folder = site.parent / f"by{scale:g}"
        write_recorded(folder, made, "lab")
        assert said in checked(folder, capsys)[1]
    # What is stored counts first, unless it was stored with an earlier calibration.
    store = load_site(folder / "site.toml").store
    assert store is not None and walking.truth is not None
    joints_m = 0.1 * walking.truth.joints_m
    for begun_ns, said in ((0, "people would be 1"), (time.time_ns(), "people would be 0.1")):
        run = Run("lab", "lab", begun_ns, 1 / 12, "coco17", COCO17.joints, walking.rig.camera_ids)
        with StoreWriter(store.place, run) as writer:
            for slot, joints in enumerate(joints_m):
                people = People(np.arange(len(joints)), joints)
                none = np.zeros(len(walking.rig))
                flags = none > 0
                writer.append(
                    SlotRecord(slot, slot / 12, flags, flags, people, none, none, flags), wait=True
                )
        found = checked(folder, capsys)
        assert said in found[1], found


def test_certificates_are_reported_with_the_command_that_mends_them(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    add_keys(site / "keys", "cam0", NOW - datetime.timedelta(days=1000), again=True)
    (site / "keys/cameras/cam1/camera.pem").write_text("damaged")
    code, out, err = checked(site, capsys)
    assert code == 1 and err.startswith("e3pose: Not ready: 2 problems, ") and err.count("\n") == 1
    for camera_id, expected in (("cam0", "certificate expired on"), ("cam1", "camera.pem: ")):
        assert expected in out
        assert f"-> e3pose keys add {camera_id} --again --keys lab/keys, then copy" in out
        assert run("keys", "add", camera_id, "--again", "--keys", site / "keys") == 0
    assert checked(site, capsys)[0] == 0, "what was advised helps"


@pytest.mark.parametrize("days", [20, -3])
def test_certificates_of_everybody_are_reported_a_month_before_their_end(
    site: Path, capsys: pytest.CaptureFixture[str], days: int
) -> None:
    made = NOW + datetime.timedelta(days=days - LEAF_DAYS)
    for name, kind in (("cam0", "camera"), ("wall", "viewer"), ("hall", "router")):
        add_keys(site / "keys", name, made, kind=kind, again=True)  # type: ignore[arg-type]
    level, expected = ("warning", "expires on 2") if days > 0 else ("problem", "expired on 2")
    code, out, _ = checked(site, capsys)
    assert code == (0 if days > 0 else 1)
    for name, option in (("cam0", ""), ("wall", " --viewer"), ("hall", " --router")):
        line = out[out.index(f"{level} certificate {name} ") :]
        assert expected in line[:200]
        advice = f"renew {name}" if days > 0 else f"add {name}{option} --again"
        assert f"-> e3pose keys {advice} --keys lab/keys, then copy" in line
        assert run("keys", *advice.split(), "--keys", site / "keys") == 0
    assert f"{level} certificate" not in checked(site, capsys)[1], "what was advised helps"


@pytest.mark.parametrize("days", [20, -3])
def test_the_edges_own_certificate_is_reported_too(
    site: Path, capsys: pytest.CaptureFixture[str], days: int
) -> None:
    shutil.rmtree(site / "keys")
    made = NOW + datetime.timedelta(days=days - LEAF_DAYS)
    init_keys(site / "keys", "lab", [], made)
    for camera_id in ("cam0", "cam1"):
        add_keys(site / "keys", camera_id, NOW)
    code, out, _ = checked(site, capsys)
    if days > 0:
        assert code == 0
        assert "warning certificate edge expires on 2" in out
        assert "-> e3pose keys renew edge --keys lab/keys" in out
    else:
        assert code == 1 and "edge.pem: certificate expired on 2" in out


def test_certificate_of_tomorrow_is_a_problem(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    add_keys(site / "keys", "cam0", NOW + datetime.timedelta(days=5), again=True)
    code, out, _ = checked(site, capsys)
    assert code == 1 and "camera.pem: certificate is valid from 2" in out


def test_missing_keys_are_reported_with_the_command_that_makes_them(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(site / "keys")
    path = site / "site.toml"
    code, out, _ = checked(site, capsys)
    assert code == 1 and "-> e3pose keys init lab --out lab/keys" in out
    path.write_text(path.read_text().replace('keys = "keys"\n', ""))
    code, out, _ = checked(site, capsys)
    assert code == 1
    assert "-> e3pose keys init lab --out lab/keys, and keys = 'keys' in [link]" in out
    assert run("keys", "init", "lab", "--out", "lab/keys") == 0
    code, out, _ = checked(site, capsys)
    assert code == 1 and "-> keys = 'keys' in [link]" in out


def test_edge_that_cannot_be_asked_is_not_said_to_be_away(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(site / "keys/viewers")
    code, out, _ = checked(site, capsys)
    assert code == 0
    assert "cannot connect: lab/keys: found no viewer's certificate" in out
    assert "not running" not in out


def test_calibration_that_is_not_there_is_reported_with_the_commands_that_make_it(
    site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (site / "rig.toml").unlink()
    code, out, _ = checked(site, capsys)
    assert code == 1
    expected = out[out.index("problem calibration lab/rig.toml is missing") :]
    assert "e3pose record lab walk --for 60" in expected
    assert "e3pose calibrate extrinsics walk lab/rig.toml --height 171cm --update" in expected


def test_models_and_sources_that_are_not_there(
    site: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("E3POSE_CACHE", str(site / "cache"))
    path = site / "site.toml"
    text = path.read_text()
    text = text.replace("recorded:recording", "walk.mp4", 1).replace("recorded:recording", "usb:77")
    path.write_text(text)
    code, out, _ = checked(site, capsys)
    assert code == 1
    assert "problem camera cam0 source lab/walk.mp4 does not exist" in out
    assert "problem camera cam1 source usb:77: found no /dev/video77" in out
    assert "-> e3pose models pull movenet-multipose" in out
