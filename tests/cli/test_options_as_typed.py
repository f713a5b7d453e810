"""Options are made of the fields of settings, and errors name them as they were typed."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import pytest
from cyclopts import Parameter
from tests.cases import each_case
from tests.cli.commands import run

from e3pose.base.errors import InputError
from e3pose.cli.options import EnergyOptions, LoopOptions
from e3pose.cli.running_camera import CameraOptions
from e3pose.settings.camera_file import NodeTable
from e3pose.settings.energy import EnergySettings
from e3pose.settings.loop import LoopSettings
from e3pose.settings.resolved import ResolvedSite
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.example import write_recorded


def test_delay_of_an_edge_takes_the_place_of_that_of_its_site(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_recorded(
        tmp_path, simulate(SceneSettings(people=1, seconds=0.2, cameras=2), seed=0)
    )
    opened: list[float] = []

    def stop(site: ResolvedSite, *_: object) -> None:
        opened.append(site.file.smooth_delay_ms)
        raise InputError("", "enough", "")

    monkeypatch.setattr("e3pose.site.edge_program.start_edge", stop)
    assert run("edge", path, "--delay", "200ms") == 2
    assert run("edge", path) == 2
    assert opened == [200.0, 0.0]


PAIRS = [(LoopOptions, LoopSettings), (EnergyOptions, EnergySettings), (CameraOptions, NodeTable)]


@each_case(("options", "settings"), PAIRS)
def test_each_field_with_a_help_text_is_an_option(options: Any, settings: Any) -> None:
    said = [item.metadata for item in fields(settings)]
    texts = [" ".join(each["help"].split()) for each in said if "help" in each]
    helps = [
        each.help
        for item in fields(options)
        for each in get_args(item.type)
        if isinstance(each, Parameter) and each.help
    ]
    assert sorted(helps) == sorted(texts) and len(texts) == len(fields(options)) > 3


def test_camera_has_no_defaults_of_its_own_so_that_its_file_stays() -> None:
    made = CameraOptions()
    assert {getattr(made, item.name) for item in fields(made)} == {None}
