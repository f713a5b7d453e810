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
from e3pose.recording import save_recording
from e3pose.settings.camera_file import NodeTable
from e3pose.settings.energy import EnergySettings
from e3pose.settings.loop import LoopSettings
from e3pose.settings.resolved import ResolvedSite
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.example import write_recorded

GIVEN = {"--site": "lab", "--name": "cam0", "--source": "recorded:rec"}
FILE = 'format = "e3pose-camera"\nversion = 1\nsite = "lab"\ncamera = "cam0"\nsource = "{source}"\n'
WRONG = [
    ("--pace", "7", "expected 0.001 to 1"),
    ("--begin-s", "-1", "expected 0 to"),
    ("--fps", "0", "expected 0.1 to 1000"),
    ("--threads", "0", "expected 1 to 1024"),
    ("--wake-s", "-1", "expected 0 to 3600"),
    ("--battery-wh", "0", "expected 0.001 to"),
    ("--meter", "guess", "expected 'auto' or 'model'"),
    ("--endpoint", "udp/x:1", "expected tls/HOST:PORT"),
    ("--endpoint", "tls/edge:7447", "tls without certificates"),
    ("--site", "../x", "expected 1 to 64 letters"),
    ("--name", "../x", "expected 1 to 64 letters"),
    ("--name", "cam9", "is not in the rig"),
    ("--source", "usb:x", "expected usb:by-id/NAME"),
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    save_recording(simulate(SceneSettings(people=1, seconds=0.2, cameras=2), seed=0), Path("rec"))
    return tmp_path


@pytest.mark.parametrize(("option", "value", "message"), WRONG)
def test_option_is_named_as_typed(
    option: str, value: str, message: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [word for pair in ({**GIVEN, option: value}).items() for word in pair]
    assert run("camera", *words) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"e3pose: {option}") and err.count(option) == 1, err
    assert message in err and err.count("\n") == 1, err


def test_pace_of_a_camera_that_films_is_reported_where_it_was_written(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "camera.toml"
    path.write_text(FILE.format(source="usb:0"))
    assert run("camera", path, "--pace", "0.5") == 2
    assert capsys.readouterr().err.startswith("e3pose: --pace: found 0.5, expected 1")
    path.write_text(FILE.format(source="usb:0") + "pace = 0.5\n")
    assert run("camera", path) == 2
    assert capsys.readouterr().err.startswith(f"e3pose: {path}: pace: found 0.5, expected 1")


def test_key_of_the_file_is_not_blamed_on_an_option(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "camera.toml"
    path.write_text(FILE.format(source="recorded:rec") + "wake_s = -1\n")
    assert run("camera", path, "--pace", "1") == 2
    assert capsys.readouterr().err.startswith(f"e3pose: {path}: wake_s: found -1")
    assert run("camera", folder) == 2
    err = capsys.readouterr().err
    assert err.count(str(folder)) == 1 and "found a folder" in err, err


def test_key_of_a_site_is_not_called_an_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_recorded(
        tmp_path, simulate(SceneSettings(people=1, seconds=0.2, cameras=2), seed=0)
    )
    path.write_text(path.read_text() + '\n[energy]\nbattery_wh = "50,cam9=1"\n')
    assert run("check", path) == 2
    err = capsys.readouterr().err
    assert f"{path}: energy.battery_wh: found camera 'cam9'" in err and "--" not in err, err


@each_case(
    ("delay", "message"),
    [("5s", "expected 0 to 2000"), ("soon", "expected"), ("-200ms", "expected")],
)
def test_delay_of_an_edge_is_named_as_typed(
    delay: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_recorded(
        tmp_path, simulate(SceneSettings(people=1, seconds=0.2, cameras=2), seed=0)
    )
    for verb in ("edge", "up"):
        assert run(verb, path, f"--delay={delay}") == 2
        err = capsys.readouterr().err
        assert err.startswith("e3pose: --delay: found") and message in err, err
        assert err.count("\n") == 1, err


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


def test_defaults_are_those_of_the_settings() -> None:
    made: Any = LoopOptions()
    assert (made.lead, made.warmup, made.round_trip_ms) == (1, 10, 50.0)
    assert (made.fill, made.predictor, made.feedback) == (None, None, False)
    assert EnergyOptions().profile == "xavier-nx"  # type: ignore[attr-defined]
