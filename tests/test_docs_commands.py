"""The commands in the pages do what the pages say: those that can run here run, literally.

`RUNS` are run in a folder with a recording, a store and what else they name. `ELSEWHERE` run in
another test, and `HERE_NOT` cannot run here, each with its reason. A command that is new in a page
and in none of them fails.
"""

from __future__ import annotations

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
FOUR_CAMERAS = "tests/live/test_four_cameras.py"  # runs all of its page
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
    "evaluate demo-output/recording --policies all,round-robin,e3pose --cameras 2,3",
    "evaluate walk --policies round-robin,information --cameras 1,2 --lead 4 --seeds 2",
    "export live.db angles.csv --angles --track 1",
    "export live.db archive.parquet --layout archive",
    "export live.db last.parquet --what poses --from -10min",
    "export live.db selections.csv --what slots",
    "export live.db walk.c3d --smooth butterworth --cutoff 6Hz",
    "export live.db walk.mot --track 1 --smooth rts --fill 200ms",
    "export live.db walk.trc --smooth rts --fill 200ms",
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
    "query try/live.db --from -10s",
    "query demo-output/site/live.db --what slots",
    "replay my-recording --pipeline memory --noise my-noise.toml",
    "replay walk --cameras 2",
    "replay walk --cameras all --smooth rts --poses poses.parquet --report walk.html",
    "replay walk --pipeline paper --report paper.html",
    "replay walk --lifetime 6h --battery-wh 50,cam1=60",
    "replay walk --rest asleep --watts 40W",
    "replay walk --store live.db",
    "replay stills --pipeline paper --matcher rays --policy all --predictor zero-velocity "
    "--poses poses.parquet",
    "replay walk --cameras 1 --smooth rts --poses poses.parquet --report walk.html",
    "replay walk --cameras 2 --report walk.html",
    "replay walk --policy examples/02_own_policy.py:PlainView",
    "replay walk --policy round-robin --cameras 1 --hold-out cam2",
    "replay walk --policy mine:PlainView",
    "replay walk --report walk.html",
    "replay walk --target-error 40mm",
    "simulate walk --scene one-sided --seconds 12 --seed 7",
    "store copy backup.db poses.db",
    "store copy site.toml backup.db",
    "sync walk walk-in-step",
)

ELSEWHERE = {
    "power plan --people 3 --error 40mm --battery 50Wh --picture plan.svg": (
        "tests/energy/test_modes.py"
    ),
    **dict.fromkeys(
        (
            "reconstruct cam1.mp4 cam2.mp4 cam3.mp4 --calibration calibration.toml",
            "reconstruct cam1.mp4 cam2.mp4 cam3.mp4 --calibration Calib.toml --out walk3d",
        ),
        "tests/cli/test_reconstructing.py",
    ),
    **dict.fromkeys(
        (
            "import detections SOURCE DEST --calibration rig.toml --fps 30",
            "import detections SOURCE DEST --calibration rig.toml --fps 30 --skeleton mine.toml",
        ),
        "tests/recording/detections/test_detections.py",
    ),
    "evaluate walk --policies round-robin,information --cameras 1,2 --hold-out each": (
        "tests/evaluate/test_held_out.py"
    ),
    "archive delete room --day 2026-11-25": "tests/output/archive/test_deleting.py",
    "people forget room 7 --run 3": "tests/output/archive/test_deleting.py",
    "archive room /mnt/archive": "tests/output/archive/test_archive.py",
    "archive room /mnt/archive --keep 2y": "tests/output/archive/test_archive.py",
    "archive verify /mnt/archive": "tests/output/archive/test_archive.py",
    **dict.fromkeys(
        (
            "hub query house hours --from -30d --csv hours.csv",
            "hub query house summaries --site lab --from 14:00 --json -",
            "hub query house hours --from -1d",
            "hub query house sites",
        ),
        "tests/hub/test_questions.py",
    ),
    **dict.fromkeys(
        (
            "simulate films --scene home-fall --seconds 60 --fps 12.5 --resolution 640x480 --seed 1"
            " --videos",
            "init room films/videos/cam0.mp4 films/videos/cam1.mp4 films/videos/cam2.mp4"
            " films/videos/cam3.mp4 --detector drawn --calibration films/calibration.toml",
            "stream room homeassistant://127.0.0.1:1883",
        ),
        "tests/live/test_told_page.py",
    ),
    **dict.fromkeys(
        (
            "hub grant house ada --operator --group clinics",
            "hub grant house bob --viewer --group clinics",
            "hub users house",
            "hub revoke house bob",
        ),
        "tests/hub/test_page_tokens.py",
    ),
    **dict.fromkeys(
        (
            'each results recordings/* --verb "evaluate --policies all,information" --plan',
            'each results recordings/* --verb "evaluate --policies all,information"',
            'each results recordings/* --verb "calibrate check" --cluster tcp://head.local:8786',
            'each results films/* --verb "detect --model movenet-multipose"',
        ),
        "tests/lab/test_each.py",
    ),
    **dict.fromkeys(
        (
            "edge house/lab house/hall",
            "camera --site lab --name cam0 --source recorded:house/lab/recording "
            "--endpoint tcp/127.0.0.1:7447",
        ),
        "tests/live/test_many_edges.py",
    ),
    **dict.fromkeys(
        ("up house/lab --example --for 20", "up house/hall --example --for 20"),
        "tests/live/test_programs.py",
    ),
    **dict.fromkeys(
        ("camera --join --name cam1 --source usb:0", "keys join site.toml"),
        "tests/live/test_outside.py",
    ),
    "archive deleted site.toml": "tests/hub/test_forgotten.py",
    "hub forgotten house": "tests/hub/test_forgotten.py",
    "hub view house": "tests/live/test_hub_page.py",
    "hub accesses house --site lab": "tests/hub/test_questions.py",
    "hub run house": "tests/hub/test_hub.py",
    "keys add house --hub --keys lab/keys": "tests/hub/test_hub.py",
    "setup": "tests/live/test_setup_page.py",
    "setup room": "tests/live/test_setup_page.py",
    **dict.fromkeys(
        (
            "people list site.toml",
            "people name site.toml 7 Ada",
            "people merge site.toml 9 Ada",
            "people colour site.toml Ada orange",
            "people forget site.toml Ada --also backup.db january.parquet",
            "people find site.toml 7 --run 1",
        ),
        "tests/store/test_people.py",
    ),
    "sync cam1.mp4 cam2.mp4 cam3.mp4": "tests/calibrate/test_sound.py",
    "calibrate extrinsics cam1.mp4 cam2.mp4 cam3.mp4 rig.toml --intrinsics lenses.toml "
    "--wand green,red=500mm --rate 10": "tests/calibrate/test_ball_films.py",
    "calibrate extrinsics room --only cam2": "tests/live/test_knocked_camera.py",
    "calibrate intrinsics cam1.mp4 cam2.mp4 cam3.mp4 lenses.toml --board charuco-5x7-54mm "
    "--picture coverage.png": "tests/cli/test_calibrating_lenses.py",
    "attach recordings/20261122T150000Z collected": "tests/edge/test_recorder.py",
    "replay recordings/20261122T150000Z": "tests/live/test_recorded_session.py",
    "up demo-output/site/site.toml": "tests/live/test_programs.py",
    "top site.toml": "tests/live/test_programs.py",
    "top site.toml --once": "tests/live/test_programs.py",
    "router hall --edge tls/edge.local:7447": "tests/live/test_programs.py",
    "up room --view": "tests/live/test_view_page.py",
    "up try --example --view": "tests/live/test_view_page.py",
    "view site.toml": "tests/live/test_view_page.py",
    "stream site.toml homeassistant://127.0.0.1:1883": "tests/live/test_events_of_people.py",
    "stream site.toml webhook:https://example.org/hook": "tests/live/test_events_of_people.py",
    "import bvh fall.bvh recordings/fall": "tests/lab/datasets/test_bvh.py",
    "events test site.toml": "tests/live/test_events_of_people.py",
    "learn versions learned": "tests/lab/train/test_train_command.py",
    "learn rollback learned": "tests/lab/train/test_train_command.py",
    "models path movenet-multipose": "tests/cli/test_models.py",
    "demo": "tests/cli/test_demonstrating.py",
    "import shelf Shelf shelf-truth": "tests/cli/test_importing.py",
    "reproduce reproduced --data data": "tests/lab/test_reproducing.py",
    "reproduce reproduced --quick": "tests/lab/test_reproducing.py",
    **dict.fromkeys(
        (
            "import shelf Shelf rig",
            "detect Shelf/Camera* focused --fps 25 --calibration rig/calibration.toml --feedback",
            "import shelf Shelf data/shelf-feedback --detections focused",
            "detect Shelf/Camera* plain --fps 25 --calibration rig/calibration.toml",
            "import shelf Shelf data/shelf --detections plain",
        ),
        "tests/lab/reproduce/test_shelf_table.py",
    ),
}
LIVE = "asks a site that runs; tests/live/test_four_cameras.py runs the same with its site"
FILMS = "needs films of people and a network that is downloaded"
BOARD = "needs films of a board; tests/calibrate/test_from_boards.py has the method"
DATA = "needs a data set that the project does not ship"
TRAINS = "trains for minutes with torch; tests/lab/train trains for seconds"
DAY = "asks for poses of one afternoon"
HERE_NOT = {
    "reconstruct phone1.mp4 phone2.mp4 phone3.mp4 --height 171cm": FILMS,
    "reconstruct phone1.mp4 phone2.mp4 phone3.mp4 --height 171cm --out walk3d": FILMS,
    "reconstruct cam0?.mp4 --calibration Calib.qca.txt --model movenet-multipose": FILMS,
    "stream room osc://127.0.0.1:9000 lsl:room": LIVE,
    "archive room s3://bucket/poses": "needs an object store; its tests have one in memory",
    "--install-completion": "writes to the start-up file of the shell",
    "calibrate align rig.toml room.toml --floor cam1=floor1.png --board charuco-5x7-54mm": BOARD,
    "calibrate extrinsics cam1.mp4 cam2.mp4 cam3.mp4 rig.toml --intrinsics lenses.toml "
    "--board charuco-5x7-54mm": BOARD,
    "check /var/lib/e3pose/site.toml": "names a file of an installed system",
    "detect Shelf/Camera0 Shelf/Camera1 Shelf/Camera2 Shelf/Camera3 Shelf/Camera4 found "
    "--calibration shelf-truth/calibration.toml --fps 25": DATA,
    "detect cam1.mp4 cam2.mp4 cam3.mp4 cam4.mp4 walk": FILMS,
    "detect cam1.mp4 cam2.mp4 cam3.mp4 walk --calibration Calib.toml": FILMS,
    "detect cam1.mp4 cam2.mp4 cam3.mp4 walk --calibration room.toml": FILMS,
    "detect cam1.mp4 cam2.mp4 cam3.mp4 walk --calibration Calib.toml --feedback": FILMS,
    "detect photos/cam* stills --calibration rig.toml --fps 1": FILMS,
    "detect recordings/videos/*/*-20261122T15*.mkv again --calibration rig.toml": FILMS,
    "evaluate walk --policies all,all+feedback,information,information+feedback": FILMS,
    "evaluate my-recording --policies round-robin,e3pose,information --cameras 1,2 --leads 1,4": (
        "two others of `evaluate` run, in a quarter of the time"
    ),
    "evaluate recordings/shelf --policies e3pose-mv,e3pose --cameras 3 --leads 1,2,3,5,8,10 "
    "--json leads.json": DATA,
    "evaluate shelf --policies e3pose-mv,e3pose --leads 1,2,3,4,5,6,7,8,9,10": DATA,
    "evaluate shelf --policies round-robin --cameras 1.02,2 --predictor attention-lstm": DATA,
    "evaluate-predictor recordings/cmu/* --json figures.json --plot curves.html": DATA,
    "export room walk.parquet --from -1h --smooth rts --angles": LIVE,
    "export live.db walk.trc --from 2026-11-21T14:00 --to 2026-11-21T14:05 --smooth rts": DAY,
    "import cmu cmu_mocap.npz recordings/cmu": DATA,
    "import shelf Shelf shelf --detections found": DATA,
    "import human36m h36m walking --subject 9 --action 14 --subaction 1": DATA,
    "init room usb:0 usb:2 usb:4 usb:6": "needs four webcams",
    "keys add desk --viewer --keys /etc/house": "writes to /etc",
    "keys init house --host house.local --out /etc/house": "writes to /etc",
    "learn replay monday tuesday --out learned --paced": TRAINS,
    "learn replay monday tuesday wednesday --out learned": TRAINS,
    "models bench movenet-multipose --resolution 1280x720": FILMS,
    "models pull movenet-multipose": "downloads a network",
    "models pull hf:Xenova/RTMO-s/onnx/model.onnx": "downloads a network",
    "models pull rtmpose-halpe26": "downloads a network",
    "power --watch": "goes on until it is stopped; `power` runs",
    "power measure usb:0 my-board.toml --profile xavier-nx "
    "--detector openpose-thin": "needs a webcam",
    "power measure usb:0 my-board.toml --meter shelly:192.168.1.20": (
        "needs a webcam and a plug; tests/cli/test_metering.py has stand-ins"
    ),
    "replay walk --feedback": FILMS,
    "replay recordings/thursday --pipeline paper --predictor published/attention-lstm.onnx": TRAINS,
    "replay recordings/thursday --predictor predictor/attention-lstm.onnx": TRAINS,
    "replay thursday --predictor learned/versions/000001.onnx": TRAINS,
    "simulate films --people 2 --cameras 4 --seconds 30 --videos": (
        "draws films for minutes; the same for one person runs in tests/live/test_four_cameras.py"
    ),
    "simulate my-room --calibration room.toml --seconds 120": "takes a minute; others run",
    "simulate my-table --scene round-table --cameras 5 --seed 3": "takes a minute",
    "simulate my-ring --scene crossing --people 6 --cameras 8 --errors situation": (
        "takes a minute"
    ),
    "store copy backup.db postgresql://e3pose@db.local/lab": "needs a PostgreSQL server",
    "stream site.toml osc://127.0.0.1:9000 mcap:today.mcap": (
        "goes on until it is stopped; tests/streams have its outputs"
    ),
    "top try --once": LIVE,
    "train my-mocap --start shipped --replays 4": TRAINS,
    "train my-room --published --out published": TRAINS,
    "train my-room --start shipped --minutes 10": TRAINS,
    "train recordings/monday recordings/tuesday --validate recordings/wednesday "
    "--out predictor": TRAINS,
}


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with what the commands of the pages take for granted, all of it small."""
    top = tmp_path_factory.mktemp("stock")
    recording = replace(walk(761, seconds=8.0, fps=15.0), name="example")
    save_recording(recording, top / "walk")
    short = between(recording, 0, 40)
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
    save_recording(short, top / "demo-output" / "recording")
    for place in ("try", "demo-output/site"):
        (top / place).mkdir(parents=True, exist_ok=True)
        shutil.copy(top / "live.db", top / place)
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
    four = set(commands_of(BY_PAGE["docs/tutorial/four-cameras.md"]))
    known = {*RUNS, *ELSEWHERE, *HERE_NOT, *four}
    pages = {
        command: page
        for page, text in BY_PAGE.items()
        if not page.startswith(MEASUREMENTS)
        for command in commands_of(text)
    }
    new = {command: page for command, page in pages.items() if command not in known}
    assert not new, f"run them in RUNS, or say why not: {new}"
    gone = {command for command in known if command not in pages}
    assert not gone, "no page has these any more"
    for place in {FOUR_CAMERAS, *ELSEWHERE.values()}:
        assert (ROOT / place).is_file(), place
