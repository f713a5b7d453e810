"""The report page: self-contained, safe with hostile text, and right about what it draws."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.energy.saving import Savings, saving
from e3pose.evaluate.figures import Accuracy, CameraEnergy, Energy, Expected, Summary
from e3pose.model.camera import Camera, Rig
from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.output.report import figures, write_report
from e3pose.output.report import scene as scenes
from e3pose.output.report.page import cards, embed, headline, render, sentences
from e3pose.output.report.scene import (
    ASLEEP,
    AWAKE,
    BLIND,
    LOST,
    MAX_SLOTS,
    NUM_COLOURS,
    colours,
    frustum,
    scene,
)
from e3pose.pipeline import Reasons, SlotRecord
from e3pose.recording import Recording, Truth, ViewSeries
from e3pose.settings.loop import ReplaySettings

HOSTILE = "</script><script src='https://evil.example/x.js'></script><img src=x onerror=alert(1)>"


def rig(*names: str) -> Rig:
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    down = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along +y of the world
    return Rig(
        tuple(
            Camera.from_world_to_camera(name, (640, 480), K, down, [-float(i), 2.0, 4.0])
            for i, name in enumerate(names)
        )
    )


def recording(num_slots: int, name: str = "walk", **more: Any) -> Recording:
    cameras = rig("left", "right")
    empty = ViewSeries.from_views([], [], [], len(COCO17))
    return Recording(name, cameras, 25.0, num_slots, COCO17, (empty, empty), **more)


def record(slot: int, people: Sequence[int] = (), **more: Any) -> SlotRecord:
    joints = np.zeros((len(people), len(COCO17), 3)) + [0.25, 0.5, 1.0]
    first, found = np.array([True, False]), People(np.array(people, dtype=np.int64), joints)
    occlusion, deficit = np.array([0.125, np.nan]), np.array([1.0, 0.0])
    slots = slot, slot / 25, first, first, found, occlusion, deficit, first
    return replace(SlotRecord(*slots, stage_s={"fuse": 0.001}), **more)


def summary(**more: Any) -> Summary:
    cameras = {
        name: CameraEnergy(watts, 10.0, watts * 4, 50.0, 5.0)
        for name, watts in (("left", 10.0), ("right", 8.0))
    }
    energy = Energy("generic", "power-saving", 0.5, cameras, 50.0, 5.0, {})
    base = bare(policy="e3pose", settings=ReplaySettings(num_selected=1, policy="e3pose"))
    saved = Savings(saving(68.6, 100.0, measured=False), saving(3.0, 4.0, measured=True))
    return replace(base, **{"slots": 3, "energy": energy, "savings": saved, **more})


def bare(**more: Any) -> Summary:
    """Return the figures of a replay of which nothing is known."""
    nothing = Summary(
        "test", 0, "all", ReplaySettings(policy="all"), 0, Accuracy(), Expected(), None, None,
        None, {}, None,
    )  # fmt: skip
    return replace(nothing, **more)


class Page(HTMLParser):
    """Collects the tags of a page, and the text of its scripts by their ids."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: dict[str, str] = {}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        tag, attributes = self.tags[-1] if self.tags else ("", {})
        if tag == "script" and attributes.get("id"):
            key = str(attributes["id"])
            self.scripts[key] = self.scripts.get(key, "") + data


def page(source: Recording, records: Sequence[SlotRecord], figures: Summary) -> Page:
    return Page(render(source, records, figures))


def test_page_and_its_scripts_ask_the_network_for_nothing() -> None:
    shown = page(recording(3), [record(i, [4]) for i in range(3)], summary())
    for tag, attributes in shown.tags:
        assert tag not in ("link", "iframe", "object", "embed", "img", "base", "a")
        assert not attributes.keys() & {"src", "href", "action", "srcset", "onerror", "onload"}
    policies = [a["content"] or "" for t, a in shown.tags if t == "meta" and "http-equiv" in a]
    (policy,) = policies
    assert policy.startswith("default-src 'none'")
    assert not re.search(r"https?:|\*|connect-src", policy)
    # Own scripts and markup name no address.
    folder = Path(scenes.__file__).parent
    for name in ("page.html", "scene.js", "player.js", "charts.js"):
        text = (folder / name).read_text()
        assert not re.search(r"https?://|//cdn|fetch\(|XMLHttpRequest|innerHTML", text), name


def test_hostile_text_stays_text() -> None:
    truth = Truth(COCO17, (HOSTILE[:60],), np.zeros((2, 1, len(COCO17), 3)))
    source = recording(2, HOSTILE, source=HOSTILE, truth=truth)
    figures = summary(recording=HOSTILE, notes=(HOSTILE,))
    assert figures.energy is not None
    energy = replace(figures.energy, profile=HOSTILE)
    settings = replace(figures.settings, predictor=HOSTILE)
    figures = replace(figures, policy=HOSTILE, settings=settings, energy=energy)
    records = [record(i, [0], stage_s={HOSTILE: 0.1}) for i in range(2)]
    hostile, plain = page(source, records, figures), page(recording(2), records, summary())
    tags = [tag for tag, _ in hostile.tags]
    assert tags.count("script") == [tag for tag, _ in plain.tags].count("script") == 7
    assert "img" not in tags
    assert HOSTILE not in render(source, records, figures)


def test_embedded_json_cannot_end_its_script() -> None:
    value = {"a": "</script><!--&\u2028\u2029", "b": [1, None, "ü"]}
    text = embed(value)
    assert not set("<>&\u2028\u2029") & set(text)
    assert json.loads(text) == value


def test_scene_holds_what_happened() -> None:
    lost = record(1, arrived=np.array([False, False]))
    drawn = scene(recording(2), [record(0, [7]), lost])
    assert drawn["slots"] == [0, 1] and drawn["times"] == [0.0, 0.04]
    assert drawn["tracks"] == [7]
    assert drawn["people"][0][0] == [0, [250, 500, 1000] * len(COCO17)]
    assert drawn["people"][1] == []
    assert drawn["states"] == [[AWAKE, LOST], [0, 0]]
    assert drawn["occlusion"] == [[0.125, 0.125], [None, None]]
    assert drawn["stride"] == 1


def test_missing_and_absurd_joints_are_not_drawn() -> None:
    joints = np.zeros((1, len(COCO17), 3)) + 1.0
    joints[0, 0] = np.nan
    joints[0, 1] = 1e200
    made = replace(record(0), people=People(np.array([0]), joints))
    drawn = scene(recording(1), [made])
    flat = drawn["people"][0][0][1]
    assert flat[:6] == [None] * 6 and flat[6:9] == [1000] * 3
    assert max(drawn["high"]) < 10_000
    json.dumps(drawn, allow_nan=False)


def test_long_runs_and_crowds_are_thinned_and_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    count = 4 * MAX_SLOTS - 1
    records = [record(i) for i in range(count)]
    drawn = scene(recording(count), records)
    assert len(drawn["slots"]) <= MAX_SLOTS and drawn["stride"] == 4
    assert drawn["slots"][:3] == [0, 4, 8]
    assert f"one in 4 of {count} slots" in render(recording(count), records, bare())
    # Crowds are thinned too.
    monkeypatch.setattr(scenes, "MAX_COORDINATES", 3 * len(COCO17) * 10)
    records = [record(i, [0, 1]) for i in range(10)]
    assert scene(recording(10), records)["stride"] == 2


@each_case("slots", [0, 1, 5])
def test_nobody_seen_still_gives_a_page(slots: int, tmp_path: Path) -> None:
    path = tmp_path / "deep" / "report.html"
    write_report(recording(slots), [record(i) for i in range(slots)], bare(), path)
    text = path.read_text()
    said = "No people found" if slots else "The recording is empty"
    assert said in text
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]


def test_sentences_and_cards_say_what_is_known_once() -> None:
    records = [record(0, [0])]
    few = cards(recording(1), records, bare())
    assert few == [("1.0 of 2", "active cameras per slot, mean")]
    full = dict(cards(recording(1), records, summary(metrics=Accuracy(mpjpe_mm=31.7))))
    assert full["32 mm"].startswith("mean joint error")
    assert full["31 %"] == "whole camera saved (modelled)"
    assert full["25 %"] == "processor time saved (measured)"
    # Sentences say what the headline does not.
    text = " ".join(sentences(recording(2), [record(0, [1, 2]), record(1)], summary()))
    assert "2 slots of 40 ms, policy" in text and "People present in 50 % of the slots" in text
    assert "active" not in text and "sav" not in text  # the headline says it once
    said = headline(recording(2), [record(0, [1, 2]), record(1)], summary())[1]
    assert said.endswith("whole camera 31 % (modelled), processor time 25 % (measured).")


def test_page_begins_with_two_plain_sentences() -> None:
    slots = [record(slot, [3, 7]) for slot in range(1750)]
    said = headline(recording(1750), slots, bare())
    assert said[0] == "Up to 2 people followed in 2 cameras, for 1 min 10 s."
    assert said[1] == "On average 1.0 of 2 cameras were active."
    assert headline(recording(2), [record(0), record(1)], bare())[0].startswith("Nobody was found")
    assert len(headline(recording(0), [], bare())) == 2
    page = render(recording(1750), slots, bare())
    assert f'<p class="headline">{said[0]} {said[1]}</p>' in page


def test_blind_slots_are_named_and_drawn_and_are_no_rest() -> None:
    nobody = np.zeros(2, dtype=bool)
    blind = replace(record(1), selected=nobody, arrived=nobody, blind="orders-late")
    run = [record(0), blind, record(2), record(3)]
    drawn = scene(recording(4), run)
    assert drawn["states"] == [[1, 4, 1, 1], [0, 4, 0, 0]] and drawn["blind"] == {1: "orders late"}
    shown = page(recording(4), run, summary())
    charts = json.loads(shown.scripts["figures"])
    strip = charts["strips"]["data"][0]
    assert strip["text"][1] == ["idle", "blind slot, orders late", "idle", "idle"]
    assert charts["duty"]["data"][1]["x"] == [100.0, 0.0]  # not 75 %
    said = " ".join(sentences(recording(4), run, summary()))
    assert "In 1 of 4 slots (25 %) no view arrived (1 orders late)" in said
    assert ("1 of 4", "blind slots: no view arrived") in cards(recording(4), run, summary())
    assert "blind slot: no view arrived" in render(recording(4), run, summary())
    assert "blind slot: no view arrived" not in render(recording(1), [record(0)], summary())


def test_strip_gives_each_state_its_colour() -> None:
    def colour(state: int) -> str:
        share = state / 4
        return [str(name) for at, name in figures.STATE_COLOURS if float(str(at)) <= share][-1]

    wanted = [figures.PALE, figures.INK, figures.LOST, figures.BLIND]
    assert [colour(state) for state in (ASLEEP, AWAKE, LOST, BLIND)] == wanted


def test_energy_bars_compare_with_always_awake() -> None:
    charts = json.loads(
        page(recording(3), [record(i) for i in range(3)], summary()).scripts["figures"]
    )
    full, spent = charts["energy"]["data"]
    assert spent["x"] == [40.0, 32.0]
    np.testing.assert_allclose(full["x"], [40.0, 40.0])  # 50 Wh in 5 h is 10 W; for 4 s
    assert spent["text"] == ["−0 %", "−20 %"]
    shares, line = charts["duty"]["data"][1]["x"], charts["duty"]["layout"]["shapes"][0]
    assert shares == [100.0, 0.0]
    assert line["x0"] == pytest.approx(70)  # 1 of 2 cameras, and the margin of 0.2


def test_batteries_that_last_equally_long_have_one_time() -> None:
    assert "battery lasts 5.0 h instead of 5.0 h" in render(recording(3), [record(0)], summary())
    whole = summary().energy
    assert whole is not None
    left = replace(whole.cameras["left"], battery_hours=7.25)
    unequal = summary(energy=replace(whole, cameras={**whole.cameras, "left": left}))
    assert "battery lasts 5.0 to 7.2 h" in render(recording(3), [record(0)], unequal)


def test_people_present_together_differ_in_colours_that_the_player_has() -> None:
    together = [record(0, [0, 8, 16]), record(1, [0, 16]), record(2, [16, 24])]
    chosen = colours(together)
    assert chosen[0] == 0 and len({chosen[0], chosen[8], chosen[16]}) == 3
    assert chosen[24] == 0  # whoever had it is gone
    crowd = colours([record(0, range(20))])
    assert set(crowd.values()) == set(range(NUM_COLOURS))
    # Player has the colours that are counted on.
    text = (Path(scenes.__file__).parent / "scene.js").read_text()
    (listed,) = re.findall(r"const COLOURS = \[(.*?)\]", text)
    assert len(set(re.findall(r"#[0-9a-f]{6}", listed))) == NUM_COLOURS


def test_frustum_corners_project_onto_the_image_corners() -> None:
    (camera,) = rig("only").cameras
    points = frustum(camera, 0.5)
    np.testing.assert_allclose(points[0], camera.center_m)
    expected = [[-0.5, -0.5], [639.5, -0.5], [639.5, 479.5], [-0.5, 479.5]]
    np.testing.assert_allclose(camera.project(points[1:]), expected, atol=1e-9)


def test_truth_can_be_shown_where_there_is_some() -> None:
    joints = np.full((1, 2, len(COCO17), 3), np.nan)
    joints[0, 0] = 0.5
    truth = Truth(COCO17, ("a", "b"), joints)
    source = recording(1, truth=truth)
    assert scene(source, [record(0)])["truth"] == [[[500] * 3 * len(COCO17)]]
    assert any(a.get("id") == "truth" for _, a in page(source, [record(0)], bare()).tags)
    assert not any(a.get("id") == "truth" for _, a in page(recording(1), [record(0)], bare()).tags)


def test_reasons_are_shown_at_the_slot_they_were_given_for() -> None:
    gains = ([0.5, 0.25], [0.125, 0.75])
    records = [
        record(slot, reasons=Reasons(slot + 2, np.array(gain), np.array([1.0, 0.0]), 0.04))
        for slot, gain in enumerate(gains)
    ]
    drawn = scene(recording(4), [*records, record(2), record(3)])
    assert drawn["gain"] == [[None, None, 0.5, 0.125], [None, None, 0.25, 0.75]]
    assert drawn["expected"] == [None, None, 40, 40]
    shown = page(recording(4), [*records, record(2), record(3)], summary())
    assert any(attributes.get("id") == "why" for _, attributes in shown.tags)
    layout = json.loads(shown.scripts["figures"])["strips"]["layout"]
    titles = [note["text"] for note in layout["annotations"]]
    assert any("information gain" in title for title in titles)
    assert max(map(len, titles)) <= 41, titles  # what fits a page of 320 px
    without = page(recording(1), [record(0)], summary())
    assert not any(attributes.get("id") == "why" for _, attributes in without.tags)


def test_joints_are_drawn_by_their_uncertainty() -> None:
    sure = np.broadcast_to(0.01**2 * np.eye(3), (1, 17, 3, 3)).copy()
    sure[0, 4] *= 16
    made = record(0, [7])
    known = replace(made, people=replace(made.people, full_covariance_m2=sure))
    ((person,),) = scene(recording(1), [known])["people"]
    # For a standard deviation of 1 per axis the 90 % radius is 2.829: see tests/model.
    assert person[2][0] == 28
    assert person[2][4] == 113
    assert any(a.get("id") == "sure" for _, a in page(recording(1), [known], summary()).tags)
    assert not any(
        a.get("id") == "sure" for _, a in page(recording(1), [record(0, [7])], summary()).tags
    )


def test_page_opens_at_a_moment_like_most_others() -> None:
    all_on = np.array([True, True])
    people = [(), (1,), (1, 2), (1, 2, 3), (1, 2, 3), (1, 2), (1, 2), (1, 2), (1,)]
    run = [record(slot, ids) for slot, ids in enumerate(people)]
    run[2] = replace(run[2], selected=all_on)
    opened = scene(recording(len(run)), run)["start"]
    assert opened == 6  # not 3 or 4, which show somebody whom no other slot shows
    blind = [replace(each, blind="views-late" if each.slot == 6 else "") for each in run]
    assert scene(recording(len(run)), blind)["start"] in (5, 7)
    awake = [replace(each, selected=all_on) for each in run]
    assert scene(recording(len(run)), awake)["start"] == 6
    assert scene(recording(2), [record(0), record(1)])["start"] == 0
    assert scene(recording(2), [record(0), record(1, [4])])["start"] == 1


def moment(slot: int, places_m: Sequence[float], sigma_m: float) -> SlotRecord:
    """Return a slot with people at some places along x, as sure of each."""
    made = record(slot, list(range(1, len(places_m) + 1)))
    joints = made.people.joints_m.copy()
    joints[..., 0] = np.array(places_m)[:, None]
    sigma = np.full(joints.shape[:2], sigma_m)
    return replace(made, people=replace(made.people, joints_m=joints, sigma_m=sigma))


def test_page_opens_where_people_move_apart_and_the_error_is_usual() -> None:
    run = [
        moment(0, (0.0, 3.0), 0.02),
        moment(1, (0.0, 3.0), 0.02),  # as usual, and nobody moves
        moment(2, (0.1, 3.1), 0.10),
        moment(3, (0.2, 3.2), 0.025),
        moment(4, (0.3, 0.33), 0.02),  # one in the other: a ghost, perhaps
        moment(5, (0.3, 3.3), 0.06),
        moment(6, (0.3, 3.3), 0.02),
        moment(7, (0.4, 3.4), 0.001),
    ]
    assert scene(recording(len(run)), run)["start"] == 3
    only_near = [moment(slot, (0.1 * slot, 0.1 * slot + 0.05), 0.02) for slot in range(4)]
    assert scene(recording(4), only_near)["start"] in range(1, 4)
