"""The examples run and say what they promise."""

from __future__ import annotations

import re
import runpy
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from tests.cases import each_case
from tests.waiting import eventually

from e3pose.model.people import People
from e3pose.model.skeleton import COCO17
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.connect import LiveSlot
from e3pose.site.example import write_recorded
from e3pose.store import Store

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parent.parent / "examples"


def test_triangulate_example_finds_the_people(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / "01_triangulate.py"), run_name="__main__")
    output = capsys.readouterr().out
    numbers = re.search(r"found (\d+) of (\d+) people, mean joint error (\d+) mm", output)
    assert numbers is not None
    found, people, error_mm = map(int, numbers.groups())
    assert people == 200 and found >= 190
    assert error_mm < 40


@each_case(
    ("example", "message"),
    [
        ("02_own_policy.py", r"(cam\d: awake in \d+% of the slots\n){4}"),
        ("03_own_predictor.py", r"[12]\.\d people shown a slot, chosen for 3 slots ahead\n"),
        ("04_own_detector.py", r"right_wrist: 31\.5, 41\.5\nleft_wrist: 121\.5, 61\.5\n"),
        ("05_own_estimator.py", r"[12]\.\d people shown a slot, each as the mean of 3 slots\n"),
        ("10_own_event.py", r"(\d+\.\d s: person \d+ crouches, (begun|ended)\n){2}"),
        ("06_live.py", r"slot \d+: 3 cameras online, [012] people\n"),
    ],
)
def test_example_says_what_it_promises(
    example: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    runpy.run_path(str(EXAMPLES / example), run_name="__main__")
    output = capsys.readouterr().out
    assert re.fullmatch(message, output), output


def test_examples_watch_a_site_and_ask_its_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import matplotlib

    matplotlib.use("agg")
    monkeypatch.chdir(tmp_path)
    live = runpy.run_path(str(EXAMPLES / "06_live.py"))
    watch = runpy.run_path(str(EXAMPLES / "07_watch.py"))["main"]
    ask = runpy.run_path(str(EXAMPLES / "08_query.py"))["main"]
    recording = simulate(SceneSettings(people=2, seconds=4, fps=12.5, cameras=3), seed=1)
    site_file = write_recorded(tmp_path / "site", recording)
    with ExitStack() as stack:
        live["run"](site_file, stack)
        watch(site_file, seconds=1.0)
        output = capsys.readouterr().out
        assert re.match(
            r"(slot \d+, cameras .*: .*\n)+(track \d+: joints move \d\.\d m/s\n)+", output
        )
        store = site_file.with_name("live.db")
        assert eventually(lambda: len(Store(store).query()) > 10)
        ask(store)
    output = capsys.readouterr().out
    assert re.match(r"slots \d+ to \d+, \d tracks\n(track \d+: nose at \d\.\d\d m\n)+", output)
    assert (tmp_path / "slot.png").stat().st_size > 5000


def test_ros_example_draws_the_limbs_that_are_known() -> None:
    """With stand-ins for the messages of ROS, which is not on the package index."""
    skeletons = runpy.run_path(str(EXAMPLES / "09_ros2_node.py"))["skeletons"]

    def marker() -> SimpleNamespace:
        return SimpleNamespace(
            pose=SimpleNamespace(orientation=SimpleNamespace(w=0.0)), scale=SimpleNamespace(x=0.0),
            color=SimpleNamespace(g=0.0, a=0.0), lifetime=SimpleNamespace(sec=0, nanosec=0),
        )  # fmt: skip

    made = type("Marker", (), {"LINE_LIST": 5, "ADD": 0, "__new__": lambda cls: marker()})
    joints_m = np.tile(np.arange(17.0)[:, None], (1, 1, 3)).astype(np.float32)
    joints_m[0, 9] = np.nan
    slot = LiveSlot(3, 0, People(np.array([7]), joints_m), COCO17.joints, (), (), 0)
    (found,) = skeletons(slot, "header", SimpleNamespace(Marker=made, Point=SimpleNamespace))
    assert (found.id, found.type, found.header) == (7, 5, "header")
    shown = [limb for limb in COCO17.limbs if 9 not in limb]
    assert [int(point.x) for point in found.points] == [end for limb in shown for end in limb]
