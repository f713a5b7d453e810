"""Options are made of the fields of settings: one for each with a help text, and nothing twice."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, get_args

from cyclopts import Parameter
from tests.cases import each_case

from e3pose.cli.options import EnergyOptions, LoopOptions
from e3pose.cli.running_camera import CameraOptions
from e3pose.settings.camera_file import NodeTable
from e3pose.settings.energy import EnergySettings
from e3pose.settings.loop import LoopSettings

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


def test_defaults_are_those_of_the_settings() -> None:
    made: Any = LoopOptions()
    assert (made.lead, made.warmup, made.round_trip_ms) == (1, 10, 50.0)
    assert (made.fill, made.predictor, made.feedback) == (None, None, False)
    assert EnergyOptions().profile == "xavier-nx"  # type: ignore[attr-defined]
