"""Parts of one's own are found by name, as files, as modules and in installed packages."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case

from e3pose import InputError, ReplaySettings, replay
from e3pose.recording import Recording
from e3pose.select.policies import PolicySettings, Selection, Situation, policy_row
from e3pose.settings.site_file import read_site
from e3pose.simulate import DetectorSettings, SceneSettings, simulate

MINE = """
import numpy as np
class Last:
    def select(self, situation):
        return np.arange(len(situation.online)) == len(situation.online) - 1
def counted(settings):
    assert settings.num_selected == 3
    return Last()
finished = Last()
"""

OTHERS = """
import numpy as np
class Mute:
    pass
class Wide:
    def select(self, situation):
        return np.ones(7, dtype=bool)
class Counts:
    def select(self, situation):
        return [0, 2]
class Listed:
    def select(self, situation):
        return [False, False, True]
"""


class First:
    """Wakes the first camera."""

    def select(self, situation: Situation) -> Selection:
        return np.asarray(np.arange(len(situation.online)) == 0)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "mine_policies.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def scene() -> Recording:
    perfect = DetectorSettings(perfect=True)
    return simulate(SceneSettings(people=1, seconds=1.0, fps=10, cameras=3, detector=perfect), 3)


def test_an_object_decides_in_a_replay(scene: Recording) -> None:
    settings = ReplaySettings(pipeline="paper", warmup_slots=2)
    records = list(replay(scene, settings, policy=First()))
    assert [record.selected.tolist() for record in records[4:]] == [[True, False, False]] * 6


@each_case(
    "name",
    [
        "mine_policies:Last",
        "mine_policies.py:counted",
        "./mine_policies.py:finished",
        "others:Listed",  # a list of truth values
    ],
)
def test_a_name_decides_in_a_replay(name: str, folder: Path, scene: Recording) -> None:
    (folder / "others.py").write_text(OTHERS)
    records = list(replay(scene, ReplaySettings(pipeline="paper", policy=name, warmup_slots=2)))
    assert [record.selected.tolist() for record in records[4:]] == [[False, False, True]] * 6


def test_a_name_in_a_site_file_is_beside_it(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    table = {
        "format": "e3pose-site",
        "version": 1,
        "name": "lab",
        "calibration": "rig.toml",
        "fps": 25,
        "loop": {"policy": "mine_policies:Last"},
    }
    site = read_site(table, folder / "site.toml")
    made = policy_row(str(site.loop.policy)).make(PolicySettings())
    assert type(made).__name__ == "Last"


def test_an_installed_package_offers_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [EntryPoint("first", f"{__name__}:First", "e3pose.policies")]
    monkeypatch.setitem(sys.modules, __name__, sys.modules[First.__module__])
    monkeypatch.setattr(
        "e3pose.base.plugins.entry_points",
        lambda group: points if group == "e3pose.policies" else [],
    )
    assert isinstance(policy_row("first").make(PolicySettings()), First)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nobody", "policy: found 'nobody', expected one of all, random, "),
        ("no_module_here:Mine", "policy: found 'no_module_here:Mine', but No module named"),
        ("nowhere.py:Mine", "policy: found 'nowhere.py:Mine', but there is no file nowhere.py"),
        ("mine_policies:Gone", "policy: found no Gone in "),
    ],
)
def test_what_cannot_be_found_is_reported(name: str, message: str, folder: Path) -> None:
    with pytest.raises(InputError) as caught:
        policy_row(name)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Mute", "policy Mute: found a Mute, expected a method select(situation)"),
        ("Wide", "policy Wide: select: found ndarray of shape (7,), bool, expected an array of "),
        ("Counts", "policy Counts: select: found list of shape (2,), int64, expected an array of "),
    ],
)
def test_a_policy_that_does_not_select_is_reported(
    name: str, message: str, folder: Path, scene: Recording
) -> None:
    (folder / "others.py").write_text(OTHERS)
    settings = ReplaySettings(pipeline="paper", policy=f"others:{name}", warmup_slots=2)
    with pytest.raises(InputError) as caught:
        list(replay(scene, settings))
    assert message in str(caught.value) and "\n" not in str(caught.value)
