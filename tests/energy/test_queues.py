"""Deficit queues, power profiles inside the paper's ranges, and savings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.energy.profiles import MODES, PROFILES
from e3pose.energy.queues import (
    active_cost_j,
    advance_deficit,
    lifetime_budget,
    load_profile,
    mean_watts,
    paper_percent,
    price,
)

# What 3 of 5 cameras save of CPU+GPU+WiFi+DDR in the paper, percent.
PAPER_SAVINGS = {"xavier-nx": (20.66, 31.21), "tx2": (17.72, 28.67)}


@each_case(
    ("name", "deficit", "budget", "selected", "expected"),
    [
        ("starts empty", 0.0, 0.6, False, 0.0),
        ("selected counts one slot", 0.0, 0.6, True, 1.0),
        ("drains by its budget", 1.0, 0.6, False, 0.4),
        ("never below zero", 0.25, 0.6, False, 0.0),
        ("drains before it is charged", 0.25, 0.6, True, 1.0),
        ("grows when over budget", 1.0, 0.25, True, 1.75),
    ],
)
def test_queue_follows_the_paper(
    name: str, deficit: float, budget: float, selected: bool, expected: float
) -> None:
    after = advance_deficit(np.array([deficit]), np.array([budget]), np.array([selected]))
    np.testing.assert_allclose(after, [expected], atol=1e-15, err_msg=name)


@given(
    st.lists(st.booleans(), min_size=1, max_size=200), st.floats(0.01, 1.0, allow_subnormal=False)
)
def test_queue_bounds_the_activity_beyond_the_budget(choices: list[bool], budget: float) -> None:
    deficit = np.zeros(1)
    for chosen in choices:
        deficit = advance_deficit(deficit, np.array([budget]), np.array([chosen]))
        assert deficit[0] >= 0
    assert sum(choices) <= budget * len(choices) + deficit[0] + 1e-9


@pytest.mark.parametrize("name", sorted(PAPER_SAVINGS))
def test_three_of_five_save_what_the_paper_says(name: str) -> None:
    low, high = PAPER_SAVINGS[name]
    percent = paper_percent(3 / 5, load_profile(name))
    assert low < percent < high
    # Near neither end: a figure at the edge would rest on one data set.
    assert abs(percent - (low + high) / 2) < (high - low) / 8


def test_devices_draw_about_half_when_they_only_capture() -> None:
    for name, least, most in (("xavier-nx", 0.4992, 0.5008), ("tx2", 0.45, 0.55)):
        profile = load_profile(name)
        assert least < profile.watts("power-saving") / profile.watts("active") < most


@each_case("name", PROFILES)
def test_rest_of_the_device_is_unchanged_and_every_figure_has_a_source(name: str) -> None:
    profile = load_profile(name)
    assert len({profile.watts(mode, "rest") for mode in MODES}) == 1
    assert profile.watts("aggressive-power-saving") < profile.watts("power-saving")
    for component in profile.components:
        assert all(len(component.sources[mode]) > 10 for mode in MODES)
        assert all(component.watts[mode] > 0 for mode in MODES)


def test_tx2_processor_changes_little_until_capture_stops() -> None:
    (cpu,) = [c for c in load_profile("tx2").components if c.name == "cpu"]
    active, idle, aggressive = (cpu.watts[mode] for mode in MODES)
    assert idle == pytest.approx(active, rel=0.06)
    # Compared with all five cameras active, as the other savings; two of them do not capture.
    assert 2 / 5 * (idle - aggressive) / active == pytest.approx(0.1764, abs=0.003)


def profile_text(**changes: str) -> str:
    figures = {
        "format": 'format = "e3pose-power-profile"',
        "version": "version = 1",
        "name": 'name = "mine"',
        "title": 'title = "my board"',
        "head": "[components.gpu]",
        "group": 'group = "cpu_gpu"',
        "active": 'active = { watts = 8, source = "meter" }',
        "saving": 'power-saving = { watts = 2, source = "meter" }',
        "aggressive": 'aggressive-power-saving = { watts = 1.0, source = "meter" }',
        "more": """[components.board]
group = "rest"
active = { watts = 2, source = "meter" }
power-saving = { watts = 2, source = "meter" }
aggressive-power-saving = { watts = 2, source = "meter" }""",
    }
    return "\n".join((figures | changes).values())


def test_power_of_a_known_device(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(profile_text())
    profile = load_profile(path)
    assert profile.name == "mine"
    # The GPU draws 8 or 2 W, the board always 2 W; the second camera is on half of the time.
    duty = np.array([1.0, 0.5])
    np.testing.assert_allclose(mean_watts(duty, [profile] * 2), [10, 7])
    np.testing.assert_allclose(mean_watts(duty, [profile] * 2, group="cpu_gpu"), [8, 5])
    assert paper_percent(0.5, profile) == pytest.approx(37.5)
    assert paper_percent(1.0, profile) == pytest.approx(0, abs=1e-9)
    deeper = mean_watts(duty, [profile] * 2, "aggressive-power-saving")
    np.testing.assert_allclose(deeper, [10, 6.5])


@each_case("duty", [[], [1.2], [np.nan]])
def test_impossible_duty_is_said(duty: list[float]) -> None:
    with pytest.raises(InputError, match="duty"):
        mean_watts(np.array(duty), [load_profile("tx2")] * len(duty))


@each_case(
    ("field", "changes"),
    [
        ("format", {"format": 'format = "recording"'}),
        ("format", {"format": ""}),
        ("version", {"version": "version = 3"}),
        ("version", {"version": "version = true"}),
        ("name", {"name": "name = 3"}),
        ("colour", {"title": 'title = "x"\ncolour = "red"'}),
        ("components", {"head": "", "more": ""}),
        ("components[gpu].group", {"group": 'group = "fpga"'}),
        ("components[gpu]: missing: active =", {"active": ""}),
        ("components[gpu].active", {"active": "active = 8"}),
        ("components[gpu].active: missing: source =", {"active": "active = { watts = 8 }"}),
        ("components[gpu].active.watts", {"active": 'active = { watts = -1, source = "m" }'}),
        ("components[gpu].active.watts", {"active": 'active = { watts = nan, source = "m" }'}),
        ("components[gpu].active.watts", {"active": 'active = { watts = "8", source = "m" }'}),
        ("components[gpu].active: found unknown key 'volts'", {"active": "active = { volts = 1 }"}),
        ("components", {"group": 'group = "rest"'}),
        ("power-saving", {"saving": 'power-saving = { watts = 9, source = "m" }'}),
        ("file", {"name": "name = "}),
    ],
)
def test_wrong_profile_is_one_line_naming_file_and_field(
    tmp_path: Path, field: str, changes: dict[str, str]
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(profile_text(**changes))
    with pytest.raises(InputError) as error:
        load_profile(path)
    assert str(error.value).startswith(f"{path}: ")
    assert field in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_unknown_huge_and_binary_profiles_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="xavier-nx, tx2, generic"):
        load_profile("toaster")
    huge = tmp_path / "huge.toml"
    huge.write_text(profile_text() + "\n#" + "x" * 200_000)
    with pytest.raises(InputError, match="at most 100000"):
        load_profile(huge)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match="expected TOML"):
        load_profile(binary)


def test_a_lifetime_spends_the_battery_to_the_end_of_it() -> None:
    profiles = [load_profile("xavier-nx"), load_profile("tx2"), load_profile("generic")]
    battery_wh = np.array([50.0, 40.0, 80.0])
    share = lifetime_budget(6 * 3600, battery_wh, profiles, ["a", "b", "c"])
    hours = battery_wh / mean_watts(share, profiles)
    np.testing.assert_allclose(hours[:2], 6.0)
    assert share[2] == 1  # more than it can spend
    assert hours[2] > 6
    deeper = lifetime_budget(
        6 * 3600, battery_wh, profiles, ["a", "b", "c"], "aggressive-power-saving"
    )
    assert (deeper[:2] > share[:2]).all()


def test_a_lifetime_that_idle_cameras_outspend_names_the_camera() -> None:
    profiles = [load_profile("xavier-nx")] * 2  # 6.25 W when idle
    with pytest.raises(InputError, match=r"lifetime: found 4 h for camera b, .* than 3\.2 h"):
        lifetime_budget(4 * 3600, [50, 20], profiles, ["a", "b"])
    for never in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="lifetime"):
            lifetime_budget(never, 50, profiles, ["a", "b"])


def test_price_is_the_papers_queue_where_cameras_cost_the_same() -> None:
    deficit = np.array([0.0, 1.5, 3.0])
    np.testing.assert_allclose(price(deficit, np.full(3, 0.25)), deficit)
    # Twice the joules per slot: a queue of as many slots holds twice as much, and grows by twice.
    dearer = price(np.ones(3), np.array([2.0, 1.0, 1.0]))
    assert dearer[0] == pytest.approx(4 * dearer[1])


def test_cost_is_what_an_active_slot_adds() -> None:
    profiles = [load_profile("xavier-nx"), load_profile("tx2")]
    np.testing.assert_allclose(
        active_cost_j(profiles, "power-saving", 0.04), [6.25 * 0.04, 5.55 * 0.04]
    )


def test_an_idle_camera_that_sends_draws_the_power_of_its_wifi() -> None:
    profile = load_profile("xavier-nx")
    duty = np.array([0.4, 0.4])

    def more_w(group: str | None) -> Floats:
        silent = mean_watts(duty, [profile] * 2, group=group)
        sending = mean_watts(duty, [profile] * 2, sending=np.array([0.0, 0.5]), group=group)
        return np.asarray(sending - silent)

    radio_w = 0.5 * (profile.watts("active", "wifi") - profile.watts("power-saving", "wifi"))
    assert radio_w > 0
    for group in (None, "wifi"):
        np.testing.assert_allclose(more_w(group), [0, radio_w])
    np.testing.assert_allclose(more_w("cpu_gpu"), 0)
    lost = paper_percent(0.4, profile) - paper_percent(0.4, profile, sending=0.5)
    assert lost == pytest.approx(100 * radio_w / profile.paper_watts("active"))
