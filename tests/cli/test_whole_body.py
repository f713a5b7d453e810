"""133 joints from a simulation through a replay with two cameras into every kind of file."""

from __future__ import annotations

import csv
import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run
from tests.output.exports.test_skeletons import Gltf, read_bvh

from e3pose.base.arrays import Floats
from e3pose.model.skeleton import SKELETONS, Skeleton
from e3pose.recording import Recording, load_recording
from e3pose.store import Store

WHOLE, HAND = SKELETONS["coco133"], SKELETONS["left_hand21"]
SCENE = ["--scene", "ring", "--cameras", "4", "--people", "2", "--seconds", "3", "--seed", "4"]
FROM = 30  # slots before everybody is known
MOST_MM = {"core": 60.0, "detail": 80.0}  # median by joint; each is measured below half of it


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    assert run("simulate", str(folder / "rec"), *SCENE, "--skeleton", "coco133") == 0
    made = ["--poses", str(folder / "poses.csv"), "--report", str(folder / "page.html")]
    made += ["--store", str(folder / "store.db")]
    assert run("replay", str(folder / "rec"), "--cameras", "2", *made) == 0
    return folder


def nearest_mm(recording: Recording, slot: int, joints_m: Floats) -> Floats:
    """Return how far the joints of somebody are from those of the true person nearest to them."""
    assert recording.truth is not None
    apart = np.linalg.norm(recording.truth.joints_m[slot] - joints_m, axis=-1)
    known = np.isfinite(apart).any(axis=1)
    middle = [
        np.nanmedian(each) if there else np.inf for each, there in zip(apart, known, strict=True)
    ]
    return np.asarray(1000 * apart[np.argmin(middle)])


def shown(table: Path, skeleton: Skeleton) -> dict[tuple[int, int], Floats]:
    """Return the people of a table by slot and track, from `FROM` on."""
    found: dict[tuple[int, int], Floats] = {}
    with table.open() as file:
        for row in csv.DictReader(file):
            if int(row["slot"]) >= FROM:
                key = int(row["slot"]), int(row["track"])
                person = found.setdefault(key, np.full((len(skeleton), 3), np.nan))
                person[skeleton.index(row["joint"])] = [float(row[axis]) for axis in "xyz"]
    return found


def check(errors_mm: Floats) -> None:
    """Each joint is where the truth has it, in the median over slots and people."""
    middle = np.nanmedian(errors_mm, axis=0)
    for index, joint in enumerate(WHOLE.joints):
        kind = "core" if index in WHOLE.core else "detail"
        assert middle[index] < MOST_MM[kind], (joint, middle[index])


def test_every_joint_is_near_the_truth_in_every_file(replayed: Path) -> None:
    recording = load_recording(replayed / "rec")
    assert recording.skeleton == WHOLE
    found = shown(replayed / "poses.csv", WHOLE)
    people = {*found}
    assert len({track for _, track in people}) >= 2
    check(np.array([nearest_mm(recording, slot, m) for (slot, _), m in found.items()]))

    stored = Store(replayed / "store.db").query()
    assert stored.joints == WHOLE.joints
    keys = zip(stored.slots.tolist(), stored.people.track_ids.tolist(), strict=True)
    rows = {key: joints_m for key, joints_m in zip(keys, stored.people.joints_m, strict=True)}
    for key, joints_m in found.items():
        np.testing.assert_allclose(rows[key], joints_m, atol=1e-4)

    for name in ("walk.trc", "walk.c3d", "walk.glb", "walk.bvh", "walk.parquet"):
        wide = ["--layout", "archive"] if name.endswith("parquet") else []
        assert run("export", str(replayed / "poses.csv"), str(replayed / name), *wide) == 0
    for track in sorted({track for _, track in people}):
        there = {slot: m for (slot, one), m in found.items() if one == track}
        for places in (_trc(replayed, track), _c3d(replayed, track), _glb(replayed, track, there),
                       _bvh(replayed, track), _wide(replayed, track)):  # fmt: skip
            off = [places[slot] - m for slot, m in there.items() if slot in places]
            assert not there or len(off) > 5
            away_mm = 1000 * np.abs(off if off else np.zeros((1, 133, 3)))
            assert np.nanmedian(away_mm, axis=0).max() < 60.0  # of bones, whose lengths are fixed
            assert np.nanmax(np.delete(away_mm, WHOLE.core, axis=1)) < 1.0  # others are exact


def test_hands_alone_are_imported_followed_and_exported(tmp_path: Path) -> None:
    assert run("simulate", str(tmp_path / "sim"), *SCENE, "--skeleton", HAND.name) == 0
    made = load_recording(tmp_path / "sim")
    assert made.truth is not None and made.skeleton == HAND
    assert run("replay", str(tmp_path / "sim")) == 0  # with figures against its truth
    assert run("calibrate", "check", str(tmp_path / "sim")) == 0
    for camera, name in enumerate(made.rig.camera_ids):
        frames = []
        for slot in range(made.num_slots):
            view = made.view(slot, camera)
            assert view is not None
            seen = np.dstack([view.keypoints_px, view.scores])
            hands = [{"keypoints": np.nan_to_num(each).ravel().tolist()} for each in seen]
            frames.append({"frame_id": slot, "people": [h for h in hands if any(h["keypoints"])]})
        (tmp_path / "in").mkdir(exist_ok=True)
        (tmp_path / "in" / f"{name}.json").write_text(json.dumps({"frames": frames}))
    rig = ["--calibration", str(tmp_path / "sim" / "calibration.toml"), "--fps", "25"]
    words = ["import", "detections", str(tmp_path / "in"), str(tmp_path / "rec"), *rig]
    assert run(*words) == 2  # which hand it is nobody says
    assert run(*words, "--skeleton", HAND.name) == 0
    table = tmp_path / "hands.csv"
    assert run("replay", str(tmp_path / "rec"), "--cameras", "2", "--poses", str(table)) == 0
    found = shown(table, HAND)
    errors_m = [
        min((np.linalg.norm(hand - m, axis=-1) for (at, _), m in found.items() if at == slot),
            key=np.nanmedian, default=np.full(21, np.inf))
        for slot in range(FROM, made.num_slots) for hand in made.truth.joints_m[slot]
    ]  # fmt: skip
    middle_mm = 1000 * np.median(errors_m, axis=0)
    assert np.mean(np.median(errors_m, axis=1) < 0.1) > 0.95 and middle_mm.max() < 60.0, middle_mm
    for name in ("walk.trc", "walk.c3d", "walk.glb", "walk.bvh"):
        assert run("export", str(table), str(tmp_path / name)) == 0
    for track in {track for _, track in found}:
        there = {slot: m for (slot, one), m in found.items() if one == track}
        read = [_trc(tmp_path, track, HAND), _c3d(tmp_path, track, HAND),
                _glb(tmp_path, track, there, HAND), _bvh(tmp_path, track, HAND)]  # fmt: skip
        for places in read:
            off = [np.abs(places[slot] - m) for slot, m in there.items() if slot in places]
            assert off and np.nanmax(off) < 1e-3


def test_the_page_draws_all_limbs(replayed: Path) -> None:
    text = (replayed / "page.html").read_text()
    limbs = re.search(r'"limbs": ?(\[\[.*?\]\])', text)
    assert limbs is not None
    assert [tuple(limb) for limb in json.loads(limbs[1])] == list(WHOLE.limbs)


def _trc(folder: Path, track: int, of: Skeleton = WHOLE) -> dict[int, Floats]:
    """Places by slot, metres, z up."""
    lines = (folder / f"walk-track{track}.trc").read_text().splitlines()
    names = [name for name in lines[3].split("\t")[2:] if name]
    assert names == list(of.joints)
    first = round(25 * float(lines[5 if lines[5].strip() else 6].split("\t")[1]))
    found = {}
    for row, line in enumerate(line for line in lines[5:] if line.strip()):
        values = [float(v) if v else np.nan for v in line.split("\t")[2 : 2 + 3 * len(names)]]
        x, y, z = np.array(values).reshape(-1, 3).T / 1000
        found[first + row] = np.stack([x, -z, y], axis=-1)
    return found


def _c3d(folder: Path, track: int, of: Skeleton = WHOLE) -> dict[int, Floats]:
    import ezc3d

    file = ezc3d.c3d(str(folder / "walk.c3d"))
    point = file["parameters"]["POINT"]
    labels = [*point["LABELS"]["value"], *point.get("LABELS2", {"value": []})["value"]]
    assert len(labels) % len(of) == 0 and (len(labels) > 255) == (of is WHOLE)
    columns = [labels.index(f"track{track}:{joint}") for joint in of.joints]
    begin = round(25 * float(file["parameters"]["E3POSE"]["START_S"]["value"][0]))
    places = np.moveaxis(file["data"]["points"][:3, columns], 0, -1) / 1000  # (joint, frame, 3)
    return {begin + frame: places[:, frame] for frame in range(places.shape[1])}


gltf = cache(Gltf)  # once for all tracks


def _glb(
    folder: Path, track: int, there: dict[int, Floats], of: Skeleton = WHOLE
) -> dict[int, Floats]:
    file, found = gltf(folder / "walk.glb"), {}
    first = min(_c3d(folder, track, of))
    nodes = [file.names.index(f"track{track}_{joint}") for joint in of.joints]
    for slot in list(there)[:40:6]:
        places = np.array([file.world(node, (slot - first) / 25)[1] for node in nodes])
        found[slot] = np.stack([places[:, 0], -places[:, 2], places[:, 1]], axis=-1)
    return found


def _bvh(folder: Path, track: int, of: Skeleton = WHOLE) -> dict[int, Floats]:
    names, _, _, _, world = read_bvh(folder / f"walk-track{track}.bvh")
    first = min(_trc(folder, track, of))
    columns = [names.index(joint) for joint in of.joints]
    y_up = world[:, columns]
    places = np.stack([y_up[..., 0], -y_up[..., 2], y_up[..., 1]], axis=-1)
    return {first + frame: each for frame, each in enumerate(places)}


def _wide(folder: Path, track: int) -> dict[int, Floats]:
    from e3pose.output.exports.source import Asked, take_from_table

    take = take_from_table(folder / "walk.parquet", Asked(tracks=(track,)))
    assert take.skeleton == WHOLE
    (motion,) = take.motions
    return {motion.first + row: each for row, each in enumerate(motion.joints_m)}
