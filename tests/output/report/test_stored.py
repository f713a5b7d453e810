"""Pages of stores, and pictures beside their player."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
import pytest
from tests.cases import each_case
from tests.cli.commands import run
from tests.output.report.test_report import bare, record, recording

from e3pose.camera.provenance import save_provenance
from e3pose.camera.session_videos import BEGAN, PACE
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.model.camera import Rig
from e3pose.output.report import page as films
from e3pose.output.report.overlay import write_movie
from e3pose.output.report.page import film, render
from e3pose.output.report.stored import videos_of
from e3pose.recording import Recording, load_recording, save_recording
from e3pose.recording.calibration import load_rig, save_rig
from e3pose.recording.folder import HEADER
from e3pose.recording.processor import ProcessorTime, save_processor
from e3pose.recording.videos import VIDEOS, video_name
from e3pose.simulate import SceneSettings, simulate
from e3pose.store import StoreWriter
from e3pose.store.rows import Run

pytestmark = pytest.mark.slow

BEGIN_NS = 1_800_000_000 * 10**9  # 2027-01-15 08:00 UTC
FPS = 10.0
SCENE = SceneSettings(people=2, seconds=4, fps=FPS, cameras=3, image_size=(640, 480))
SITE = """format = "e3pose-site"
version = 1
name = "lab"
calibration = "rig.toml"
fps = 10
[store]
path = "live.db"
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site that stored forty slots of two people, and thirty of another run before."""
    folder = tmp_path_factory.mktemp("lab")
    recording = simulate(SCENE, seed=702)
    (folder / "site.toml").write_text(SITE)
    save_rig(recording.rig, folder / "rig.toml")
    for began_ns, slots in ((BEGIN_NS - 3600 * 10**9, 30), (BEGIN_NS, 40)):
        store(folder / "live.db", recording, began_ns, slots)
    return folder


def store(
    path: Path,
    recording: Recording,
    began_ns: int,
    slots: int,
    blind: Mapping[int, str] = MappingProxyType({}),
) -> None:
    cameras, skeleton = recording.rig.camera_ids, recording.skeleton
    one = Run("lab", "lab", began_ns, 1 / FPS, skeleton.name, skeleton.joints, cameras, "test")
    settings = ReplaySettings(num_selected=2, predictor="zero-velocity")
    with StoreWriter(path, one) as writer:
        for record in list(replay(recording, settings))[:slots]:
            if cause := blind.get(record.slot, ""):
                nobody = record.selected & False
                record = replace(record, selected=nobody, arrived=nobody, blind=cause)
            writer.append(record, wait=True)


def shown(page: Path) -> dict[str, object]:
    """Return the scene of a page."""
    found = re.search(r'<script[^>]*id="data"[^>]*>(.*?)</script>', page.read_text(), re.S)
    assert found is not None
    scene: dict[str, object] = json.loads(found[1])
    return scene


def test_page_shows_the_newest_run(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = site / "all.html"
    assert run("export", site, page) == 0
    assert f"Wrote {page}: 40 slots" in capsys.readouterr().out
    text = page.read_text()
    assert "lab, 2027-01-15 08:00:00 to 08:00:03 UTC" in text
    assert "On average" in text and "Stored live by the site lab, run 2." in text
    assert shown(page)["numSlots"] == 40
    assert "<td>adaptive: follows the delays</td>" in text


def test_page_of_a_store_shows_its_blind_slots(site: Path, tmp_path: Path) -> None:
    recording = simulate(SCENE, seed=702)
    for name in ("site.toml", "rig.toml"):
        (tmp_path / name).write_text((site / name).read_text())
    store(tmp_path / "live.db", recording, BEGIN_NS, 40, {12: "orders-late", 13: "views-late"})
    assert run("export", tmp_path, tmp_path / "blind.html") == 0
    text = (tmp_path / "blind.html").read_text()
    assert "In 2 of 40 slots (5 %) no view arrived (1 orders late, 1 views late)" in text
    assert shown(tmp_path / "blind.html")["blind"] == {"12": "orders late", "13": "views late"}


def test_page_can_be_smoothed(site: Path) -> None:
    for name, words in (("as-stored", ()), ("smooth", ("--smooth", "rts"))):
        assert run("export", site, site / f"{name}.html", *words) == 0
    stored, smooth = (shown(site / f"{name}.html") for name in ("as-stored", "smooth"))
    assert smooth != stored and smooth["numSlots"] == stored["numSlots"]
    assert run("export", site, site / "no.html", "--cutoff", "6Hz") == 2


@each_case(
    ("words", "slots"),
    [
        (("--from", "1", "--to", "2.05"), 11),
        (("--from", "2027-01-15T07:00:00Z", "--to", "2027-01-15T07:00:02Z"), 21),
        (("--to", "2027-01-15T07:59Z"), 30),
    ],
)
def test_page_shows_the_stretch_asked_for(
    site: Path, words: tuple[str, ...], slots: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("export", site, site / "part.html", *words) == 0
    assert f"{slots} slots" in capsys.readouterr().out


@each_case(
    ("words", "message"),
    [
        (("p.html", "--from", "77"), "no slot of site lab was stored in that time"),
        (("p.html", "--from", "3", "--to", "1"), "--from, --to: found '3' to '1'"),
        (("p.html", "--from", "1", "--run", "7"), "no slot of site lab was stored in that time"),
        (("p.html", "--angles"), "--angles: found with a report page"),
        (("p.html", "--track", "1"), "--track: found with a report page"),
        (("p.html", "--region", "0,0,1,1"), "--region: found with a report page"),
        (("p.html", "--from", "soon"), "--from, --to: found 'soon'"),
    ],
)
def test_what_cannot_be_shown_is_one_line(
    site: Path,
    words: tuple[str, ...],
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(site)
    assert run("export", site, *words) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1, err
    assert not (site / "p.html").exists()


def test_page_needs_cameras_and_those_of_the_store(
    site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = simulate(SceneSettings(people=1, seconds=0.2, fps=FPS, cameras=3), seed=702)
    save_recording(recording, tmp_path / "walk")
    for source, helps in ((site / "live.db", "its site"), (tmp_path / "walk", "e3pose replay")):
        assert run("export", source, tmp_path / "p.html") == 2
        assert helps in capsys.readouterr().err
    # Store of other cameras is refused.
    cameras = tuple(replace(c, camera_id=f"x{i}") for i, c in enumerate(recording.rig.cameras))
    save_rig(Rig(cameras), tmp_path / "rig.toml")
    text = SITE.replace('"live.db"', f'"{site / "live.db"}"')
    (tmp_path / "site.toml").write_text(text)
    assert run("export", tmp_path, tmp_path / "p.html") == 2
    assert "found slots of cameras cam0, cam1, cam2, expected those of x0, x1, x2" in (
        capsys.readouterr().err
    )


def test_videos_that_the_site_kept_are_shown_beside_the_player(site: Path, tmp_path: Path) -> None:
    """One in a recording of that time, one that belongs to none yet; none of another time."""
    folder, began_ns = site / "recordings", BEGIN_NS - 10**9
    one, other, *_ = (camera.camera_id for camera in load_rig(site / "rig.toml").cameras)
    width, height = load_rig(site / "rig.toml").cameras[0].image_size
    images = [np.full((height, width, 3), grey, np.uint8) for grey in range(60, 180, 2)]
    loose = folder / VIDEOS / one / video_name(one, began_ns)
    loose.parent.mkdir(parents=True)
    write_movie(loose, images, FPS)
    os.utime(loose, ns=(BEGIN_NS + 5 * 10**9, BEGIN_NS + 5 * 10**9))
    kept = folder / "20270115T075959Z"
    (kept / VIDEOS).mkdir(parents=True)
    (kept / HEADER).write_text(f'fps = 10.0\nnum_slots = 60\n[videos]\n{other} = "b.mkv"\n')
    write_movie(kept / VIDEOS / "b.mkv", images, FPS)
    save_provenance(kept, {BEGAN: str(began_ns), PACE: "1"}, {other: 0.0})
    try:
        found = videos_of(folder, (one, other), BEGIN_NS, BEGIN_NS + 4 * 10**9)
        assert found == {one: (began_ns, loose), other: (began_ns, kept / VIDEOS / "b.mkv")}
        later_ns = BEGIN_NS + 3600 * 10**9
        assert videos_of(folder, (one, other), later_ns, later_ns + 10**9) == {}
        everybody = load_rig(site / "rig.toml").camera_ids
        save_processor(kept, dict.fromkeys(everybody, ProcessorTime(0.1, 0.02, 9)))
        assert run("export", site, tmp_path / "page.html") == 0
        text = (tmp_path / "page.html").read_text()
        assert re.search(r"processor time \d+ % \(modelled\)", text)
        told = re.search(r'id="film-data">(.*?)</script>', text, re.S)
        assert told is not None
        film = json.loads(told[1])
        assert set(film["cameras"]) == {one, other} and loose.exists()
        # Slot 0 is a second into the videos, their eleventh image.
        assert film["at"][:3] == [0, 1, 2]
        shades = [shade(one) for one in film["jpeg"][film["cameras"].index(one)][:8]]
        assert shades == pytest.approx([80 + 2 * slot for slot in range(8)], abs=3)
    finally:
        shutil.rmtree(folder)


def shade(coded: str) -> float:
    """Return the brightness of most of a picture, 0 to 255."""
    image: Any = cv2.imdecode(np.frombuffer(base64.b64decode(coded), np.uint8), cv2.IMREAD_COLOR)
    return float(np.median(image))


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("filmed") / "walk"
    asks = ("--people", 1, "--cameras", 2, "--seconds", 2, "--resolution", "640x480", "--videos")
    assert run("simulate", folder, *asks) == 0
    return folder


def test_pictures_are_of_the_busiest_cameras(filmed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(films, "MOST_IMAGES", 20)
    source = load_recording(filmed)
    shown = [record(slot, selected=np.array([slot % 2 == 0, True])) for slot in range(40)]
    found = film(source, shown, filmed)
    assert found is not None
    assert found["cameras"] == list(reversed(source.rig.camera_ids))
    assert len(found["at"]) == 10 and found["at"][0] == 0 and found["at"][-1] == 39
    for pictures in found["jpeg"]:
        assert len(pictures) == len(found["at"])
        data = np.frombuffer(base64.b64decode(pictures[0]), np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR)
        assert image is not None and max(image.shape) == films.LONG_SIDE_PX


def test_page_shows_pictures_where_there_are_some_or_why_not(filmed: Path) -> None:
    source = load_recording(filmed)
    shown = [record(slot, selected=np.ones(2, dtype=bool)) for slot in range(10)]
    page = render(source, shown, bare(), folder=filmed)
    assert "<img id='film'" in page and '"jpeg":[["/9j/' in page
    nothing = render(recording(2), [record(0), record(1)], bare())
    assert "<img id='film'" not in nothing
    assert '<script type="application/json" id="film-data">null</script>' in nothing
    # Videos that are gone are named without their folder.
    name = source.rig.camera_ids[0]
    moved = replace(source, videos={name: "/srv/films/secret-place/gone.mp4"})
    shown = [record(slot, selected=np.ones(2, dtype=bool)) for slot in range(3)]
    found = film(moved, shown, filmed)
    assert found is not None and set(found) == {"why"}
    assert "secret-place" not in found["why"]
    assert "No pictures: " in render(moved, shown, bare(), folder=filmed)
