"""Every program that runs on ends with the codes of `Exit`, each with its one meaning."""

from __future__ import annotations

import datetime
import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from tests.cases import each_case
from tests.cli.commands import run
from tests.ports import free_port
from tests.site.test_channels import limit

import e3pose.cli.running_site as running_site
from e3pose.base.errors import Exit, Fault, GaveUp, InputError, exit_code
from e3pose.camera import live
from e3pose.camera.live import CameraNode
from e3pose.camera.live_source import PacedSource, StreamSource
from e3pose.camera.source import open_video
from e3pose.edge.server import EdgeServer
from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.site import ready, record_program, up
from e3pose.site.admission import Admission
from e3pose.site.example import write_recorded
from e3pose.site.router_program import Router
from e3pose.site.serving import Serving
from e3pose.site.up import Program
from e3pose.wire.keys.folder import add_keys, init_keys

pytestmark = pytest.mark.slow

Patch = pytest.MonkeyPatch
FULL = OSError(errno.ENOSPC, "No space left on device")
DOCS = Path(__file__).parents[2] / "docs" / "reference" / "faults.md"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two sites and the keys of a router."""
    folder = tmp_path_factory.mktemp("codes")
    recording = simulate(SceneSettings(people=1, seconds=0.4, cameras=2), seed=0)
    save_recording(recording, folder / "rec")
    for name in ("site", "other"):
        path = write_recorded(folder / name, recording)
        text = path.read_text().replace('name = "example"', f'name = "{name}"')
        path.write_text(re.sub(r"(tcp/127\.0\.0\.1):\d+", rf"\1:{free_port()}", text))
    now = datetime.datetime.now(datetime.timezone.utc)
    init_keys(folder / "keys", "site", [], now)
    add_keys(folder / "keys", "hall", now, kind="router")
    return folder


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """Give signals back, which a program that was told to end keeps."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def words(program: str, place: Path, site: str = "site") -> list[object]:
    """Return a command of a program that ends by itself, or is told to end after a moment."""
    port = free_port()
    commands: dict[str, list[object]] = {
        "edge": ["edge", place / site, "--for", "0.2"],
        "two edges": ["edge", place / site, place / f"{site}-too", "--for", "0.2"],
        "camera": [
            "camera", "--site", "site", "--name", "cam0", "--source", f"recorded:{place / site}",
            "--endpoint", f"tcp/127.0.0.1:{port}", "--meter", "model",
        ],
        "router": [
            "router", place / site, "--edge", "tls/localhost:1", "--endpoint",
            f"tls/127.0.0.1:{port}", "--for", "0.2",
        ],
        "view": ["view", place / site, "--listen", "127.0.0.1:0", "--for", "0.2"],
        "record": ["record", place / site, place / "walk", "--for", "0.2"],
        "up": ["up", place / site, "--for", "0.2", "--quiet"],
        "cameras": ["cameras", place / site],
        "stream": ["stream", place / site, "osc://127.0.0.1:9", "--for", "0.1"],
        "setup": ["setup", place / site, "--listen", "0.0.0.0:0"],
        "hub run": ["hub", "run", place / site],
        "hub view": ["hub", "view", place / site],
    }  # fmt: skip
    return commands[program]


PROGRAMS = (
    "edge", "two edges", "camera", "router", "view", "record", "up", "stream", "setup", "hub run",
    "hub view",
)  # fmt: skip


@each_case("program", PROGRAMS)
def test_input_that_is_refused_before_anything_ran(program: str, place: Path) -> None:
    assert run(*words(program, place, "none")) == Exit.REFUSED


def told_to_end(after_s: float) -> None:
    threading.Timer(after_s, lambda: os.kill(os.getpid(), signal.SIGTERM)).start()


def good(program: str, place: Path) -> list[object]:
    site = {"camera": "rec", "router": "keys/routers/hall"}.get(program, "site")
    said = words(program, place, site)
    if program == "two edges":
        said[2] = place / "other"
    return said


@each_case("program", ("edge", "two edges", "camera", "router", "view"))
def test_program_that_was_told_to_end(program: str, place: Path) -> None:
    if program == "camera":
        told_to_end(1.5)
    assert run(*good(program, place)) == Exit.DONE


def fails(*_: object) -> None:
    raise FULL


def never(*_: object) -> None:
    """Never answer."""
    threading.Event().wait(60.0)


def breaks(program: str) -> list[tuple[object, str, object]]:
    """Return what to replace so that a program fails while it runs."""
    at_once = (live, "STUCK_S", 0.5)
    return {
        "edge": [(Admission, "update", fails)],
        "edge, a thread": [(EdgeServer, "_run_slots", fails)],
        "camera": [(CameraNode, "_run_capture", fails)],
        "camera, a source": [(PacedSource, "read", never), at_once],
        "cameras, a source": [(PacedSource, "open", never), at_once],
        "router": [(Router, "update", fails)],
        "view": [(Serving, "running", lambda self: False)],
        "up": [(running_site, "run_shown", lambda *_: 1 // 0)],
    }[program]  # type: ignore[return-value]


@each_case(
    "program",
    ("edge", "edge, a thread", "camera", "camera, a source", "cameras, a source", "router")
    + ("view", "up"),
)
def test_fault_while_it_runs_is_no_refused_input(
    program: str, place: Path, monkeypatch: Patch, capsys: pytest.CaptureFixture[str]
) -> None:
    for target, name, instead in breaks(program):
        monkeypatch.setattr(target, name, instead)
    command = good(program.partition(",")[0], place)
    assert run(*command) == Exit.FAULT
    said = capsys.readouterr().err
    assert ("Traceback" in said) == (program == "up")  # a fault of ours is shown whole
    last = said.splitlines()[-1]
    assert last.startswith("e3pose: ")
    assert ("a source" in program) == ("camera cam0: the source has not answered for" in last)


@each_case(
    ("program", "code"),
    [("view", Exit.FAULT), ("record", Exit.FAULT)]
    + [(each, Exit.DONE) for each in ("edge", "two edges", "camera", "router", "up")],
)
def test_disk_that_is_full_from_the_start_is_no_refused_input(
    program: str, code: Exit, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What runs without its files runs; what cannot is started again by systemd."""
    if program == "camera":
        told_to_end(1.5)
    (place / "site" / "view-tokens.toml").unlink(missing_ok=True)
    shutil.rmtree(place / "walk.partial", ignore_errors=True)
    with limit(place):
        assert run(*good(program, place)) == code
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert code == Exit.DONE or said.endswith("cannot be written: file too large\n"), said


def child(folder: Path, name: str, code: int, *, ran_s: float = 0.0) -> Program:
    """Return a program of a site that ends with a code after a time, whenever it is started."""
    text = f"import time; print('last words'); time.sleep({ran_s}); raise SystemExit({code})"
    return Program(name, [sys.executable, "-S", "-c", text], folder / f"{name}.log")


def of_children(monkeypatch: Patch, *programs: Program) -> None:
    monkeypatch.setattr(ready, "site_programs", lambda *_args, **_more: list(programs))


def test_up_ends_with_the_code_of_what_its_programs_do(
    place: Path, tmp_path: Path, monkeypatch: Patch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(up, "RESTART_S", 0.01)
    site = [*words("up", place)[:2], "--for", "20", "--quiet"]
    of_children(monkeypatch, child(tmp_path, "edge", Exit.REFUSED))
    assert run(*site) == Exit.REFUSED
    assert capsys.readouterr().err == "e3pose: edge: last words\n"
    of_children(monkeypatch, child(tmp_path, "edge", Exit.FAULT))
    assert run(*site) == Exit.GAVE_UP
    said, times = capsys.readouterr().err, up.MOST_RESTARTS + 1
    assert f"edge: last words (ended {times} times, the last with code 4)" in said
    monkeypatch.setattr(up, "STEADY_S", 0.1)  # one that worked is never given up
    works = child(tmp_path, "edge", Exit.REFUSED, ran_s=0.3)
    of_children(monkeypatch, works)
    assert run(*site[:2], "--for", "4", "--quiet") == Exit.DONE and works.restarts > 2


def test_record_gives_up_on_a_camera_that_never_works(
    place: Path, tmp_path: Path, monkeypatch: Patch
) -> None:
    monkeypatch.setattr(up, "RESTART_S", 0.01)

    def camera(_site: object, camera_id: str, _logs: Path) -> Program:
        return child(tmp_path, camera_id, Exit.FAULT)

    monkeypatch.setattr(record_program, "camera_program", camera)
    assert run("record", place / "site", tmp_path / "walk", "--for", "20") == Exit.GAVE_UP


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_up_that_is_told_to_end_is_done(
    number: signal.Signals, place: Path, tmp_path: Path, monkeypatch: Patch
) -> None:
    of_children(monkeypatch, child(tmp_path, "edge", 0, ran_s=60.0))
    threading.Timer(1.0, lambda: os.kill(os.getpid(), number)).start()
    assert run("up", place / "site", "--quiet") == Exit.DONE


def test_work_that_a_signal_cuts_off_has_the_signals_code(place: Path) -> None:
    told_to_end(1.0)
    assert run("check", place / "site", "--timeout", "60") == Exit.SIGNAL + signal.SIGTERM


@each_case(
    ("error", "code"),
    [
        (InputError("x"), Exit.REFUSED),
        (PermissionError(errno.EACCES, "denied", "x"), Exit.REFUSED),
        (FULL, Exit.FAULT),
        (Fault("x"), Exit.FAULT),
        (GaveUp("x"), Exit.GAVE_UP),
        (ZeroDivisionError(), Exit.FAULT),
        (KeyboardInterrupt(), 130),
        (KeyboardInterrupt(15), 143),
    ],
)
def test_code_of_an_error(error: BaseException, code: int) -> None:
    assert exit_code(error) == code


def test_refusal_that_a_full_disk_caused_is_a_fault() -> None:
    def told() -> None:
        try:
            raise FULL
        except OSError:
            raise InputError("walk: cannot be written") from None

    with pytest.raises(InputError) as caught:
        told()
    assert exit_code(caught.value) == Exit.FAULT


@each_case("program", ("hub run", "hub view"))
def test_database_that_cannot_grow_is_a_fault(
    program: str, place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site = '[[site]]\nname = "lab"\nendpoint = "tcp/127.0.0.1:1"\n'
    text = f'format = "e3pose-hub"\nversion = 1\n[view]\nlisten = "127.0.0.1:0"\n{site}'
    (tmp_path / "hub.toml").write_text(text)
    with limit(place):
        assert run(*program.split(), tmp_path) == Exit.FAULT
    assert "hub.db: cannot be used (disk I/O error)" in capsys.readouterr().err


def test_film_that_ffmpeg_cannot_read_is_no_fault_of_the_machine(
    tmp_path: Path, monkeypatch: Patch
) -> None:
    """Its errors are those of the system by name and number, be the disk ever so well."""
    av = pytest.importorskip("av")

    def broken(*_args: object, **_more: object) -> None:
        av.error.err_check(-errno.EIO)

    monkeypatch.setattr(av, "open", broken)
    (tmp_path / "a.mp4").write_bytes(b"a film")
    for opened in (partial(open_video, tmp_path / "a.mp4"), StreamSource("rtsp://x", None).open):  # type: ignore[arg-type]
        with pytest.raises(InputError, match=r"(?i)input/output error") as caught:
            opened()
        assert exit_code(caught.value) == Exit.REFUSED


def closed(*numbers: int) -> Callable[[], None]:
    """Return what closes descriptors of a child before its program begins."""

    def close() -> None:
        for number in numbers:
            os.close(number)

    return close


@each_case("numbers", [(1,), (0, 1, 2)])
def test_closed_descriptors_change_no_code(numbers: tuple[int, ...], tmp_path: Path) -> None:
    code = "from e3pose.cli.app import main; main(['info', 'none'])"
    ended = subprocess.run([sys.executable, "-c", code], preexec_fn=closed(*numbers), cwd=tmp_path)
    assert ended.returncode == Exit.REFUSED


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_full_output_is_a_fault_and_full_error_output_changes_no_code(tmp_path: Path) -> None:
    code = "from e3pose.cli.app import main; import sys; main(sys.argv[1:])"
    with Path("/dev/full").open("w") as full:
        for option, line, expected in (
            ("stdout", ["models", "list"], Exit.FAULT),
            ("stderr", ["info", "none"], Exit.REFUSED),
        ):
            command = [sys.executable, "-c", code, *line]
            ended = subprocess.run(command, cwd=tmp_path, **{option: full})  # type: ignore[call-overload]
            assert ended.returncode == expected, option


def test_page_of_faults_has_every_code() -> None:
    table = re.findall(r"^\| (\d+)\b[^|]*\| ([^|]+) \|", DOCS.read_text(), re.MULTILINE)
    assert [int(code) for code, _ in table] == list(Exit)
