"""The commands in the pages do what the pages say: those that can run here run, literally.

`RUNS` are run in a folder with a recording, a store and what else they name. Those like `NOT_HERE`
run in another test, or cannot run, each with its reason; `test_docs`
parses these too. A command that is new in a page and like none of them fails.
"""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from tests.calibrate.people_scenes import walk
from tests.cases import each_case
from tests.cli.commands import run
from tests.distributions import ROOT
from tests.test_docs import BY_PAGE, commands_of

from e3pose.calibrate.recordings import between
from e3pose.recording import save_recording
from e3pose.recording.calibration import save_rig
from e3pose.site.example import write_recorded

pytestmark = pytest.mark.slow

# Commands of measurements repeat these with other words, for minutes to hours.
MEASUREMENTS = "docs/research/"
FOUR_CAMERAS = "docs/tutorial/four-cameras.md"  # tests/live/test_four_cameras.py runs all of it
MADE_ANEW = {"simulate walk": "walk", "keys init": "keys", "store copy site.toml": "backup.db"}
BEFORE = {"keys add cam1 --again": "keys add cam1", "keys revoke cam1": "keys add cam1"}

RUNS = (
    "--help",
    "--version",
    "calibrate align walk room.toml --origin cam1 --x-axis cam2",
    "calibrate align yup.toml room.toml --up=y",
    "calibrate board --paper a3",
    "calibrate check walk --picture error.png",
    "calibrate extrinsics walk rig.toml --height 178cm --update",
    "calibrate noise my-recording --out my-noise.toml --plot my-noise.svg",
    "evaluate walk --policies round-robin,information --cameras 1,2 --lead 4 --seeds 2",
    "export live.db angles.csv --angles --track 1",
    "export live.db archive.parquet --layout archive",
    "export live.db last.parquet --what poses --from -10min",
    "export live.db selections.csv --what slots",
    "export live.db walk.c3d --smooth butterworth --cutoff 6Hz",
    "export live.db walk.mot --track 1 --smooth rts --fill 200ms",
    "export live.db walk.trc --track 1 --smooth rts --fill 200ms --names pose2sim",
    "export poses.parquet walk.glb",
    "info walk",
    "keys add cam1",
    "keys add cam1 --again",
    "keys add desk --operator",
    "keys add hall --router --host hall.local",
    "keys add wall --viewer",
    "keys init lab --host edge.local --host 192.168.1.10",
    "keys list",
    "keys renew",
    "keys revoke cam1",
    "models list",
    "power",
    "power modes xavier-nx",
    "query live.db --from 10 --to 20 --track 2 --joint left_wrist",
    "query site.toml --what events",
    "query try --from -10s",
    "query try --what slots --from -5s",
    "replay my-recording --pipeline memory --noise my-noise.toml",
    "replay walk --cameras 2",
    "replay walk --cameras all --smooth rts --poses poses.parquet --report walk.html",
    "replay walk --pipeline paper --report paper.html",
    "replay walk --lifetime 6h --battery-wh 50,cam1=60",
    "replay walk --rest asleep --watts 40W",
    "replay walk --store live.db",
    "replay stills --pipeline paper --matcher rays --policy all --predictor zero-velocity "
    "--poses poses.parquet",
    "replay walk --policy examples/02_own_policy.py:PlainView",
    "replay walk --policy round-robin --cameras 1 --hold-out cam2",
    "replay walk --policy mine:PlainView",
    "replay walk --target-error 40mm",
    "simulate walk --scene one-sided --seconds 12 --seed 7",
    "store copy backup.db poses.db",
    "store copy site.toml backup.db",
    "sync walk walk-in-step",
)

# Patterns of commands that do not run here, and where they do, or why they cannot.
FILMS = "needs films of people and a network that is downloaded"
DATA = "needs a data set that the project does not ship"
TRAINS = "trains for minutes with torch; tests/lab/train trains for seconds"
LIVE = "asks a site that runs; tests/live/test_four_cameras.py runs the same with its site"
NOT_HERE = {
    r"reconstruct |detect |replay walk --feedback|.*all\+feedback": FILMS,
    r"import |.*\b(shelf|cmu)\b|reproduce ": DATA,
    r"train |learn |replay .*\.onnx": TRAINS,
    r"(edge|camera|router|up|top|view|stream|setup|check|init|record|events)\b": "tests/live",
    r"(archive|people) ": "tests/output/archive, tests/store/test_people.py",
    r"hub |keys add house|keys init house|keys add desk --viewer": "tests/hub",
    r"keys join": "tests/live/test_outside.py",
    r"export (room|live\.db walk\.trc --from)|replay recordings/2026": LIVE,
    r"each ": "tests/lab/test_each.py",
    r"evaluate walk .*--hold-out each": "tests/evaluate/test_held_out.py",
    r"evaluate (my-recording|demo-output)": "another of `evaluate` runs, in a quarter of the time",
    r"replay walk (--cameras (1 --smooth|2 --report)|--report)": "another of `replay` runs",
    r"export live\.db walk\.trc --smooth rts --fill 200ms$": "another of `export` runs",
    r"query (try|demo-output/site)/live\.db": "another of `query` runs, of a site",
    r"calibrate align rig|calibrate (ex|in)trinsics (cam1|room)|sync cam1": "tests/calibrate",
    r"calibrate extrinsics reconstruction": "tests/cli/test_calibrating_rigs.py, with --only",
    r"simulate (films|my-)": "takes a minute; tests/live draws films of one person",
    r"models (bench|pull|path)": "tests/cli/test_models.py; needs a network that is downloaded",
    r"power (plan|--watch|measure)": "tests/energy/test_modes.py, tests/cli/test_metering.py",
    r"demo$": "tests/cli/test_demonstrating.py",
    r"attach ": "tests/edge/test_recorder.py",
    r"store copy .*postgresql": "needs a PostgreSQL server",
    r"--install-completion": "writes to the start-up file of the shell",
}


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with what the commands of the pages take for granted, all of it small."""
    top = tmp_path_factory.mktemp("stock")
    recording = replace(walk(761, seconds=4.0, fps=15.0), name="example")
    save_recording(recording, top / "walk")
    short = between(recording, 0, 24)
    for name in ("my-recording", "shelf", "clip", "stills"):
        save_recording(short, top / name)
    save_rig(recording.rig, top / "yup.toml")
    save_rig(recording.rig, top / "room" / "rig.toml")
    write_recorded(top / "try", short)
    shutil.copytree(ROOT / "examples", top / "examples")
    shutil.copy(top / "examples" / "02_own_policy.py", top / "mine.py")
    shutil.copy(ROOT / "src/e3pose/model/noises/simulated.toml", top / "my-noise.toml")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(top)
        words = ("--store", "live.db", "--poses", "poses.parquet")
        assert run("replay", "shelf", "--cameras", 2, *words) == 0
        assert run("keys", "init", "lab", "--host", "localhost") == 0
    shutil.copy(top / "live.db", top / "try")
    shutil.copy(top / "try" / "site.toml", top)
    shutil.copy(top / "live.db", top / "backup.db")
    yield top


@each_case("command", RUNS)
def test_command_of_a_page_runs(
    command: str,
    stock: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "here"
    shutil.copytree(stock, folder)
    for made in MADE_ANEW:
        if command.startswith(made):
            gone = folder / MADE_ANEW[made]
            shutil.rmtree(gone) if gone.is_dir() else gone.unlink()
    monkeypatch.chdir(folder)
    if command in BEFORE:
        assert run(*shlex.split(BEFORE[command])) == 0
    capfd.readouterr()
    code = run(*shlex.split(command))
    said = capfd.readouterr()
    assert code == 0, said.err
    assert said.out, "nothing was printed"


def test_every_command_of_a_page_runs_somewhere_or_says_why_not() -> None:
    pages = {
        command: page
        for page, text in BY_PAGE.items()
        if not page.startswith(MEASUREMENTS) and page != FOUR_CAMERAS
        for command in commands_of(text)
    }
    said = {each: [why for why in NOT_HERE if re.match(why, each)] for each in pages}
    new = {each: page for each, page in pages.items() if each not in RUNS and not said[each]}
    assert not new, f"run them in RUNS, or say why not: {new}"
    everywhere = {command for text in BY_PAGE.values() for command in commands_of(text)}
    assert not {*RUNS} - everywhere, "no page has these any more"
    used = {why for whys in said.values() for why in whys}
    assert not {*NOT_HERE} - used, "no command of a page is like these any more"
