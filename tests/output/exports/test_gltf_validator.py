"""Animated glTF passes the validator of the standard's own authors."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.node_packages import installed, node
from tests.output.exports.takes import take

from e3pose.output.exports import export

pytestmark = [pytest.mark.network, pytest.mark.slow]

VALIDATOR = "gltf-validator@2.0.0-dev.3.10"  # Khronos
SCRIPT = """
const fs = require("fs"), path = require("path"), validator = require("gltf-validator");
const file = process.argv[2], beside = (uri) => path.join(path.dirname(file), uri);
const externalResourceFunction = async (uri) => new Uint8Array(fs.readFileSync(beside(uri)));
validator.validateBytes(new Uint8Array(fs.readFileSync(file)), { externalResourceFunction })
  .then((report) => console.log(JSON.stringify(report)));
"""


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return installed(tmp_path_factory.mktemp("node"), [VALIDATOR])


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_the_validator_finds_nothing(packages: Path, tmp_path: Path, suffix: str) -> None:
    ((path, _),) = export(take(), tmp_path / f"walk{suffix}", "gltf")
    report = json.loads(node(packages, SCRIPT, path))
    assert report["info"]["animationCount"] >= 1
    issues = report["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
