"""The example files of a live site are ones, and the page explains every key with its default."""

from __future__ import annotations

import json
import re
from dataclasses import fields as dataclass_fields
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.errors import InputError
from e3pose.base.quantities import age_s, size_bytes
from e3pose.base.table import entries
from e3pose.model.camera import Rig
from e3pose.model.rigs import ring_rig
from e3pose.recording.calibration import save_rig
from e3pose.settings.camera_file import NodeTable, load_node
from e3pose.settings.events_table import EventsTable
from e3pose.settings.resolved import resolve_site
from e3pose.settings.site_file import (
    CameraTable,
    LinkTable,
    RecordTable,
    SiteTable,
    StoreTable,
    ViewTable,
    ZoneTable,
    load_site,
)
from e3pose.simulate import SceneSettings
from e3pose.site.edge_program import check_edge
from e3pose.site.example import make_example
from e3pose.wire.endpoint import read_host_port

ROOT = Path(__file__).parent.parent
EXAMPLES = ROOT / "examples"
TEXT = (ROOT / "docs" / "reference" / "site-file.md").read_text()


def test_example_site_makes_a_pipeline(tmp_path: Path) -> None:
    (tmp_path / "site.toml").write_text((EXAMPLES / "site.toml").read_text())
    three = ring_rig(3, 4.0, 2.0, (640, 480), np.random.default_rng(0))
    cameras = [replace(c, camera_id=f"cam{n}") for n, c in enumerate(three.cameras, 1)]
    rig = Rig(tuple(cameras))
    save_rig(rig, tmp_path / "rig.toml")
    site = resolve_site(tmp_path)
    assert set(site.cameras) == {"cam1", "cam2", "cam3"}
    pipeline = check_edge(site).pipeline
    assert len(pipeline.queue.budget) == 3 and pipeline.interval_s == pytest.approx(0.04)


def test_example_camera_is_of_the_example_site() -> None:
    node, site = load_node(EXAMPLES / "camera.toml"), load_site(EXAMPLES / "site.toml")
    assert node.site == site.name and node.camera in {camera.id for camera in site.camera}
    assert node.endpoint.port == site.link.endpoint.port


@each_case(
    "table",
    [
        SiteTable,
        LinkTable,
        StoreTable,
        RecordTable,
        ViewTable,
        ZoneTable,
        EventsTable,
        CameraTable,
        NodeTable,
    ],
)
def test_page_explains_every_key_and_its_default(table: Any) -> None:
    (text,) = re.findall(rf"<!-- {table.__name__} -->\n(.*?)\n\n", TEXT, re.S)
    rows = dict(re.findall(r"^\| `(\w+)` \|\s*([^|]*?)\s*\|", text, re.M))
    defaults: dict[str, Any] = {field.name: field.default for field in dataclass_fields(table)}
    fields = {item.key: (item, defaults.get(item.field)) for item in entries(table)}
    parts = {"link", "store", "record", "view", "loop", "energy", "zone", "events", "camera"}
    tables = parts if table is SiteTable else set()
    assert set(rows) == set(fields) - tables - {"format", "version"}
    for name, cell in rows.items():
        item, default = fields[name]
        if item.required:
            assert cell == "required", name
        elif default is None or default in ((), ""):
            assert cell == "", name
        else:
            shown = str(default).lower() if isinstance(default, bool) else f"{default}"
            if item.read is size_bytes:
                shown = f"{default // 10**6}MB"
            if isinstance(default, tuple):
                shown = json.dumps(list(default))
            if item.read is read_host_port:
                shown = default.place
            if item.read is age_s:
                shown = f"{default / 86400:g}d"
            assert cell in (f"`{shown}`", f"`{shown.removesuffix('.0')}`"), name


def test_example_is_made_in_a_new_folder_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = SceneSettings(people=1, seconds=1.0, fps=10, cameras=4)
    monkeypatch.setattr("e3pose.site.example.SCENE", small)
    path = make_example(tmp_path / "try")
    assert len(check_edge(resolve_site(path)).pipeline.rig) == 4
    (tmp_path / "try" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=r"try: is there already, expected a new folder"):
        make_example(tmp_path / "try")
    assert (tmp_path / "try" / "mine.txt").exists()
