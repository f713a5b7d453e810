"""The layers: what each part may import, proven in a fresh interpreter, and shown to bite."""

from __future__ import annotations

import functools
import json
import subprocess
import sys

import pytest

HEAVY = {
    "torch",
    "cv2",
    "onnxruntime",
    "numba",
    "av",
    "plotly",
    "matplotlib",
    "pyarrow",
    "joblib",
    "asyncio",
    "sqlalchemy",
    "zenoh",
    "psutil",
    "cryptography",
    "structlog",
}
# The pure part: nouns, stages, policies, predictors. numpy, scipy and the standard library only.
PURE = [
    "camera",
    "distortion",
    "skeleton",
    "pose",
    "fuse",
    "track",
    "filter",
    "estimators",
    "occlusion",
    "sight",
    "energy",
    "pipeline",
    "foresight",
    "liveness",
    "slot_record",
    "turns",
    "uncertainty",
    "policies",
    "predictors",
    "evaluate.metrics",
    "evaluate.motion",
    "evaluate.prediction",
    "evaluate.tally",
    "recording.record",
    "noises",
    "foresight",
    "liveness",
    "turns",
    "coverage",
    "uncertainty",
    "power.learned",
    "power.budgets",
    "power.site",
    "wire.codec",
    "wire.offset",
    "clock",
    "edge.lead",
    "edge.roster",
]
LAYERS = {
    "edge",
    "node",
    "evaluate",
    "learning",
    "train",
    "cli",
    "report",
    "demo",
    "simulate",
    "datasets",
}


@functools.cache
def loaded_by(module: str) -> set[str]:
    """Return the top-level and e3pose modules that a fresh interpreter holds after one import."""
    code = f"import {module}, sys, json; print(json.dumps(sorted(sys.modules)))"
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    return set(json.loads(output))


@pytest.mark.parametrize("module", ["e3pose", *(f"e3pose.{name}" for name in PURE)])
def test_pure_module_imports_nothing_heavy(module: str) -> None:
    assert HEAVY & loaded_by(module) == set()


@pytest.mark.parametrize("name", [n for n in PURE if not n.startswith(("evaluate", "edge"))])
def test_imports_point_inward(name: str) -> None:
    outward = {
        m for m in loaded_by(f"e3pose.{name}") if m.split(".")[1:2] and m.startswith("e3pose.")
    }
    assert {m.split(".")[1] for m in outward} & LAYERS == set()


def test_guard_bites_on_a_shell() -> None:
    assert "numba" in HEAVY & loaded_by("e3pose.kernels.compile")


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom e3pose.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "print('LOADED', *sorted(m for m in sys.modules if '.' not in m))"
    )
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    loaded = set(output.rsplit("LOADED", 1)[1].split())
    assert "cyclopts" in loaded
    assert (HEAVY - {"asyncio"}) & loaded == set()
