"""What is said of a replay: figures, tables that fit a terminal, and rows of poses."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyarrow import parquet
from rich.console import Console
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.energy.queues import load_profile
from e3pose.energy.saving import Savings
from e3pose.evaluate.columns import print_tables
from e3pose.evaluate.figures import as_json
from e3pose.evaluate.poses_table import write_poses
from e3pose.evaluate.replay import ReplaySettings
from e3pose.evaluate.summary import summarise
from e3pose.model.camera import Camera, Rig
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17, PANOPTIC19, SHELF14, Skeleton
from e3pose.pipeline import SlotRecord
from e3pose.recording import ProcessorTime, Recording, Truth, ViewSeries
from e3pose.select.policies import Selection, Situation

BODY = np.random.default_rng(1).normal(size=(17, 3))  # COCO-17, metres, every joint somewhere else
SELECTED = np.array([[1, 1], [1, 0], [1, 0], [0, 1]], dtype=bool)


def rig() -> Rig:
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    return Rig(
        tuple(
            Camera.from_world_to_camera(name, (640, 480), K, np.eye(3), [x, 0, 5])
            for name, x in (("left", 0.0), ("right", 1.0))
        )
    )


def recording(
    truth: Truth | None, complete: bool = True, scored: tuple[int, int] | None = None
) -> Recording:
    lost = ViewSeries.from_views([], [], [], 17)
    return Recording(
        "test", rig(), 10.0, 4, COCO17, (lost, lost), truth=truth, truth_complete=complete,
        scored_slots=scored,
    )  # fmt: skip


def record(slot: int, people: Sequence[Floats], ids: Sequence[int] | None = None) -> SlotRecord:
    joints = np.stack(people) if people else np.zeros((0, 17, 3))
    tracks = np.arange(len(people)) if ids is None else np.array(ids, dtype=np.int64)
    return SlotRecord(
        slot=slot,
        time_s=slot / 10,
        selected=SELECTED[slot],
        arrived=SELECTED[slot] & [True, slot != 3],
        people=People(tracks, joints, np.full(joints.shape[:2], 0.5)),
        occlusion=np.zeros(2),
        deficit=np.array([slot, 1.0]),
        next_selection=np.ones(2, dtype=bool),
        stage_s={"fuse": 0.001 * (slot + 1), "select": 0.0005},
    )


def summary(source: Recording, people: Sequence[Sequence[Floats]], **options: Any) -> Any:
    records = [record(slot, each) for slot, each in enumerate(people)]
    settings = ReplaySettings(policy="random", num_selected=1, seed=3)
    figures = summarise(source, settings, records, load_profile("generic"), **options)
    return json.loads(json.dumps(as_json(figures), allow_nan=False))


def same(skeleton: Skeleton, *people: Floats) -> Truth:
    joints = np.stack(people)
    return Truth(
        skeleton,
        tuple(f"actor{n + 1}" for n in range(len(people))),
        np.broadcast_to(joints, (4, *joints.shape)).copy(),
    )


def test_selection_energy_deficits_and_times() -> None:
    figures = summary(recording(None), [[]] * 4, battery_wh=52.0)
    assert figures["slots"] == 4
    assert figures["policy"] == "random"
    assert figures["settings"]["seed"] == 3
    assert figures["metrics"] == {}
    assert figures["selection"] == {
        "mean_cameras": 1.25, "mean_views": 1.0, "duty": {"left": 0.75, "right": 0.5}, "blind": {}
    }  # fmt: skip
    assert figures["deficits"]["final"] == {"left": 3.0, "right": 1.0}
    assert figures["deficits"]["highest"] == {"left": 3.0, "right": 1.0}
    # The generic device draws 10 W or 5.2 W, of which the paper's components 7.8 W or 3 W.
    energy = figures["energy"]
    whole = figures["savings"]["whole_camera"]
    assert whole["percent"] == pytest.approx(37.5 * 0.48) and whole["basis"] == "modelled"
    assert whole["always"] == pytest.approx(2 * 10 * 4 * 0.1)
    assert "processor_time" not in figures["savings"]
    assert energy["watts_spread"] == pytest.approx((8.8 - 7.6) / 2**0.5)
    assert energy["cameras"]["right"]["mean_watts"] == pytest.approx(7.6)
    assert energy["cameras"]["right"]["energy_j"] == pytest.approx(7.6 * 0.4)
    assert energy["cameras"]["right"]["battery_hours"] == pytest.approx(52 / 7.6)
    assert energy["battery_hours_always_active"] == pytest.approx(5.2)
    assert figures["stage_ms"]["fuse"]["median"] == pytest.approx(2.5)
    assert figures["stage_ms"]["fuse"]["p99"] == pytest.approx(3.97)
    assert figures["stage_ms"]["slot"]["median"] == pytest.approx(3.0)


def test_blind_slots_save_nothing() -> None:
    source, settings = recording(None), ReplaySettings(policy="random", num_selected=1, seed=3)
    seen = [record(slot, []) for slot in range(4)]
    nobody = np.zeros(2, dtype=bool)
    blind = [
        replace(seen[0], slot=slot, selected=nobody, arrived=nobody, blind="orders-late")
        for slot in range(4, 8)
    ]
    generic = load_profile("generic")
    alone, both = (summarise(source, settings, rows, generic) for rows in (seen, [*seen, *blind]))
    assert alone.energy is not None and both.energy is not None
    assert alone.selection is not None and both.selection is not None
    assert both.savings == alone.savings and both.savings.whole_camera is not None
    assert both.selection.duty == alone.selection.duty
    assert both.selection.mean_cameras == alone.selection.mean_cameras
    assert both.selection.blind == {"orders-late": 4} and alone.selection.blind == {}
    spent_j = [each.energy.cameras["left"].energy_j for each in (alone, both) if each.energy]
    assert spent_j[1] == pytest.approx(2 * spent_j[0])  # they are charged like the others
    never = summarise(source, settings, blind, generic)
    assert never.energy is None and never.savings == Savings()


def test_complete_truth_of_the_same_skeleton() -> None:
    shifted = BODY + [0.03, 0, 0]
    figures = summary(recording(same(COCO17, BODY)), [[shifted]] * 3 + [[]])["metrics"]
    assert "pcp" not in figures
    assert figures["scored_slots"] == 4
    assert figures["mpjpe_mm"] == pytest.approx(30.0)
    assert figures["recall_500mm"] == 0.75
    assert figures["precision_500mm"] == 1.0
    assert figures["ap"]["25"] == 0.0
    assert figures["ap"]["50"] == pytest.approx(75.0)
    assert figures["id_switches"] == 0


UNLABELLED = np.full((17, 3), np.nan)


@each_case(
    ("source", "people", "expected"),
    [
        (recording(same(COCO17, BODY), complete=False), [[BODY, BODY + 9]] * 4,
         {"recall_500mm": 1.0, "ap": None, "precision_500mm": None}),
        (recording(same(COCO17, BODY), scored=(2, 4)), [[], [], [BODY], [BODY]],
         {"recall_500mm": 1.0, "scored_slots": 2}),
        # Slots without a record are slots without people.
        (recording(same(COCO17, BODY)), [[BODY]], {"recall_500mm": 0.25}),
        (recording(same(COCO17, BODY)), [[]] * 4,
         {"recall_500mm": 0.0, "mpjpe_mm": None, "precision_500mm": None, "ap_150": 0.0}),
        (recording(same(COCO17, UNLABELLED)), [[BODY]] * 4, {"said": {"scored_slots"}}),
        (recording(same(SHELF14, UNLABELLED[:14])), [[BODY]] * 4, {"said": {"scored_slots"}}),
    ],
    ids=["partial truth", "scored slots", "no records", "nobody", "no labels", "none of Shelf"],
)  # fmt: skip
def test_only_what_can_be_said_is_said(
    source: Recording, people: Sequence[Sequence[Floats]], expected: dict[str, object]
) -> None:
    metrics = summary(source, people)["metrics"]
    figures = {**metrics, "ap_150": metrics.get("ap", {}).get("150"), "said": {*metrics}}
    assert {name: figures.get(name) for name in expected} == expected


@pytest.mark.parametrize("missing", ["left_hip", "right_hip"])
def test_people_without_a_root_are_dropped(missing: str) -> None:
    rootless = BODY.copy()
    rootless[COCO17.index(missing)] = np.nan
    figures = summary(recording(same(COCO17, BODY, rootless + 7)), [[BODY]] * 4)["metrics"]
    assert figures["recall_500mm"] == 1.0


def test_panoptic_leaves_out_eyes_and_ears() -> None:
    truth = np.full((19, 3), 100.0)  # eyes and ears are absurd, and must not matter
    for index, joint in enumerate(PANOPTIC19.joints[:15]):
        sources = {
            "neck": ("left_shoulder", "right_shoulder"),
            "mid_hip": ("left_hip", "right_hip"),
        }
        names = sources.get(joint, (joint,))
        truth[index] = np.mean([BODY[COCO17.index(name)] for name in names], axis=0)
    figures = summary(recording(same(PANOPTIC19, truth)), [[BODY]] * 4)["metrics"]
    assert figures["mpjpe_mm"] == pytest.approx(0, abs=1e-9)
    assert figures["joint_coverage"] == 1.0
    assert figures["ap"]["25"] == pytest.approx(100.0)


def test_shelf_truth_is_scored_by_parts_of_converted_poses() -> None:
    truth = np.zeros((14, 3))
    for index, joint in enumerate(SHELF14.joints[:12]):
        truth[index] = BODY[COCO17.index(joint)]
    truth[12:] = [[50, 0, 0], [51, 0, 0]]  # a head that is not where the protocol puts it
    source = recording(same(SHELF14, truth, truth, truth), complete=False)
    pcp = summary(source, [[BODY]] * 3 + [[]])["metrics"]["pcp"]
    # Nine of ten limbs in three of four slots; the torso is longer than its end is wrong by half.
    assert pcp["groups"]["head"]["average"] == 0.0
    assert pcp["groups"]["lower_arms"]["average"] == 75.0
    assert pcp["groups"]["upper_legs"]["actor1"] == 75.0
    assert set(pcp) == {"actor1", "actor2", "actor3", "average", "groups"}


def test_changed_identity_is_counted() -> None:
    source = recording(same(COCO17, BODY))
    records = [record(slot, [BODY], [1 if slot < 2 else 7]) for slot in range(4)]
    figures = summarise(source, ReplaySettings(), records, load_profile("tx2"))
    assert figures.metrics.id_switches == 1
    assert figures.identities == 2


def test_an_empty_replay_is_summarised() -> None:
    figures = summarise(recording(None), ReplaySettings(), [], load_profile("tx2"))
    assert figures.slots == 0
    assert figures.selection is None and figures.energy is None
    table = as_json(figures)
    assert table["selection"] == table["energy"] == table["stage_ms"] == table["metrics"] == {}
    assert (table["format"], table["version"]) == ("e3pose-figures", 2)


def test_parts_of_ones_own_are_named() -> None:
    class Mine:
        def select(self, situation: Situation) -> Selection:
            return situation.online

    settings = ReplaySettings(policy=Mine())
    figures = summarise(recording(None), settings, [], load_profile("tx2"))
    assert figures.policy == as_json(figures)["settings"]["policy"] == "Mine"


def played() -> list[SlotRecord]:
    return [record(slot, []) for slot in range(4)]


def measured(**cameras: ProcessorTime) -> Recording:
    return replace(recording(None), processor=cameras)


def test_processor_time_is_of_the_looks_and_frames_that_were_measured() -> None:
    told = measured(left=ProcessorTime(0.2, 0.01, 30), right=ProcessorTime(0.1, 0.02, 30))
    found = summarise(told, ReplaySettings(), played(), load_profile("xavier-nx")).savings
    assert found.processor_time is not None
    assert found.processor_time.spent == pytest.approx(3 * 0.2 + 2 * 0.1 + 4 * 0.03)
    assert found.processor_time.always == pytest.approx(4 * 0.33)
    assert found.processor_time.percent == pytest.approx(100 * (1 - 0.92 / 1.32))
    assert found.sentence().endswith("processor time 30 % (modelled)")
    none_captured = summarise(
        told,
        ReplaySettings(),
        played(),
        load_profile("xavier-nx"),
        idle_mode="aggressive-power-saving",
    ).savings.processor_time
    assert none_captured is not None
    assert none_captured.spent == pytest.approx(3 * 0.21 + 2 * 0.12)


@pytest.mark.parametrize("cameras", [{}, {"left": ProcessorTime(0.2, 0.01, 30)}])
def test_processor_time_that_was_not_measured_of_all_is_said_to_be_so(
    cameras: dict[str, ProcessorTime],
) -> None:
    found = summarise(measured(**cameras), ReplaySettings(), played(), load_profile("xavier-nx"))
    assert found.savings.processor_time is None
    assert found.savings.sentence().endswith("processor time not measured")
    assert "processor_time" not in as_json(found)["savings"]


NAMES = [f"figure {n}" for n in range(9)]
POLICIES = ["information", "round-robin"]


def printed(width: int) -> list[str]:
    out = StringIO()
    console = Console(file=out, width=width)
    columns = {name: [f"{name[-1]}1.5 +- 0.4", f"{name[-1]}2.5"] for name in NAMES}
    print_tables(console, {"policy": POLICIES}, columns, "a title")
    return out.getvalue().splitlines()


@each_case("width", [40, 60, 80, 240])
def test_every_figure_is_whole_at_any_width(width: int) -> None:
    lines = printed(width)
    assert all(len(line) <= width for line in lines)
    text = "\n".join(lines)
    for name in NAMES:
        assert name in text and f"{name[-1]}1.5 +- 0.4" in text
    assert text.count("information") == text.count("round-robin") == text.count("policy")
    assert (len(lines) == 4 and lines[0].strip() == "a title") == (width == 240), "one table"


NONE = np.zeros(3, dtype=bool)


def pose_record(slot: int, people: People) -> SlotRecord:
    none = np.zeros(3)
    return SlotRecord(slot, slot / 25, NONE, NONE, people, none, none, NONE)


def test_rows_name_slot_track_and_joint(tmp_path: Path) -> None:
    joints = np.full((2, 17, 3), np.nan)
    scores = np.zeros((2, 17))
    joints[0, 5], scores[0, 5] = [1.0, 2.0, 3.0], 0.5
    joints[1, 0], scores[1, 0] = [-1.0, 0.123456, 0], 1.0
    records = [
        pose_record(0, People.empty(17)),
        pose_record(3, People(np.array([7, 4]), joints, scores)),
    ]
    write_poses(records, COCO17, tmp_path / "poses.csv")
    rows = list(csv.DictReader((tmp_path / "poses.csv").read_text().splitlines()))
    assert [(r["slot"], r["time"], r["track"], r["joint"]) for r in rows] == [
        ("3", "0.12", "7", "left_shoulder"),
        ("3", "0.12", "4", "nose"),
    ]
    assert [float(rows[0][axis]) for axis in "xyz"] == [1, 2, 3]
    assert float(rows[1]["y"]) == 0.12346
    assert float(rows[0]["score"]) == 0.5


def test_a_table_in_parts_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    people = People(np.array([1]), np.ones((1, 17, 3)))
    records = [pose_record(slot, people if slot % 2 else People.empty(17)) for slot in range(6)]
    for most, name in ((2000, "whole"), (1, "parts")):
        monkeypatch.setattr("e3pose.evaluate.poses_table.CHUNK", most)
        write_poses(records, COCO17, tmp_path / f"{name}.parquet")
    whole, parts = (parquet.ParquetFile(tmp_path / f"{n}.parquet") for n in ("whole", "parts"))
    assert (whole.num_row_groups, parts.num_row_groups) == (1, 3)
    assert whole.read().equals(parts.read()) and whole.metadata.num_rows == 3 * 17


def test_unknown_ending_writes_nothing_and_nobody_a_table_without_rows(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="parquet"):
        write_poses([], COCO17, tmp_path / "poses.pkl")
    assert list(tmp_path.iterdir()) == []
    write_poses([pose_record(0, People.empty(17))], COCO17, tmp_path / "poses.csv")
    text = (tmp_path / "poses.csv").read_text()
    assert text.strip() == "slot,time,track,joint,x,y,z,score,measured,sigma"
