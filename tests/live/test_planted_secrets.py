"""Passwords of cameras, planted, and looked for in all that a site says, writes and shows."""

from __future__ import annotations

import re
import urllib.request
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import psutil
import pytest
from tests.camera.mjpeg import network_camera
from tests.cli.commands import run
from tests.live.processes import COMPILE_S, running, small_cameras
from tests.ports import free_port
from tests.waiting import eventually

from e3pose.detectors.timing import time_detections
from e3pose.settings.site_file import load_site
from e3pose.wire.codec import encode
from e3pose.wire.site_messages import Status

PLANTED = re.compile(rb"Plant\w*")  # each password and token below
TOKENS = """format = "e3pose-view-tokens"
version = 1
read = "PlantReadG7-for-the-page-of-the-site"
write = "PlantWriteH8-for-the-page-of-the-site"
"""
ABSENT = "rtsp://admin:PlantE5@127.0.0.1:9/live?t=PlantF6"


def clean(text: str | bytes, where: object) -> str:
    """Return a text that holds no secret."""
    content = text.encode() if isinstance(text, str) else text
    assert not PLANTED.findall(content), where
    return content.decode(errors="replace")


def command_lines(program: psutil.Process) -> str:
    """Return the command lines of a program and of all that it started."""
    lines = []
    for each in (program, *program.children(recursive=True)):
        lines.append(" ".join(each.cmdline()))
    return "\n".join(lines)


def test_no_output_of_a_run_holds_a_password_of_a_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    quickly = partial(time_detections, seconds=0.1)
    for module in ("cli.starting", "site.detector_speed"):
        monkeypatch.setattr(f"e3pose.{module}.time_detections", quickly)
    small_cameras(tmp_path, (4, 0), (0, 4), (-4, 0))
    room = tmp_path / "room"
    with ExitStack() as stack:
        first, second, third = (stack.enter_context(network_camera(12.5)) for _ in range(3))
        first = first.replace("://", "://admin:PlantA1@").replace("stream", "0/user:PlantB2/s")
        second = second.replace("stream", "user=admin&password=PlantC3&channel=1&s")
        given = [f"c0={first}", f"c1={second}?token=PlantD4", f"c2={third}"]
        options = ("--detector", "eyes.py:Eyes", "--calibration", "calib.toml")
        assert run("init", room, *given, *options) == 0
        said = capsys.readouterr()
        assert "admin:***@" in clean(said.out + said.err, "init")
        path = room / "site.toml"
        clean(text := path.read_text(), path)
        assert 'source = "secret:secrets/c0"' in text
        for camera_id, secret in (("c0", "PlantB2"), ("c1", "PlantD4")):
            file = room / "secrets" / camera_id
            assert secret in file.read_text() and file.stat().st_mode & 0o777 == 0o600

        # One of before, whose file has it; its camera does not answer.
        text = text.replace(third, ABSENT)
        endpoint, metrics = f"tcp/127.0.0.1:{free_port()}", free_port()
        text = text.replace(str(load_site(room).link.endpoint), endpoint)
        view = f'[view]\nlisten = "127.0.0.1:{free_port()}"\n[link]'
        text = text.replace("[link]", view).replace("fps =", f"metrics_port = {metrics}\nfps =", 1)
        path.write_text(text)
        path.chmod(0o644)
        tokens = room / "view-tokens.toml"
        tokens.write_text(TOKENS)
        run("check", room)
        said = capsys.readouterr()
        found = " ".join(clean(said.out + said.err, "check").split())
        assert "its password is in" in found and "chmod 600" in found and "secret:FILE" in found

        statuses, log_of_up = list[Status](), tmp_path / "up.log"
        with running(room, log_of_up, "--view", heard=statuses.append) as (up, _):
            program = psutil.Process(up.pid)
            assert eventually(lambda: statuses and statuses[-1].slot > 10, COMPILE_S)
            lines = clean(command_lines(program), "ps")
            assert "secret:" in lines and "env:E3POSE_SOURCE" in lines
            log = room / "logs" / "c2.log"
            assert eventually(lambda: "127.0.0.1:9" in log.read_text(), 60), log.read_text()
            assert eventually(lambda: "#token=" in log_of_up.read_text(), 60)
            page = re.search(r"(http://\S+?)/?#token=(\S+)", log_of_up.read_text())
            assert page is not None and page[2].startswith("PlantWriteH8")
            for url in (f"http://127.0.0.1:{metrics}/metrics", f"{page[1]}/api/status"):
                asked = urllib.request.Request(url, headers={"Authorization": f"Bearer {page[2]}"})
                clean(urllib.request.urlopen(asked, timeout=10).read(), url)
        for status in statuses:
            clean(encode(status), "wire")
        path.write_text(text.replace(ABSENT, third.replace("://", "://admin:PlantI9@")))
        assert run("record", room, "walk", "--for", "1") == 0
    log_of_up.write_text(log_of_up.read_text().replace(page[2], ""))  # whom it is printed for
    for command in (
        ("export", room, "page.html"),
        ("export", room, "slots.parquet", "--what", "slots"),
        ("query", room, "--what", "summaries", "--json", "minutes.json"),
        ("query", room, "--what", "runs", "--json", "runs.json"),
        ("archive", room, "archive"),
        ("replay", "walk", "--cameras", "2", "--json", "summary.json"),
        ("top", room, "--once"),
    ):
        run(*command)
    private = {*(room / "secrets").iterdir(), path, tokens}
    scanned = [each for each in tmp_path.rglob("*") if each.is_file() and each not in private]
    logs = {f"{name}.log" for name in ("c0", "c2", "edge", "view", "up")}
    made = {"page.html", "slots.parquet", "minutes.json", "runs.json", "summary.json", "live.db"}
    assert logs | made | {"recording.toml"} <= {f.name for f in scanned}
    for file in scanned:
        clean(file.read_bytes(), file)
    said = capsys.readouterr()
    clean(said.out + said.err, "export")
