"""Every verb of a live site takes the folder of one for its site file."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cases import each_case
from tests.cli.commands import run

from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.example import write_recorded

pytestmark = pytest.mark.slow

VERBS = {
    "edge": ("--for", "0.1"),
    "up": ("--for", "0.1", "--quiet"),
    "check": ("--timeout", "0"),
    "top": ("--once", "--timeout", "0"),
    "query": ("--what", "runs"),
}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a site that ran for a moment, and so has a store."""
    folder = tmp_path_factory.mktemp("lab")
    write_recorded(folder, simulate(SceneSettings(people=2, seconds=0.4, cameras=3), seed=0), "lab")
    assert run("edge", folder / "site.toml", "--for", "0.1") == 0
    return folder


@each_case("verb", sorted(VERBS))
def test_folder_says_what_its_file_says(
    verb: str, lab: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = shutil.disk_usage(lab)  # the other programs of this machine write meanwhile
    monkeypatch.setattr(shutil, "disk_usage", lambda _: disk)
    capsys.readouterr()
    outputs = []
    for named in (lab, lab / "site.toml"):
        code = run(verb, named, *VERBS[verb])
        said = capsys.readouterr()
        outputs.append((code, said.out, said.err.count("\n")))
        if verb == "top":
            assert "the edge of site lab does not answer" in said.err
        else:
            assert code == 0, said.err
    assert outputs[0] == outputs[1]


@each_case("verb", sorted(VERBS))
def test_folder_without_a_site_file_is_one_line(
    verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(verb, tmp_path, *VERBS[verb]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and f"{tmp_path}: found a folder without site.toml" in err, err
    assert not list(tmp_path.iterdir())


def test_query_of_a_site_tells_of_that_site_alone(
    lab: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each site is a recording that was replayed into the store that both name."""
    for name, people in (("lab", 1), ("hall", 3)):
        scene = SceneSettings(people=people, seconds=0.4, cameras=3)
        save_recording(replace(simulate(scene, seed=0), name=name), lab / f"rec-{name}")
        assert run("replay", lab / f"rec-{name}", "-C", "2", "--store", lab / "live.db") == 0
    other = lab / "other.toml"
    other.write_text((lab / "site.toml").read_text().replace('name = "lab"', 'name = "hall"'))
    for what in ("runs", "tracks"):
        outputs = {}
        for named in (lab, other, lab / "live.db"):
            file = lab / f"{what}.json"
            assert run("query", named, "--what", what, "--json", file) == 0
            outputs[named] = json.loads(file.read_text())
            file.unlink()
        assert (
            0
            < len(outputs[lab])
            < len(outputs[lab]) + len(outputs[other])
            == len(outputs[lab / "live.db"])
        )
        if what == "runs":
            assert {row["site"] for row in outputs[other]} == {"hall"}
    capsys.readouterr()


@each_case("what", ["poses", "slots", "tracks", "energy", "events"])
def test_file_without_rows_has_the_names_of_its_columns(what: str, lab: Path) -> None:
    file = lab / "none.csv"
    words = ("--from", "-10min", "--to", "-9min", "--what", what)
    assert run("export", lab / "live.db", file, *words) == 0
    (header,) = file.read_text().splitlines()
    assert header.startswith("run,") and ("time" in header or what == "tracks"), header
