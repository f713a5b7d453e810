"""What an edge compiles or loads before its first slot is all that its slots need."""

from __future__ import annotations

import gc
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case
from tests.live.processes import COMPILE_S
from tests.waiting import eventually

from e3pose.base.dispatcher import KernelDispatcher
from e3pose.edge import precompile
from e3pose.edge.precompile import Beside, warm_up
from e3pose.model.skeleton import BODY_JOINTS, SKELETONS, Skeleton
from e3pose.pipeline import initial_state, step
from e3pose.recording.record import ViewSeries
from e3pose.settings.loop import ReplaySettings
from e3pose.settings.parts import make_pipeline
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate

CASES = {
    "default": ReplaySettings(policy="information", num_selected=2, lead_slots=2),
    "target": ReplaySettings(policy="information", target_error_m=0.04, feedback=True),
    "paper": ReplaySettings(pipeline="paper", policy="e3pose", num_selected=2),
    "occlusion": ReplaySettings(policy="central-2d", num_selected=2),
}


def loaded() -> set[tuple[str, str]]:
    """Return the kernels of this process, and the types that they are ready for."""
    kernels = (kernel for kernel in gc.get_objects() if isinstance(kernel, KernelDispatcher))
    return {(str(kernel.py_func), str(types)) for kernel in kernels for types in kernel.overloads}


def loaded_in_slots(settings: ReplaySettings) -> set[tuple[str, str]]:
    """Return what is compiled or loaded during the slots of a scene, after the warm-up."""
    scene = simulate(SceneSettings("ring", people=3, seconds=6.0, cameras=4), seed=0)
    pipeline = make_pipeline(scene, settings)
    warm_up(pipeline, scene.skeleton.joints)
    before, state = loaded(), initial_state(pipeline)
    for slot in range(scene.num_slots):
        seen = {camera: series.view(slot) for camera, series in enumerate(scene.views)}
        views = {c: view for c, view in seen.items() if view and state.selections[0][c]}
        state, _record = step(pipeline, state, views, np.ones(4, dtype=bool))
    assert before and state.shown is not None and len(state.shown.people)
    return loaded() - before


@each_case("skeleton", [one for one in SKELETONS.values() if {*one.joints} >= BODY_JOINTS], ids=str)
def test_somebody_is_followed_before_the_first_slot(
    skeleton: Skeleton, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels of the selection wait for a person who stands as people do."""
    scene = simulate(SceneSettings("ring", people=1, seconds=0.5, cameras=4), seed=0)
    views = tuple(ViewSeries.from_views((), (), (), len(skeleton)) for _ in scene.views)
    empty = replace(scene, skeleton=skeleton, views=views, truth=None)
    shown: list[int] = []

    def counted(*given: Any) -> Any:
        state, record = step(*given)
        shown.append(len(record.people))
        return state, record

    monkeypatch.setattr(precompile, "step", counted)
    warm_up(make_pipeline(empty, CASES["default"]), skeleton.joints)
    assert shown[-1] == 1


@pytest.mark.slow
def test_edges_of_a_program_share_a_process_that_compiles(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = simulate(SceneSettings("ring", people=1, seconds=0.5, cameras=4), seed=0)
    given = make_pipeline(scene, CASES["target"]), scene.skeleton.joints, None
    monkeypatch.setattr(precompile, "is_cached", lambda kernel: None)
    assert Beside.start(*given) is None  # nothing can be kept
    monkeypatch.setattr(precompile, "is_cached", lambda kernel: False)
    unknown = replace(given[0], policy=lambda: None)  # type: ignore[arg-type]
    assert Beside.start(unknown, *given[1:]) is None  # cannot be given to a process
    beside = Beside.start(*given)
    assert beside is not None and Beside.start(*given) is beside
    assert eventually(beside.ended, COMPILE_S) and beside._process.returncode == 0
    beside.leave()
    beside.leave()


def test_what_a_process_says_is_left_passes() -> None:
    beside = object.__new__(Beside)
    beside._left_s = beside._said_s = 0.0
    assert beside.left_s() == 0.0
    beside._follow([b"compiling: 40 s left\n", b"compiling: 35 s left\n", b"nonsense\n"])
    assert 34.0 < beside.left_s() <= 35.0
    beside._said_s -= 60.0
    assert beside.left_s() == 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        "target",  # has what the default has
        "paper",
        *(pytest.param(one, marks=pytest.mark.nightly) for one in ("default", "occlusion")),
    ],
)
def test_nothing_is_compiled_once_slots_run(case: str) -> None:
    """In a process of its own: what other tests loaded needs no loading."""
    code = f"import {__name__} as here; print(here.loaded_in_slots(here.CASES[{case!r}]))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ran.stdout.strip() == "set()", ran.stdout + ran.stderr
