from __future__ import annotations

import hashlib
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cli.commands import run

from e3pose.detectors.weights.catalogue import MODELS, FromUrl

WEIGHTS = b"weights"
MOVENET = MODELS["movenet-multipose"]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    # A port where nobody listens: the publisher that cannot be reached.
    model = replace(
        MOVENET,
        source=FromUrl("http://127.0.0.1:9/model.onnx"),
        size_bytes=len(WEIGHTS),
        sha256=hashlib.sha256(WEIGHTS).hexdigest(),
    )
    monkeypatch.setitem(MODELS, "movenet-multipose", model)
    return tmp_path / "cache"


def put(cache: Path, content: bytes) -> Path:
    path = cache / "weights" / "movenet-multipose" / MOVENET.filename
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    return path


def test_list_tells_licence_size_and_what_is_here(
    cache: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("models", "list") == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "not installed" in rows["openpose-thin"] and "7.8 MB" in rows["openpose-thin"]
    assert "Apache-2.0" in rows["movenet-multipose"]
    assert "your own file" in rows["trt-pose"] and "AGPL" in rows["yolo-pose"]
    put(cache, WEIGHTS)
    run("models", "list")
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert " installed" in rows["movenet-multipose"]
    assert "not installed" not in rows["movenet-multipose"]


def test_path_prints_only_the_file(cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = put(cache, WEIGHTS)
    assert run("models", "path", "movenet-multipose") == 0
    assert capsys.readouterr().out == f"{path}{os.linesep}"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("path", "movenet-multipose"), "run `e3pose models pull movenet-multipose`"),
        (("pull", "movenet-multipose"), "http://127.0.0.1:9/model.onnx: could not be reached"),
        (("pull", "trt-pose"), "model trt-pose: has no published weights"),
        (("pull", "nope"), "model 'nope' is unknown"),
    ],
)
def test_what_cannot_be_had_is_one_line_and_code_2(
    cache: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str
) -> None:
    assert run("models", *words) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1 and message in printed.err
    assert not [path for path in cache.rglob("*") if path.is_file()]


def test_altered_weights_are_not_handed_out(
    cache: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    put(cache, WEIGHTS[::-1])
    assert run("models", "path", "movenet-multipose") == 2
    assert "not the published weights" in capsys.readouterr().err


@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGINT])
def test_a_stopped_pull_leaves_nothing(tmp_path: Path, sign: signal.Signals) -> None:
    """A server that sends half and then waits; the pull is stopped while it waits too."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(30)
    url = f"http://127.0.0.1:{listener.getsockname()[1]}/model.onnx"
    program = f"""
from dataclasses import replace
from e3pose.cli import main
from e3pose.detectors.weights.catalogue import MODELS, FromUrl
MODELS["movenet-multipose"] = replace(MODELS["movenet-multipose"], source=FromUrl({url!r}))
main(["models", "pull", "movenet-multipose"])
"""
    folder = tmp_path / "cache" / "weights" / "movenet-multipose"
    process = subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE)
    with listener, listener.accept()[0] as connection:
        connection.recv(4096)
        head = f"HTTP/1.1 200 OK\r\nContent-Length: {MOVENET.size_bytes}\r\n\r\n"
        connection.sendall(head.encode() + bytes(1_000_000))
        deadline = time.monotonic() + 20
        while not any(path.stat().st_size for path in folder.glob(".*")):
            assert time.monotonic() < deadline, "nothing is being written"
            time.sleep(0.02)
        process.send_signal(sign)
        process.communicate(timeout=20)
    assert process.returncode == 128 + sign
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
