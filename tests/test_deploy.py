"""Units and container file: they parse, and every option they name is one of the programs."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from cyclopts import CycloptsError

from e3pose.cli.app import VERBS, app

DEPLOY = Path(__file__).parent.parent / "deploy"
UNITS = sorted(DEPLOY.glob("*.service"))
README = (DEPLOY / "README.md").read_text()
INSTRUCTIONS = {
    *("FROM", "COPY", "RUN", "ENV", "USER", "WORKDIR", "VOLUME", "EXPOSE", "STOPSIGNAL"),
    *("HEALTHCHECK", "ENTRYPOINT", "CMD"),
}


def unit(path: Path) -> dict[str, list[str]]:
    """Every setting of a unit, by `Section.Name`."""
    section = ""
    found: dict[str, list[str]] = {}
    for line in path.read_text().splitlines():
        if line.startswith("[") and line.endswith("]"):
            section = line[1:-1]
        elif line and not line.startswith("#"):
            name, equals, value = line.partition("=")
            assert equals and re.fullmatch(r"[A-Za-z]+", name), line
            found.setdefault(f"{section}.{name}", []).append(value)
    return found


def container() -> list[tuple[str, str]]:
    """Instructions of the container file with their arguments."""
    text = re.sub(r"\\\n", " ", (DEPLOY / "Containerfile").read_text())
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [(line.split()[0], line.partition(" ")[2].strip()) for line in lines]


def commands() -> list[list[str]]:
    """Every call of the program in the folder, from the verb on."""
    found = [shlex.split(unit(path)["Service.ExecStart"][0])[1:] for path in UNITS]
    instructions = dict(container())
    (health,) = re.findall(r"CMD (\[.*\])", instructions["HEALTHCHECK"])
    found += [re.findall(r'"([^"]*)"', text) for text in (health, instructions["CMD"])]
    found[len(UNITS)].pop(0)  # the health check names the program, the default command does not
    for line in re.findall(r"^.*\be3pose (?:check|models|top|camera|keys) .*$", README, re.M):
        call = re.split(r"\be3pose (?=(?:check|models|top|camera|keys) )", line)[-1]
        found.append(shlex.split(re.sub(r"[`:.,]+( .*)?$", "", call.split("`")[0].strip())))
    return found


@pytest.mark.parametrize("command", commands(), ids=" ".join)
def test_every_verb_and_option_is_one(command: list[str]) -> None:
    assert command[0] in VERBS
    tokens = [word.replace("%i", "cam1").replace("${EDGE}", "tls/edge:7447") for word in command]
    function = app.parse_args(tokens, exit_on_error=False, print_error=False)[0]
    assert callable(function)


def test_an_option_that_is_none_would_be_found() -> None:
    with pytest.raises(CycloptsError):
        app.parse_args(["edge", "site.toml", "--jsonlogs"], exit_on_error=False, print_error=False)


def test_there_are_units_and_calls_to_look_at() -> None:
    names = ["e3pose-camera@.service", "e3pose-edge.service", "e3pose-router@.service"]
    assert [path.name for path in UNITS] == names
    verbs = {command[0] for command in commands()}
    assert verbs == {"edge", "camera", "router", "top", "check", "models", "keys"}


@pytest.mark.parametrize("path", UNITS, ids=lambda path: str(path.name))
def test_unit_is_hardened_restarts_and_ends_politely(path: Path) -> None:
    said = unit(path)
    assert said["Service.User"] == ["e3pose"]
    for name in ("NoNewPrivileges", "ProtectHome", "PrivateTmp", "ProtectKernelModules"):
        assert said[f"Service.{name}"] == ["yes"]
    assert said["Service.ProtectSystem"] == ["strict"]
    assert said["Service.CapabilityBoundingSet"] == [""]
    assert said["Service.Restart"] == ["always"] and said["Unit.StartLimitIntervalSec"] == ["0"]
    assert said["Service.RestartPreventExitStatus"] == ["2"]  # a wrong file
    assert said["Service.KillSignal"] == ["SIGINT"]
    # It may only write where the program does.
    assert said["Service.WorkingDirectory"] == ["/var/lib/e3pose"]
    assert said["Service.StateDirectory"] == ["e3pose"]
    caches = [] if "router" in path.name else ["e3pose"]  # it has nothing to keep
    assert said.get("Service.CacheDirectory", []) == caches


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
@pytest.mark.parametrize("path", UNITS, ids=lambda path: str(path.name))
def test_systemd_accepts_the_unit(path: Path, tmp_path: Path) -> None:
    copy = tmp_path / path.name.replace("@", "@cam1")
    copy.write_text(path.read_text().replace("/opt/e3pose/bin/e3pose", shutil.which("true") or ""))
    done = subprocess.run(
        ["systemd-analyze", "verify", str(copy)], capture_output=True, text=True, check=False
    )
    if "Failed to" in done.stderr and "initialize" in done.stderr:
        pytest.skip("systemd-analyze does not work here")
    warnings = [line for line in done.stderr.splitlines() if copy.name in line]
    assert done.returncode == 0 and not warnings


def test_container_file_is_one_that_runs_as_nobody() -> None:
    said = container()
    assert {name for name, _ in said} <= INSTRUCTIONS
    assert said[0][0] == "FROM"
    bases = [words.split()[0] for name, words in said if name == "FROM"]
    assert all(re.fullmatch(r"python:3\.1\d-slim", base) for base in bases)
    (user,) = [words for name, words in said if name == "USER"]
    assert user == "e3pose"
    assert "STOPSIGNAL" in dict(said)  # podman and docker send SIGTERM otherwise
    for sources in (words for name, words in said if name == "COPY" and "--from" not in words):
        for source in sources.split()[:-1]:
            assert (DEPLOY.parent / source).exists(), source
