from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from tests.cli.commands import run
from tests.detectors.test_networks import write_onnx
from tests.detectors.weights.conftest import site as site
from tests.detectors.weights.web import CONTENT, Site, files_in, sha256

from e3pose.base.errors import Exit
from e3pose.detectors.weights import MODELS, FromHub, FromUrl, fetch

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
    fetched, own = ({n for n, r in rows.items() if f" never {w} " in r} for w in ("fetched", "ran"))
    assert fetched | own == set(MODELS) - {"movenet-multipose", "openpose-thin"}
    assert {"rtmpose-body", "rtmw-133"} < fetched and {"rf-detr", "trt-pose"} < own
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
        (("pull", "http://127.0.0.1:9/m.onnx"), "http://127.0.0.1:9/m.onnx: could not be reached"),
        (("pull", "hf:lab/m.onnx"), "NAME: found 'hf:lab/m.onnx', expected hf:OWNER/REPO/FILE"),
        (("pull", "http://a/m.zip"), "expected a file that ends in .onnx, .tflite, .pb"),
        (("pull", "http://a/m.onnx", "--sha256", "12"), "--sha256: found '12', expected 64"),
        (("pull", "http://a/m.onnx", "--name", "../m"), "--name: found '../m', expected letters"),
        (("pull", "http://a/rtmo-s.onnx"), "--name: found rtmo-s, which is RTMO-s 640x640"),
        (("pull", "rtmo-s", "--name", "s"), "--sha256 and --name: found beside a name of the list"),
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


def test_an_address_is_pinned_by_the_first_fetch_and_checked_in_every_process(
    site: Site, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    people = np.zeros((1, 6, 56), dtype=np.float32)
    made = write_onnx(tmp_path / "m.onnx", (1, 288, 512, 3), people, kind=6).read_bytes()
    other = write_onnx(tmp_path / "m.onnx", (1, 288, 512, 3), people + 1, kind=6).read_bytes()

    def models(*words: str) -> tuple[int, str]:
        code = run("models", *words)
        said = capsys.readouterr()
        return code, said.out + said.err

    def apart(*words: str) -> tuple[int, str]:
        program = [sys.executable, "-m", "e3pose", "models", *words]
        ended = subprocess.run(program, capture_output=True, text=True, timeout=60)
        return ended.returncode, ended.stdout + ended.stderr

    def describe(content: bytes) -> dict[str, object]:
        lfs = {"sha256": sha256(content), "size": len(content)}
        files = [{"rfilename": "onnx/model.onnx", "lfs": lfs}, {"rfilename": "README.md"}]
        card = {"license": "apache-2.0"}
        return {"sha": "c0ffee", "cardData": card, "siblings": files, "more": [1]}

    api, file = (
        "/api/models/lab/Good-Net?blobs=true",
        "/lab/Good-Net/resolve/c0ffee/onnx/model.onnx",
    )
    monkeypatch.setenv("HF_ENDPOINT", site.url)
    site.pages[api], site.pages[file] = json.dumps(describe(made)).encode(), made
    code, said = models("pull", "hf:lab/Good-Net/model.onnx")
    path = cache / "weights" / "good-net" / "model.onnx"
    assert code == 0 and path.read_bytes() == made, said
    assert f"good-net: licence apache-2.0, sha256 {sha256(made)}" in said
    assert "runs as movenet-multipose: --model good-net" in said and said.endswith(f"{path}\n")
    assert models("path", "good-net") == apart("path", "good-net") == (0, f"{path}\n")
    assert "installed" in models("list")[1].partition("good-net")[2].partition("\n")[0]
    path.write_bytes(other)  # altered on the disk
    code, said = apart("path", "good-net")
    assert code == 2 and "not the published weights of good-net" in said
    path.unlink()
    site.pages[file] = other  # altered at its publisher's
    for words in (("good-net",), ("hf:lab/Good-Net/model.onnx",)):
        code, said = models("pull", *words)
        assert code == 2 and "the file was altered" in said and not path.exists()
    site.pages[file] = made
    assert models("pull", "good-net")[0] == 0 and site.asked.count(api) == 1

    url = f"{site.url}/plain.onnx"
    site.pages["/plain.onnx"] = made
    code, said = models("pull", url, "--sha256", sha256(other))
    assert code == 2 and "the file was altered" in said and "plain" not in models("list")[1]

    def cut_off(_: object, file: IO[bytes], *more: object) -> None:
        file.write(b"half")
        signal.raise_signal(signal.SIGTERM)

    with monkeypatch.context() as patch:
        patch.setattr(fetch, "save_verified", cut_off)
        before = files_in(cache)
        assert models("pull", url)[0] == Exit.SIGNAL + signal.SIGTERM
        assert files_in(cache) == before
    code, said = models("pull", url, "--sha256", sha256(made))
    assert code == 0 and f"plain: licence not stated, sha256 {sha256(made)}" in said
    code, said = models("pull", url, "--sha256", sha256(other))
    assert code == 2 and "pinned by the first fetch" in said
    site.pages["/other.onnx"] = CONTENT
    code, said = models("pull", f"{site.url}/other.onnx", "--name", "noise")
    assert code == 0 and "no detector here runs it" in said


def test_a_mirror_names_its_files_by_their_last_part(
    site: Site, cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HF_ENDPOINT", site.url)
    api = "/api/datasets/DavidPagnon/rtmlib_models?blobs=true"
    sources = [MODELS[name].source for name in ("rtmpose-halpe26", "yolox-tiny")]
    files = [f"mmpose/sdk/{one.file}" for one in sources if isinstance(one, FromHub)]
    listed = [{"rfilename": name} for name in files]
    site.pages[api] = json.dumps({"sha": "abc", "siblings": listed}).encode()
    for name in files:
        site.pages[f"/datasets/DavidPagnon/rtmlib_models/resolve/abc/{name}"] = CONTENT
    assert run("models", "pull", "rtmpose-halpe26") == 0
    assert {path.name for path in cache.rglob("*.onnx")} == {
        "rtmpose_m_halpe26.onnx", "yolox_tiny.onnx"}  # fmt: skip
    run("models", "list")
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    assert " installed" in rows["rtmpose-halpe26"] and "Apache-2.0" in rows["rtmpose-halpe26"]
    site.pages[api] = json.dumps({"sha": "abc", "siblings": [*listed, *listed]}).encode()
    assert run("models", "pull", "rtmw-133") == 2
    assert "found 0 files rtmw-dw-x-l" in capsys.readouterr().err
    site.pages[api] = b"<html>"
    assert run("models", "pull", "rtmw-133") == 2
    assert "expected the description of a repository" in capsys.readouterr().err
