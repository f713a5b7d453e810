"""A whole site on one machine: command lines, restarts and endings, with real small programs."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.cases import each_case
from tests.rigs import looking
from tests.site.tables import resolved_site

from e3pose.base.errors import GaveUp, InputError
from e3pose.cli.app import app
from e3pose.recording.calibration import save_rig
from e3pose.site import up
from e3pose.site.up import Program, camera_command, edge_command, end, run_site, view_command

RIG = looking((4, 0), (0, 4))
FLAGS = ("--end-with-parent", "--insecure", "--pictures")


def options(command: list[str]) -> dict[str, str]:
    """Return what a command line of a camera says, by option."""
    assert command[:4] == [sys.executable, "-m", "e3pose", "camera"]
    words = [word for word in command[4:] if word not in FLAGS]
    return dict(zip(words[::2], words[1::2], strict=True))


def camera(
    tmp_path: Path, keys: str, link: str = "tcp/127.0.0.1:7001", more: str = ""
) -> list[str]:
    """Return the command line of a camera with these keys."""
    text = f'{more}\n[link]\nendpoint = "{link}"\n[[camera]]\nid = "c1"\n{keys}\n'
    return camera_command(resolved_site(tmp_path, RIG, text), "c1")


def test_edge_reads_the_site_file_and_ends_with_its_parent() -> None:
    command = edge_command(Path("lab/site.toml"))
    assert command == [
        sys.executable, "-m", "e3pose", "edge", "lab/site.toml", "--end-with-parent",
    ]  # fmt: skip
    command[3] = "view"
    assert view_command(Path("lab/site.toml")) == command


@each_case(
    ("source", "found"),
    [
        ("walk.mp4", "{folder}/walk.mp4"),
        ("recorded:walk", "recorded:{folder}/walk"),
        ("usb:0", "usb:0"),
        ("rtsp://cam.local/1", "rtsp://cam.local/1"),
        ("gstreamer:videotestsrc ! appsink", "gstreamer:videotestsrc ! appsink"),
    ],
)
def test_sources_are_beside_the_site_file(tmp_path: Path, source: str, found: str) -> None:
    command = options(camera(tmp_path, f'source = "{source}"'))
    assert command["--source"] == found.format(folder=tmp_path)
    assert (command["--site"], command["--name"]) == ("lab", "c1")


def test_options_of_a_camera_are_its_table_s(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("E3POSE_CACHE", str(tmp_path / "cache"))
    with pytest.raises(InputError, match="camera c1: source"):
        camera(tmp_path, "")
    plain = options(camera(tmp_path, 'source = "usb:0"'))
    assert plain["--meter"] == "model" and plain["--endpoint"] == "tcp/127.0.0.1:7001"
    assert plain["--detector"] == "movenet-multipose"
    assert not {"--model", "--threads", "--pace", "--battery-wh", "--keys"} & {*plain}
    table = """
        source = "usb:0"
        detector = "openpose-thin"
        model = "nets/thin.onnx"
        threads = 2
        battery_wh = 10.0
        wake_s = 1.5
        meter = "auto"
    """
    command = camera(tmp_path, table, more="pace = 0.5")
    _, bound, unused, _ = app.parse_known_args(command[3:])
    assert not unused and bound.arguments, "the program takes it"
    full = options(command)
    assert full["--model"] == str(tmp_path / "nets/thin.onnx")
    assert full["--detector"] == "openpose-thin" and full["--threads"] == "2"
    assert full["--battery-wh"] == "10.0" and full["--wake-s"] == "1.5"
    assert full["--state"] == str(tmp_path / "batteries" / "c1.json")
    assert full["--meter"] == "auto" and full["--pace"] == "0.5"


@each_case(
    ("link", "view", "allowed"),
    [
        ("tcp/127.0.0.1:7001", "", True),
        ("tls/localhost:7001", "", True),
        ("tls/0.0.0.0:7001", "", False),  # operators elsewhere could ask for them
        ("tls/127.0.0.1:7001", 'listen = "0.0.0.0:8470"', False),
        ("tls/0.0.0.0:7001", 'listen = "0.0.0.0:8470"\npictures = true', True),
        ("tcp/127.0.0.1:7001", 'proxies = ["127.0.0.1"]', False),  # which ask for anybody
        ("tcp/127.0.0.1:7001", "pictures = false", False),
    ],
)
def test_pictures_stay_on_this_machine_unless_they_are_asked_for(
    tmp_path: Path, link: str, view: str, allowed: bool
) -> None:
    command = camera(tmp_path, 'source = "usb:0"', link, f"[view]\n{view}")
    assert ("--pictures" in command) is allowed


ROTATED = "port = 0\nrotation_count = 1\n"  # as Caliscope writes it


def turned_rig(folder: Path) -> None:
    """Write Caliscope's calibration of cameras that are all turned by 90 degrees."""
    save_rig(RIG, folder / "rig.toml")
    text = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(text.replace("name = ", f"{ROTATED}name = "))


@each_case(
    ("calibration", "keys", "degrees"),
    [
        (None, "", None),
        (None, "rotation = 270", "270"),
        ("turned", "", "90"),
        ("turned", "rotation = 180", "180"),
        ("turned", "rotation = 0", None),
    ],
)
def test_camera_is_turned_as_its_table_says_or_else_the_calibration(
    tmp_path: Path, calibration: str | None, keys: str, degrees: str | None
) -> None:
    if calibration is not None:
        turned_rig(tmp_path)
    command = camera(tmp_path, f'source = "usb:0"\n{keys}')
    assert options(command).get("--rotation") == degrees
    _, bound, unused, _ = app.parse_known_args(command[3:])
    assert not unused and getattr(bound.arguments.get("options"), "rotation", None) == (
        degrees and int(degrees)
    )


@each_case("value", ["45", "-90", "90.0", '"90"', "true"])
def test_rotation_that_is_no_quarter_turn_is_named(tmp_path: Path, value: str) -> None:
    with pytest.raises(InputError, match=r"rotation: found .*, expected 0 or 90 or 180 or 270"):
        camera(tmp_path, f'source = "usb:0"\nrotation = {value}')


@each_case(
    ("listens", "found"),
    [
        ("tcp/127.0.0.1:7001", "tcp/127.0.0.1:7001"),
        ("tcp/0.0.0.0:7001", "tcp/localhost:7001"),
        ("tls/127.0.0.1:7001", "tls/localhost:7001"),
        ("tls/0.0.0.0:7001", "tls/localhost:7001"),
    ],
)
def test_cameras_find_what_listens_everywhere(tmp_path: Path, listens: str, found: str) -> None:
    command = options(camera(tmp_path, 'source = "usb:0"', listens))
    assert command["--endpoint"] == found
    keys = str(tmp_path / "keys/cameras/c1") if listens.startswith("tls") else None
    assert command.get("--keys") == keys


def program(folder: Path, name: str, text: str) -> Program:
    """Return a program that is a few lines of Python; they may write to files of its folder."""
    (folder / "logs").mkdir(exist_ok=True)
    script = folder / f"{name}.py"
    script.write_text(text)
    return Program(name, [sys.executable, "-S", str(script)], folder / "logs" / f"{name}.log")


# Waits for its parent's end, or to be interrupted.
WAITS = "import signal; signal.signal(signal.SIGINT, signal.SIG_DFL); signal.pause()\n"
# Leaves a word when it is interrupted.
POLITE = """
import pathlib, signal, sys, time
here = pathlib.Path(__file__)
def end(*_):
    here.with_suffix(".ended").write_text(str(time.monotonic()))
    sys.exit(0)
signal.signal(signal.SIGINT, end)
here.with_suffix(".ready").touch()
while True:
    time.sleep(0.01)
"""

# Fails in its first run.
ONCE = """
import pathlib, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
here = pathlib.Path(__file__).with_suffix(".ran")
print("run", flush=True)
if not here.exists():
    here.touch()
    sys.exit(7)
signal.pause()
"""
DEAF = """
import signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
print("deaf", flush=True)
while True:
    signal.pause()
"""


def stop_when(condition: Callable[[], bool], seconds: float = 30.0) -> Callable[[], bool]:
    until_s = time.monotonic() + seconds
    return lambda: condition() or time.monotonic() > until_s


def test_programs_run_until_stopped_and_cameras_end_before_the_edge(tmp_path: Path) -> None:
    programs = [program(tmp_path, name, POLITE) for name in ("edge", "cam0", "cam1")]
    ready = [tmp_path / f"{p.name}.ready" for p in programs]
    messages: list[str] = []
    run_site(programs, stop_when(lambda: all(p.exists() for p in ready)), messages.append)
    assert not messages and [p.ended() for p in programs] == [0, 0, 0]
    edge_s, *cameras_s = [float((tmp_path / f"{p.name}.ended").read_text()) for p in programs]
    assert max(cameras_s) < edge_s


def test_program_that_ends_is_started_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(up, "RESTART_S", 0.1)
    programs = [program(tmp_path, "edge", WAITS), program(tmp_path, "cam0", ONCE)]
    log, messages = programs[1].log, list[str]()
    again = stop_when(lambda: log.exists() and log.read_text().count("run") == 2)
    run_site(programs, again, messages.append)
    assert programs[1].restarts == 1 and programs[0].restarts == 0
    assert len(messages) == 1 and messages[0].startswith("cam0 ") and "7" in messages[0]
    assert log.read_text() == "run\nrun\n"  # both runs in one log


REFUSES = "import sys\nprint('loading')\nprint('e3pose: source x: found none')\nsys.exit(2)\n"
CRASHES = "print('out of luck')\nraise SystemExit(4)\n"
CAMERA, PAGE = up.Role.CAMERA, up.Role.PAGE


@pytest.mark.parametrize(
    ("others", "ends"),
    [
        ({"edge": REFUSES, "cam0": WAITS}, "edge: source x: found none"),
        ({"edge": "import sys; sys.exit(2)\n"}, "edge: "),
        (
            {"edge": CRASHES, "cam0": WAITS},
            "edge: out of luck (ended 2 times, the last with code 4)",
        ),
        ({"edge": WAITS, "cam0": REFUSES}, "cam0: source x: found none"),
        ({"edge": WAITS, "cam0": REFUSES, "cam1": CRASHES, "view": WAITS}, "cam"),
        ({"edge": WAITS, "cam0": REFUSES, "cam1": WAITS}, ""),
        ({"edge": WAITS, "cam0": WAITS, "cam1": CRASHES, "view": REFUSES}, ""),
    ],
)
def test_program_that_never_works_ends_a_site_that_needs_it(
    others: dict[str, str], ends: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {"RESTART_S": 0.01, "LONGEST_RESTART_S": 0.3, "MOST_RESTARTS": 1}.items():
        monkeypatch.setattr(up, name, value)
    programs = [program(tmp_path, *each) for each in others.items()]
    for each in programs[1:]:
        each.role = PAGE if each.name == "view" else CAMERA
    messages, bad = list[str](), [each for each in programs if others[each.name] != WAITS]
    tried = stop_when(lambda: all(each.restarts > 3 for each in bad))
    if ends:
        with pytest.raises((InputError, GaveUp)) as caught:
            run_site(programs, stop_when(lambda: False), messages.append)
        assert str(caught.value).startswith(ends)
    else:
        run_site(programs, tried, messages.append)
        assert all(each.restarts > 3 for each in bad), "tried again"
        left_out = [line for line in messages if "the others go on" in line]
        assert sorted(line.partition(":")[0] for line in left_out) == [each.name for each in bad]
    assert programs[0].ended() is not None


def test_who_does_not_listen_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(up, "END_S", 0.2)
    one = program(tmp_path, "edge", DEAF)
    one.start()
    stopped = stop_when(lambda: "deaf" in one.log.read_text())
    while not stopped():
        time.sleep(0.01)
    never = program(tmp_path, "cam0", WAITS)
    end([one, never])
    assert one.ended() == -signal.SIGKILL and never.ended() is None


def test_program_whose_log_cannot_be_opened_runs_without_one(tmp_path: Path) -> None:
    programs = [program(tmp_path, name, POLITE) for name in ("edge", "cam0")]
    (tmp_path / "logs").rmdir()
    ready = [tmp_path / f"{p.name}.ready" for p in programs]
    messages: list[str] = []
    run_site(programs, stop_when(lambda: all(p.exists() for p in ready)), messages.append)
    (said,) = messages  # for all of them
    assert said.startswith("edge runs without a log: ") and [p.ended() for p in programs] == [0, 0]


def test_pipe_that_keeps_a_program_running_ends_with_it(tmp_path: Path) -> None:
    one = program(tmp_path, "edge", "import sys; sys.stdin.buffer.read()\n")
    one.start()
    assert one.process is not None and one.ended() is None
    one.let_go()
    assert one.process.wait(30) == 0
