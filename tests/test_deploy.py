"""Units and container file: they parse, and every option they name is one of the programs."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from cyclopts import CycloptsError
from tests.cases import each_case
from tests.node_packages import installed
from tests.ports import free_port

from e3pose.base.errors import Exit
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


@each_case("command", commands(), ids=" ".join)
def test_every_verb_and_option_is_one(command: list[str]) -> None:
    assert command[0] in VERBS
    tokens = [word.replace("%i", "cam1").replace("${EDGE}", "tls/edge:7447") for word in command]
    function = app.parse_args(tokens, exit_on_error=False, print_error=False)[0]
    assert callable(function)


def test_an_option_that_is_none_would_be_found() -> None:
    with pytest.raises(CycloptsError):
        app.parse_args(["edge", "site.toml", "--jsonlogs"], exit_on_error=False, print_error=False)


def test_there_are_units_and_calls_to_look_at() -> None:
    names = ["e3pose-camera@", "e3pose-edge", "e3pose-hub@", "e3pose-router@"]
    assert [path.stem for path in UNITS] == names
    verbs = {command[0] for command in commands()}
    assert verbs == {"edge", "camera", "hub", "router", "top", "check", "models", "keys"}


@each_case("path", UNITS, ids=lambda path: str(path.name))
def test_unit_is_hardened_restarts_and_ends_politely(path: Path) -> None:
    said = unit(path)
    assert said["Service.User"] == ["e3pose"]
    for name in ("NoNewPrivileges", "ProtectHome", "PrivateTmp", "ProtectKernelModules"):
        assert said[f"Service.{name}"] == ["yes"]
    assert said["Service.ProtectSystem"] == ["strict"]
    assert said["Service.CapabilityBoundingSet"] == [""]
    assert said["Service.Restart"] == ["always"] and said["Unit.StartLimitIntervalSec"] == ["0"]
    # A wrong file; of a hub also a database server that is away, which comes back.
    final = [] if "hub" in path.name else [str(Exit.REFUSED.value)]
    assert said.get("Service.RestartPreventExitStatus", []) == final
    assert said["Service.KillSignal"] == ["SIGINT"]
    # It may only write where the program does.
    assert said["Service.WorkingDirectory"] == ["/var/lib/e3pose"]
    assert said["Service.StateDirectory"] == ["e3pose"]
    caches = [] if {"hub", "router"} & {*path.stem.strip("@").split("-")} else ["e3pose"]
    assert said.get("Service.CacheDirectory", []) == caches


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
@each_case("path", UNITS, ids=lambda path: str(path.name))
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
    assert f"--uid {user} " in dict(said[said.index(("FROM", bases[-1])) :])["RUN"]
    assert "STOPSIGNAL" in dict(said)  # podman and docker send SIGTERM otherwise
    for sources in (words for name, words in said if name == "COPY" and "--from" not in words):
        for source in sources.split()[:-1]:
            assert (DEPLOY.parent / source).exists(), source


@pytest.mark.slow
@pytest.mark.network
def test_a_linter_finds_nothing_in_the_container_file(tmp_path: Path) -> None:
    linter = installed(tmp_path, ["dockerfile-utils@0.16.3"]) / "node_modules/.bin/dockerfile-utils"
    broken = tmp_path / "Containerfile"
    broken.write_text("FORM python:3.12-slim\n")
    for path, code in ((DEPLOY / "Containerfile", 0), (broken, 1)):
        said = subprocess.run([linter, "lint", path], capture_output=True, text=True)
        assert said.returncode == code, said.stdout


def engine() -> str | None:
    """Return a program that builds images on this machine, if one works."""
    for name in filter(shutil.which, ("podman", "docker")):
        if subprocess.run([name, "info"], capture_output=True).returncode == 0:
            return name
    return None


def run(*words: object, **more: str) -> str:
    kept = {name: text for name, text in os.environ.items() if not name.startswith("PYTHON")}
    ended = subprocess.run(
        [str(word) for word in words],
        cwd=DEPLOY.parent,
        env={**kept, **more},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-3000:]
    return ended.stdout


@pytest.mark.nightly
@pytest.mark.network
def test_the_image_is_built_and_its_program_starts(tmp_path: Path) -> None:
    builds = engine()
    if builds is not None:
        run(builds, "build", "-f", "deploy/Containerfile", "-t", "e3pose-test", ".")
        assert "edge" in run(builds, "run", "--rm", "e3pose-test", "--help")
        return
    # The first stage makes all that the second copies, and needs no other root than a folder.
    stages = [number for number, (name, _) in enumerate(container()) if name == "FROM"]
    first, second = container()[stages[0] + 1 : stages[1]], dict(container()[stages[1] :])
    assert {name for name, _ in first} == {"COPY", "RUN"}
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "python").symlink_to(sys.executable)

    def here(text: str) -> str:
        return re.sub(r"(?<![\w./])/(?=opt/|src\b|var/)", f"{tmp_path}/", text)

    for name, words in first:
        if name == "COPY":
            *sources, target = here(words).split()
            Path(target).mkdir(parents=True, exist_ok=True)
            for source in sources:
                inside = "/." if (DEPLOY.parent / source).is_dir() else ""
                run("cp", "-r", f"{source}{inside}", target)
        else:
            run("sh", "-c", here(words), PATH=f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    assert second["COPY"] == "--from=build /opt/e3pose /opt/e3pose"
    (program,) = re.findall(r'"([^"]*)"', second["ENTRYPOINT"])
    path = here("/opt/e3pose/bin") + ":" + os.environ["PATH"]
    home = tmp_path / "var/lib/e3pose"
    run(program, "simulate", home / "walk", "--seconds", "1", "--cameras", "3", PATH=path)
    site, port = Path(re.findall(r'"([^"]*)"', here(second["CMD"]))[1]), free_port()
    site.write_text(
        'format = "e3pose-site"\nversion = 1\nname = "room"\nfps = 25\n'
        f'calibration = "walk/calibration.toml"\nlink = {{ endpoint = "tcp/127.0.0.1:{port}" }}\n'
    )
    assert "Ready: 0 problems" in run(program, "check", site, PATH=path)
    assert not [*tmp_path.glob("opt/e3pose/lib/*/site-packages/e3pose_*")]
