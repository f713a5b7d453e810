"""Tables of what cameras can do: rows of power profiles, and what follows from the components."""

from pathlib import Path

import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.energy.modes import RESTS
from e3pose.energy.profiles import PROFILES, load_profile, modes_of, profile_text

BASE = """
format = "e3pose-power-profile"
version = {version}
name = "board"
title = "a board"

[components.all]
group = "cpu_gpu"
active = {{ watts = 8.0, source = "meter" }}
power-saving = {{ watts = 4.0, source = "meter" }}
aggressive-power-saving = {{ watts = 3.0, source = "meter" }}
"""
SUSPENDED = """
[rests.suspended]
watts = 0.4
enter_s = 1.5
wake_s = 2.5
wake_sd_s = 0.25
source = "wall plug, 2026-05-02"
"""
TRACKED = """
[looks.tracked]
joules = 0.03
latency_s = 0.006
source = "tegrastats, 1000 looks"
"""


def profile(folder: Path, rows: str = "", version: int = 2) -> Path:
    file = folder / "board.toml"
    file.write_text(BASE.format(version=version) + rows)
    return file


def test_a_profile_without_rows_has_only_what_its_components_say(tmp_path: Path) -> None:
    for version in (1, 2):
        modes = modes_of(load_profile(profile(tmp_path, version=version)), interval_s=0.08)
        assert [look.name for look in modes.looks] == ["whole", "nothing"]
        assert [rest.name for rest in modes.rests] == ["idle", "not-capturing"]
        whole, idle = modes.look("whole"), modes.rest("idle")
        assert whole is not None and whole.joules == pytest.approx((8 - 4) * 0.08)
        assert whole.source == "active less power-saving, 80 ms"
        assert idle is not None and (idle.watts, idle.wake_s) == (4.0, 0.0)
        assert modes.rest("suspended") is None and modes.look("tracked") is None


def test_rows_of_a_profile_are_in_the_table_with_their_sources(tmp_path: Path) -> None:
    modes = modes_of(load_profile(profile(tmp_path, SUSPENDED + TRACKED)))
    suspended, tracked = modes.rest("suspended"), modes.look("tracked")
    assert suspended is not None and tracked is not None
    assert (suspended.watts, suspended.enter_s) == (0.4, 1.5)
    assert (suspended.wake_s, suspended.wake_sd_s) == (2.5, 0.25)
    assert (tracked.joules, tracked.latency_s) == (0.03, 0.006)
    assert "wall plug" in suspended.source and "tegrastats" in tracked.source
    assert modes.table == "profile board"
    written = tmp_path / "written.toml"
    written.write_text(profile_text(load_profile(profile(tmp_path, SUSPENDED + TRACKED))))
    assert modes_of(load_profile(written)) == modes


@each_case("name", PROFILES)
def test_a_shipped_profile_rests_no_louder_the_deeper_it_rests(name: str) -> None:
    modes = modes_of(load_profile(name))
    watts = [round(rest.watts, 6) for rest in modes.rests]
    assert watts == sorted(watts, reverse=True)
    assert [r.name for r in modes.rests] == [n for n in RESTS if modes.rest(n) is not None]
    # Nobody measured a suspended board for us, and none of these states a figure without one.
    assert modes.rest("asleep") is not None and modes.rest("suspended") is None


@each_case(
    ("rows", "message"),
    [
        (SUSPENDED.replace("0.4", "5.0"), r"rests\[suspended\]\.watts: found 5 W, .* at most 3 W"),
        (SUSPENDED.replace("0.4", "nan"), r"rests\[suspended\]\.watts: found nan"),
        (SUSPENDED.replace("1.5", "-1"), r"rests\[suspended\]\.enter_s: found -1"),
        (SUSPENDED.replace("2.5", "true"), r"rests\[suspended\]\.wake_s: found a boolean"),
        (
            SUSPENDED.replace("suspended", "dozing"),
            r"rests\[dozing\]: .* 'idle' or 'not-capturing'",
        ),
        (SUSPENDED.replace("enter_s", "enter"), r"rests\[suspended\]: .* key 'enter', .*enter_s"),
        (TRACKED.replace("tracked", "nothing"), r"looks\[nothing\]: found 'nothing', .*'gate'"),
        (TRACKED + "colour = 1\n", r"looks\[tracked\]: found unknown key 'colour'"),
        ("[looks]\ntracked = 3\n", r"looks\[tracked\]: found a whole number, expected a table"),
    ],
)
def test_wrong_rows_are_refused_by_name(tmp_path: Path, rows: str, message: str) -> None:
    with pytest.raises(InputError, match=rf"board\.toml: {message}"):
        load_profile(profile(tmp_path, rows))


def test_a_file_of_version_1_has_no_rows(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="version: found 1, expected 2 where"):
        load_profile(profile(tmp_path, SUSPENDED, version=1))
