"""A live site from Python: an edge and its cameras in one program.

Run: python examples/06_live.py

Each camera would be a program on its own machine; here they play a simulated scene.
"""

from __future__ import annotations

import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from e3pose import open_camera, open_edge
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.edge_program import Edge
from e3pose.site.example import write_recorded

CAMERA = """
format = "e3pose-camera"
version = 1
site = "{site}"
camera = "{camera}"
endpoint = "{endpoint}"
source = "{source}"
"""


def run(site_file: Path, stack: ExitStack) -> Edge:
    """Start the edge and the cameras of a site, which end with the stack."""
    edge = stack.enter_context(open_edge(site_file))
    site = edge.site
    for camera in site.camera:
        words = CAMERA.format(
            site=site.name, camera=camera.id, endpoint=site.link.endpoint, source=camera.source
        )
        camera_file = site_file.with_name(f"{camera.id}.toml")
        camera_file.write_text(words)
        stack.enter_context(open_camera(camera_file))
    return edge


def main(slots: int = 40) -> None:
    """Run a site until so many slots were computed, and print how it is."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        recording = simulate(SceneSettings(people=2, seconds=4, fps=12.5, cameras=3), seed=1)
        edge = run(write_recorded(Path(name) / "site", recording), stack)
        while edge.running() and edge.status().slot < slots:
            time.sleep(0.1)
        status = edge.status()
        online = sum(camera.online for camera in status.cameras)
        print(f"slot {status.slot}: {online} cameras online, {status.people} people")


if __name__ == "__main__":
    main()
