"""A camera with what the extra `camera` brings, and no more, starts and says that it is ready."""

from __future__ import annotations

import datetime
import re
import signal
import subprocess
import sys
from pathlib import Path
from threading import Timer

import pytest

from e3pose.recording import save_recording
from e3pose.simulate import DetectorSettings, SceneSettings, simulate
from e3pose.wire.keys.folder import add_keys, init_keys

PROJECT = (Path(__file__).parents[2] / "pyproject.toml").read_text()
# Runs the program where some packages cannot be imported.
WITHOUT = """
import sys
class Missing:
    names = sys.argv.pop(1).split(",")
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Missing())
from e3pose.cli.app import main
main()
"""


def brings(extra: str) -> set[str]:
    """Return the packages of an extra as they are imported."""
    (text,) = re.findall(rf"^{extra} = \[(.*?)^\]", PROJECT, re.S | re.M)
    names = set(re.findall(r'^  "([a-z-]+)', text, re.M))
    imported = {
        "eclipse-zenoh": "zenoh",
        "pyyaml": "yaml",
        "prometheus-client": "prometheus_client",
    }
    return {imported.get(name, name) for name in names}


def test_edge_brings_what_a_camera_does_without() -> None:
    assert brings("edge") - brings("camera") >= {"numba", "sqlalchemy", "pyarrow"}


@pytest.mark.parametrize("verb", ["camera", "power"])
def test_verb_of_a_camera_needs_no_package_of_the_edge(verb: str, tmp_path: Path) -> None:
    lacks = ",".join(sorted(brings("edge") - brings("camera") | {"matplotlib", "plotly", "torch"}))
    arguments = ["power", "--seconds", "0.1"]
    if verb == "camera":
        scene = SceneSettings(
            people=1, seconds=1.0, fps=10, cameras=2, detector=DetectorSettings(perfect=True)
        )
        save_recording(simulate(scene, 0), tmp_path / "scene")
        now = datetime.datetime.now(datetime.timezone.utc)
        init_keys(tmp_path / "keys", "lab", [], now)
        keys = add_keys(tmp_path / "keys", "cam0", now)
        arguments = ["camera", "--site", "lab", "--name", "cam0", "--keys", str(keys)]
        arguments += ["--source", f"recorded:{tmp_path / 'scene'}"]
        arguments += ["--endpoint", "tls/localhost:9"]  # nobody is there
    program = subprocess.Popen(
        [sys.executable, "-c", WITHOUT, lacks, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    timer = Timer(60, program.kill)
    timer.start()
    with program:
        assert program.stdout is not None
        said = []
        for line in program.stdout:
            said.append(line)
            if "ready" in line:
                program.send_signal(signal.SIGINT)
        assert program.wait() in (0, 130), said  # 130: not yet waiting for a signal
    timer.cancel()
    assert "".join(said).count("ready" if verb == "camera" else "device") == 1
