"""What no verb of a live site may do with bad input; the manner is that of `test_hostile`."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.breaking import Break, ahead, cut, instead, nested, new, sparse, whole
from tests.cases import each_case
from tests.cli.commands import refused_and_unchanged

from e3pose.cli import main
from e3pose.energy import profiles
from e3pose.model import noises
from e3pose.recording import save_recording
from e3pose.simulate import SceneSettings, simulate
from e3pose.site.example import write_recorded
from e3pose.wire.keys.folder import add_keys, init_keys

pytestmark = pytest.mark.slow

Captured = pytest.CaptureFixture[str]
ESCAPE = "\x1b[2J"
HUGE = 5000 * "9"
LIMIT_S = 60  # a second, on a machine that does nothing else
ENDS = {
    "edge": ("--for", "0.2"), "up": ("--for", "0.2"), "check": ("--timeout", "0"),
    "top": ("--once", "--timeout", "0"),
}  # fmt: skip
SITE, LIST, NOISE, HEADER = "site/site.toml", "keys/keys.toml", "noise.toml", "rec/recording.toml"
VERSIONS, PROFILE, PEM = "learned/versions/versions.json", "p.toml", "keys/cameras/cam0/camera.pem"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with one good thing of each kind."""
    import datetime

    folder = tmp_path_factory.mktemp("live")
    recording = simulate(SceneSettings(people=2, seconds=0.4, cameras=3), seed=0)
    save_recording(recording, folder / "rec")
    write_recorded(folder / "site", recording)
    now = datetime.datetime.now(datetime.timezone.utc)
    init_keys(folder / "keys", "example", [], now)
    add_keys(folder / "keys", "cam0", now)
    for package, name, to in (
        (noises, "simulated.toml", NOISE),
        (profiles, "generic.toml", PROFILE),
    ):
        shutil.copy(Path(str(package.__file__)).parent / name, folder / to)
    with pytest.raises(SystemExit, match="0"):
        made_of = ["--store", str(folder / "s.db"), "--poses", str(folder / "p.csv")]
        main(["replay", str(folder / "rec"), "-C", "2", *made_of])
    (folder / "learned" / "versions").mkdir(parents=True)
    (folder / VERSIONS).write_text(versions(1, 2))
    return folder


@contextmanager
def working_copy(made: Path, tmp_path: Path) -> Iterator[Path]:
    """Work in a copy of it."""
    folder, before_in = tmp_path / "w", Path.cwd()
    shutil.copytree(made, folder)
    os.chdir(folder)
    try:
        yield folder
    finally:
        os.chdir(before_in)
        shutil.rmtree(folder)


@contextmanager
def in_time() -> Iterator[None]:
    """Give up what does not end."""

    def late(*_: object) -> None:
        raise AssertionError(f"not done in {LIMIT_S} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(LIMIT_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.fixture
def place(made: Path, tmp_path: Path) -> Iterator[Path]:
    with working_copy(made, tmp_path) as folder:
        yield folder


def refused(capsys: Captured, place: Path, words: list[str], message: str) -> None:
    with in_time():
        refused_and_unchanged(capsys, words, message, place)


def versions(*numbers: int, made_s: float = 1.0, parent: int = 0) -> str:
    """Return a list of versions, the last one current."""
    each = ",".join(
        f'{{"number":{n},"parent":{parent},"created_s":{made_s},"sha256":"{"0" * 64}",'
        '"leads":[1],"error_m":[0.1],"parent_error_m":[0.2],"windows":9}'
        for n in numbers
    )
    shown = f'"format":"e3pose predictor versions","current":{numbers[-1]},"last":9'
    return f'{{{shown},"versions":[{each}]}}'


FPS, ID, PATH, CAMERAS = "fps = 10.0", 'id = "cam0"', 'path = "live.db"', "cameras = 2"
HERE = "tcp/127.0.0.1"
# What is wrong with a site -> the verb that must say so (check, up and edge look at all of it, top
# at the file), and what the line must say.
SITES: list[tuple[str, Break, str]] = [
    ("top", whole(SITE, ""), 'missing: format = "e3pose-site"'),
    ("edge", cut(SITE), "site.toml: .*TOML|missing"),
    ("up", whole(SITE, b"\xff\xfe\0"), "site.toml: .*TOML"),
    ("top", sparse(SITE), "found 10737418240 bytes"),
    ("edge", instead(SITE, os.mkfifo), "found a pipe"),
    ("check", instead(SITE, Path.mkdir), "found a folder"),
    ("edge", whole(SITE, "a = " + 100_000 * "["), "site.toml: .*TOML"),
    ("top", new(SITE, "version = 1", "version = 2"), "version: found 2, expected 1"),
    ("up", new(SITE, "version = 1", "version = true"), "version: found a boolean"),
    ("top", new(SITE, "e3pose-site", "e3pose-camera"), "found 'e3pose-camera', expected 'e3pose-s"),
    ("edge", new(SITE, 'name = "example"', ""), 'missing: name = "lab"'),
    ("up", new(SITE, '"example"', '"../x"'), r"name: found '\.\./x'"),
    ("top", new(SITE, '"example"', '"*"'), r"name: found '\*'"),
    ("edge", ahead(SITE, '"\\u001b[2J" = 1'), r"unknown key '\\\\x1b\[2J'|\\x1b"),
    ("check", ahead(SITE, "fpx = 1"), "unknown key 'fpx', expected one of format"),
    ("check", ahead(SITE, "fps = 1.0"), "TOML: .*overwrite"),
    ("edge", new(SITE, "fps = ", "fps = nan #"), "fps: found nan, expected 0.1 to 1000"),
    ("up", new(SITE, "fps = ", 'fps = "25" #'), "fps: found text, expected a number"),
    ("up", new(SITE, "fps = ", f"fps = {HUGE} #"), "TOML: Exceeds"),
    ("edge", new(SITE, "pace = ", "pace = 0 #"), "pace: found 0"),
    ("edge", ahead(SITE, 'lead = "soon"'), "lead: found 'soon', expected a whole number or 'adap"),
    ("edge", ahead(SITE, "lead = 99999999999999999999"), "lead: found"),
    ("check", ahead(SITE, 'budget = "much"'), "budget: found 'much', expected 0.6"),
    ("edge", ahead(SITE, 'budget = "until 2001-01-01T00:00"'), "has passed"),
    ("check", ahead(SITE, "metrics_port = 99999"), "metrics_port: found"),
    ("edge", new(SITE, '"rig.toml"', '"/dev/zero"'), "found a pipe, socket or device"),
    ("check", new(SITE, '"rig.toml"', '"a\\u0000"'), r"found 'a\\x00', expected the name"),
    ("check", new(SITE, '"rig.toml"', '"~nobody-at-all/x"'), "home of a user"),
    ("check", new(SITE, '"coco17"', '"fish"'), "fish: skeleton: no such file, expected coco17, "),
    # What the edge writes must not take the place of what is there.
    ("edge", ahead(SITE, 'state = "rig.toml"'), "state: found 'rig.toml', expected .*npz"),
    ("edge", ahead(SITE, 'state = "recording"'), "state: found 'recording'"),
    ("edge", ahead(SITE, 'learn = "recording"'), "found a folder of other things"),
    ("edge", ahead(SITE, 'learn = "rig.toml"'), "found a file, expected a folder to learn"),
    ("edge", new(SITE, PATH, 'path = "rig.toml"'), "no database"),
    ("up", new(SITE, PATH, 'path = "recording"'), "found a folder, expected a file"),
    ("check", new(SITE, PATH, 'path = "no/such.db"'), "found no folder"),
    (
        "edge",
        new(SITE, PATH, 'path = "foo://bar"'),
        "foo://bar: found foo, expected a file or postgresql",
    ),
    (
        "edge",
        new(SITE, PATH, 'path = "postgresql://u:s3cret@h:x/y"'),
        r"//\*\*\*@h:x/y: expected a",
    ),
    ("check", new(SITE, PATH, 'path = "sqlite://h:x/y"'), "sqlite://h:x/y: expected a path"),
    ("check", new(SITE, PATH, f'{PATH}\nkeep = "30 moons"'), "store.keep: found '30 moons'"),
    ("check", new(SITE, PATH, f'{PATH}\nmax_size = "9{400 * "9"}GB"'), "store.max_size: found"),
    ("edge", new(SITE, CAMERAS, "cameras = 9"), "loop.cameras: found 9"),
    ("check", new(SITE, CAMERAS, "cameras = true"), "cameras: found True"),
    ("edge", new(SITE, CAMERAS, 'policy = "x"'), "site.toml: loop.policy: found 'x'"),
    ("up", new(SITE, CAMERAS, "policy = []"), r"policy: found \[\], expected a name"),
    ("check", new(SITE, CAMERAS, "lead = 2"), "lead: found it in .loop., expected lead at the top"),
    ("check", new(SITE, CAMERAS, 'warmup = "x"'), "loop.warmup: found text, expected a whole"),
    ("edge", new(SITE, CAMERAS, 'noise = "rig.toml"'), "rig.toml: format: found"),
    ("edge", new(SITE, CAMERAS, 'target_error = "4"'), "site.toml: loop.target_error: found '4'"),
    (
        "edge",
        new(SITE, CAMERAS, 'match_distance = "1"'),
        "site.toml: loop.match_distance: found '1'",
    ),
    ("check", new(SITE, CAMERAS, 'match_distance = "1cm"'), "match_distance: found with the pip"),
    (
        "check",
        new(SITE, "[loop]", '[events]\nkinds = ["flying"]\n[loop]'),
        "found 'flying', expected",
    ),
    (
        "check",
        new(SITE, "[loop]", '[energy]\nbattery_wh = "50,cam9=1"\n[loop]'),
        "^e3pose: site/site.toml: energy.battery_wh: found camera 'cam9'",
    ),
    ("check", new(SITE, "[loop]", '[energy]\nprofile = "x"\n[loop]'), "device profile"),
    ("check", new(SITE, "[loop]", '[energy]\nlifetime = "9000d"\n[loop]'), "lifetime: found"),
    ("edge", new(SITE, ID, 'id = "cam9"'), "camera cam9: found no such camera"),
    ("top", new(SITE, ID, 'id = "cam1"'), "camera cam1: found twice"),
    (
        "top",
        new(SITE, ID, f"{ID}, idd = 1"),
        r"camera\[0\]: found unknown key 'idd', expected one of model",
    ),
    ("top", new(SITE, ID, f"{ID}, wake_s = nan"), r"camera\[0\]\.wake_s: found nan"),
    ("top", new(SITE, ID, f'{ID}, meter = "x"'), "found 'x', expected 'auto' or 'model'"),
    ("edge", new(SITE, ID, f'{ID}, budget = "x"'), "camera cam0: budget: found 'x'"),
    ("up", new(SITE, 'source = "recorded:recording"', 'provider = "cpu"'), "cam0: source: found n"),
    ("edge", new(SITE, HERE, "http/127.0.0.1"), "expected tls/HOST:PORT"),
    ("edge", new(SITE, HERE, "tcp/0.0.0.0"), "plain tcp beyond this machine"),
    ("edge", new(SITE, HERE, "tls/127.0.0.1"), "tls without certificates"),
    ("edge", new(SITE, "[link]", '[link]\nupstream = ["x"]'), "link.upstream: found 'x'"),
]


@each_case("verb, break_it, message", SITES)
def test_a_bad_site_gets_one_line(
    made: Path, tmp_path: Path, capsys: Captured, verb: str, break_it: Break, message: str
) -> None:
    with working_copy(made, tmp_path) as place:
        break_it(place)
        refused(capsys, place, [verb, SITE, *ENDS[verb]], message)


CAMERA = "camera --site example --name cam0 --source"
USB = 'format = "e3pose-camera"\nversion = 1\nsite = "lab"\ncamera = "cam0"\nsource = "usb:0"\n'
# What is wrong with another file -> the command that must say so, and what.
FILES: list[tuple[str, Break, str]] = [
    ("keys list", whole(LIST, ""), "keys.toml: missing: site = "),
    ("keys list", whole(LIST, 'format = "x"'), "format: found 'x', expected 'e3pose-keys'"),
    ("keys add cam1", new(LIST, "version = 1", "version = 2"), "version: found 2, expected 1"),
    ("keys list", sparse(LIST), "found 10737418240 bytes"),
    ("keys list", new(LIST, "cam0 =", '"../x" ='), r"keys.toml: camera id: found '\.\./x'"),
    ("keys list", new(LIST, '"cam0#1"', '"\\u001b[2J"'), "found '.*', expected a common name"),
    ("keys add cam1", new(LIST, "revoked = []", 'revoked = ["cam0#1"]'), "cam0#1 twice"),
    ("keys add cam1", new(LIST, "count = 1", "count = -5"), "count: found -5, expected 0 to"),
    ("keys list", ahead(LIST, "zzz = 1"), "unknown key 'zzz'"),
    ("keys add cam1", whole("keys/authority.key", "x"), "authority.key: found no certificate"),
    (f"{CAMERA} recorded:rec --endpoint tls/localhost:1 --keys keys/cameras/cam0",
     cut(PEM), "camera.pem: found no certificate or key"),
    ("camera cam.toml", whole("cam.toml", 'format = "e3pose-camera"\nversion = 1'), "missing: s"),
    ("camera cam.toml --pace 0.5", whole("cam.toml", USB), "^e3pose: --pace: found 0.5, expected"),
    ("camera cam.toml", whole("cam.toml", f"{USB}pace = 0.5\n"), "^e3pose: cam.toml: pace: found"),
    ("camera cam.toml --pace 1", whole("cam.toml", f"{USB}wake_s = -1\n"), "cam.toml: wake_s: "),
    ("info rec", new(HEADER, "version = 3", "version = 2"), "version: found 2, expected 3"),
    ("replay rec --noise noise.toml", cut(NOISE), "noise.toml: "),
    ("replay rec --noise noise.toml", new(NOISE, "version = 2", "version = 3"), "version: found"),
    ("replay rec --noise noise.toml", ahead(NOISE, "zzz = 1"), "unknown key 'zzz'"),
    ("replay rec --noise noise.toml", new(NOISE, "image_px = ", "image_px = nan #"), "image_px"),
    ("replay rec --noise noise.toml", sparse(NOISE), "found 10737418240 bytes"),
    ("power --profile p.toml", new(PROFILE, "version = 2", "version = 9"), "version: found 9"),
    ("power --profile p.toml", new(PROFILE, "watts = ", "watts = -"), "watts: found"),
    ("learn versions learned", whole(VERSIONS, b"\xff\xfe"), "versions.json: found no list"),
    ("learn rollback learned", whole(VERSIONS, b'{"format":"\xff"}'), "found no list"),
    ("learn versions learned", whole(VERSIONS, "[" * 100_000), "versions.json: "),
    ("learn versions learned", whole(VERSIONS, versions(1, 1)), "every number once"),
    ("learn versions learned", whole(VERSIONS, versions(1, made_s=1e300)), "figures that cannot"),
    ("learn rollback learned", whole(VERSIONS, versions(1, parent=1)), "figures that cannot"),
    ("learn rollback learned", instead(VERSIONS, os.mkfifo), "found a pipe"),
    ("query s.db", whole("s.db", b"SQLite format 3\0" + 5000 * b"\xff"), "s.db: (damaged|cannot)"),
    ("query s.db", whole("s.db", ""), "no tables"),
    ("query site", new(SITE, '[store]\npath = "live.db"\n', ""), "missing: .store. path"),
    ("query s.db", instead("s.db", os.mkfifo), "s.db: found"),
    ("query s.db", nested("s.db"), "s.db: runs: run 1: joints and cameras are no lists"),
]  # fmt: skip


@each_case("words, break_it, message", FILES)
def test_a_bad_file_gets_one_line(
    made: Path, tmp_path: Path, capsys: Captured, words: str, break_it: Break, message: str
) -> None:
    with working_copy(made, tmp_path) as place:
        break_it(place)
        refused(capsys, place, words.split(), message)


# Words of a command -> what the line must say.
WORDS: list[tuple[str, str]] = [
    ("edge", "SITE"),
    ("edge nosuch", "^e3pose: nosuch: file not found"),
    ("edge /dev/zero", "found a pipe, socket or device"),
    (f"edge {SITE} --for nan", "--for: found nan"),
    (f"edge {SITE} --for -1", "--for: found -1"),
    (f"up {SITE} --for inf", "--for: found inf"),
    (f"up {SITE} --logs s.db", "--logs: found a file"),
    ("up rec --for 0", "rec: found a recording, expected a site"),
    ("up rec --example --for 0", "is there already"),
    (f"top {SITE} --once --timeout inf", "--timeout: found inf"),
    (f"top {SITE} --once --timeout 0", "edge of site example does not answer"),
    (f"check {SITE} --timeout nan", "--timeout: found nan"),
    (f"edge {SITE} --delay=5s", "^e3pose: --delay: found .*expected 0 to 2000"),
    (f"edge {SITE} --delay=soon", "^e3pose: --delay: found .*expected"),
    (f"up {SITE} --delay=-200ms", "^e3pose: --delay: found .*expected"),
    ("camera rec", "^e3pose: rec: found a folder"),
    ("camera", "missing: --site"),
    (f"camera --site ../x --name cam0 --source {ESCAPE}", r"--site: found '\.\./x'"),
    (
        "camera --site lab --name cam9 --source recorded:rec",
        "--name: found 'cam9', which is not in the rig",
    ),
    (f"{CAMERA} recorded:", "expected recorded:RECORDING"),
    (f"{CAMERA} recorded:nosuch", "nosuch: no such folder"),
    (f"{CAMERA} usb:x", "expected usb:by-id/NAME"),
    (f"{CAMERA} x{ESCAPE}", "expected the name of a file"),
    (f"{CAMERA} {HUGE}", ""),
    (f"{CAMERA} recorded:rec --pace nan", "pace: found nan"),
    (f"{CAMERA} recorded:rec --battery-wh 0", "--battery-wh: found 0"),
    (f"{CAMERA} recorded:rec --threads {HUGE}", "threads"),
    (f"{CAMERA} recorded:rec --endpoint tcp/10.0.0.1:1", "plain tcp beyond this machine"),
    (f"{CAMERA} recorded:rec --endpoint tls/10.0.0.1:1", "tls without certificates"),
    (f"{CAMERA} recorded:rec --endpoint tls/10.0.0.1:1 --keys rec", "authority.pem: file not"),
    ("keys init ../x --out new", r"site: found '\.\./x'"),
    ("keys init lab --out rec", "not empty, expected a free name"),
    ("keys init lab --out s.db/x", "s.db is a file"),
    (f"keys init lab --out new --host {ESCAPE}", "expected a name or an address"),
    ("keys add ../x", r"camera id: found '\.\./x'"),
    ("keys add cam0", "--again"),
    (f"keys add {HUGE}", "camera id"),
    ("keys revoke nobody", "expected one of: cam0"),
    ("keys list --keys rec", "keys.toml: file not found"),
    ("query", "STORE"),
    ("query nosuch", "no such file"),
    ("query rec", "found a recording"),
    ("query foo://bar", "found foo, expected a file or postgresql"),
    ("query postgresql://u:secret@127.0.0.1:1/x", r"^e3pose: postgresql://u:\*\*\*@"),
    ("query postgresql://u:s3cret@h:port/x", r"^e3pose: postgresql://\*\*\*@h:port/x: expected"),
    ("export s.db nodir/a.csv --what slots", r"nodir/a.csv: found no folder nodir, expected one"),
    ("export s.db a.json --what slots", r"DEST: found 'a.json', expected a name ending in .csv or"),
    ("export s.db a.csv --what slots --smooth rts", "--smooth: found with --what slots"),
    ("export s.db a.csv --what slots --track 1", "--track: found 1 with --what slots"),
    ("export s.db a.csv --what poses --track 1 2", "--track: found 2 with --what poses"),
    ("export s.db a.csv --what poses --region 0,0,1,1", "--region: found with --what poses"),
    ("query s.db --json nodir/sub/a.json", "found no folder nodir/sub"),
    (f"query s.db --from {ESCAPE}", "--from, --to: found"),
    (f"query s.db --from {50 * '9'}", "--from, --to: found"),
    ("query s.db --from now --to -10min", "the earlier one first"),
    (f"query s.db --track {30 * '9'}", "--track: found 9"),
    ("query s.db --joint tail", "^e3pose: --joint: found 'tail'"),
    ("query s.db --what slots --track 1", "^e3pose: --track: found 1 with --what slots"),
    ("query s.db --what runs --from -1h", "^e3pose: --from: found with --what runs"),
    ("query s.db --run 99", "^e3pose: --run: found 99"),
    ("query s.db --site nowhere", "^e3pose: --site: found 'nowhere'"),
    ("query s.db --json s.db", "found the store itself"),
    ("query s.db --json s.db-wal", "found the store itself"),
    ("power --seconds nan", "--seconds: found nan"),
    ("power --profile rec/recording.toml", "format: found 'e3pose-recording'"),
    ("learn versions rec", "found no versions, expected"),
    ("learn rollback learned --to 7", "version: found 7"),
    ("learn replay rec --out rec", "a folder of other things"),
    ("learn replay rec --out s.db", "found a file, expected a folder to learn"),
    ("learn replay rec rec --out new", "rec: found twice"),
    ("learn replay rec --out new --policy x", "policy: found 'x'"),
    ("learn replay rec --out new --cameras 99", "cameras: found 99"),
    ("learn replay rec --out new --least nan", "least_s: found nan"),
    ("learn replay rec --out new --held-back inf", "held_back_s: found inf"),
    ("calibrate noise rec --seconds nan", "--seconds: found nan"),
    ("calibrate noise rec --out rec", "found a folder"),
    ("calibrate noise rec --out rec/recording.toml", "a file of the recording"),
    (f"calibrate noise rec --detector {ESCAPE}", "--detector: found"),
    ("replay rec --match-distance 15", "--match-distance: found '15'"),
    ("replay rec --match-distance 15cm", "--match-distance: found with the pipeline memory"),
    ("replay rec --profile generic,cam0=nosuch", "nosuch: device profile"),
    ("replay rec --kill-camera cam9@1", "--kill-camera: found 'cam9'"),
    (f"replay rec --kill-camera cam0@{HUGE}", "--kill-camera: found"),
    ("replay rec --loss nan", "--loss: found nan"),
    ("replay rec --fps inf", "--fps: found inf"),
    ("replay rec --fps 1e-300 --store new.db", "--fps: found 1e-300, expected 0.001 at least"),
    ("replay rec --store postgresql://h:x/y", "postgresql://h:x/y: expected a path"),
    ("replay rec --poses nodir/x.csv", "nodir/x.csv: found no folder nodir, expected one"),
    ("replay rec --report nodir/sub/x.html", "found no folder nodir/sub"),
    ("evaluate rec --json nodir/x.json", "found no folder nodir"),
    ("calibrate noise rec --out nodir/x.toml", "found no folder nodir"),
    ("replay rec --keep 30d", "found no --store"),
    (f"replay rec --store new.db --max-size {400 * '9'}GB", "size: found"),
    ("replay rec --store s.db --json s.db", "found the file of --store"),
    ("replay rec --store rec", "found a folder"),
    ("replay rec --store nodir/s.db", "found no folder nodir"),
    ("replay rec --store /dev/null", "found a pipe, socket or device"),
    ("evaluate rec --leads 1,x", "--leads: found '1,x'"),
    ("evaluate rec --plot new.svg", "--plot: found no --leads"),
    ("evaluate rec --cameras 1.5,nan", "--cameras: found 'nan'"),
    ("evaluate-predictor rec --pictures rec --overwrite", "holds no error-by-lead.svg"),
    ("evaluate-predictor rec --slots 5:2", "slots: found 5:2"),
    (f"evaluate-predictor rec --slots {HUGE}:1", "--slots: found"),
    ("train rec --jobs 0", "--jobs: found 0"),
    ("train rec --combinations 0", "--combinations: found 0"),
    ("train rec --target x", "target"),
    (f"{CAMERA} recorded:rec --pace 7", "^e3pose: --pace: .*expected 0.001 to 1"),
    (f"{CAMERA} recorded:rec --begin-s -1", "^e3pose: --begin-s: .*expected 0 to"),
    (f"{CAMERA} recorded:rec --fps 0", "^e3pose: --fps: .*expected 0.1 to 1000"),
    (f"{CAMERA} recorded:rec --threads 0", "^e3pose: --threads: .*expected 1 to 1024"),
    (f"{CAMERA} recorded:rec --wake-s -1", "^e3pose: --wake-s: .*expected 0 to 3600"),
    (f"{CAMERA} recorded:rec --meter guess", "^e3pose: --meter: .*expected 'auto' or 'model'"),
    (f"{CAMERA} recorded:rec --endpoint udp/x:1", "^e3pose: --endpoint: .*expected tls/HOST:PORT"),
    ("camera --site lab --name ../x --source recorded:rec", "^e3pose: --name: .*expected 1 to 64"),
    ("query s.db --what events --joint nose", "--joint: found"),
    ("query s.db --json rec", "found a folder"),
    ("replay rec --store rec/recording.toml", "a file of the recording"),
    ("replay rec --store new.db --keep soon", "found 'soon'"),
    ("replay rec --store new.db --max-size 3", "such as 20GB"),
    ("replay rec --store bogus://there", "bogus"),
    ("replay rec --policy best", "--policy: found 'best'"),
    ("replay rec --cameras two", "two"),
    ("replay rec --target-error 40", "--target-error: found '40'"),
    ("replay rec --target-error 0mm", "--target-error: found"),
    ("replay rec --target-error 40mm --cameras 2", "found a number of cameras as well"),
    ("replay rec --target-error 40mm --policy round-robin", "round-robin"),
    ("replay rec --lifetime 10", "--lifetime: found '10'"),
    ("replay rec --lifetime 10h", "found 10 h for camera cam0, expected less than 8 h"),
    ("replay rec --lifetime 5h --budget 0.5", "found with budget"),
    ("replay rec --lifetime 7h --cameras 3", "expected at least 3"),
    ("replay rec --battery-wh cam0=20", "nothing for camera cam1"),
    ("replay rec --battery-wh 50,cam9=20", "'cam9'"),
    ("replay rec --battery-wh 50,60", "two values"),
    ("replay rec --round-trip-ms inf", "--round-trip-ms: found inf"),
    ("replay rec --smooth best", "best"),
    ("replay rec --smooth rts --store new.db", "found with --smooth"),
    ("replay rec --cutoff 6Hz", "--cutoff: found"),
    ("replay rec --delay 200", "--delay: found '200', expected"),
    ("replay rec --delay 5s", "--delay: found 5000, expected 0 to 2000"),
    ("replay rec --delay 200ms --smooth rts", "--delay: found with --smooth"),
    ("replay rec --delay 200ms --store new.db", "found with --delay"),
    ("replay rec --delay 200ms --pipeline paper", "--delay: found with the pipeline paper"),
    ("events test none.toml", "none.toml"),
    (f"events test {SITE} --cameras 2", "--cameras: found 2 with a site, expected a recording"),
    ("setup new --listen 0.0.0.0:0", "an address of loopback"),
    ("evaluate rec --policies all,best", "'best'"),
    ("evaluate rec --cameras 2,x", "--cameras: found 'x'"),
    ("evaluate rec --cameras 2,9", "cameras: found 9"),
    ("evaluate rec --cameras 0", "cameras: found 0"),
    ("evaluate rec -V 1,much", "--quality-weight: found 'much'"),
    ("evaluate rec -V nan", "--quality-weight: found 'nan'"),
    ("evaluate rec -V -1", "quality-weight: found -1"),
    ("evaluate rec -E 0.6,2 --policies e3pose", "budget: found 2"),
    ("evaluate rec --budget 0.1 --policies e3pose", "budget: found"),
    ("evaluate rec --leads 0", "--leads: found 0"),
    ("evaluate rec --plot leads.png", "--plot: found 'leads.png'"),
    ("evaluate rec --seeds 0", "--seeds: found 0"),
    ("evaluate rec --seeds 1000000000", "--seeds: found"),
    ("evaluate rec --jobs 0", "--jobs: found 0"),
    ("evaluate rec --battery-wh 0", "battery-wh: found"),
    ("evaluate rec --idle-mode asleep", "idle-mode"),
    ("evaluate rec --kill-camera cam9@3", "--kill-camera: found 'cam9'"),
    ("evaluate rec --hold-out cam9", "--hold-out: found 'cam9', expected one of cam0, cam1, cam2"),
    ("replay rec --hold-out cam9", "--hold-out: found 'cam9', expected one of cam0, cam1, cam2"),
    ("replay rec --feedback --detector drawn", "--feedback: found no video of cam0"),
    ("reproduce new --only table-9", "--only: found 'table-9', expected"),
    ("reproduce new --data none", "--data: found"),
    ("reproduce new --seeds 0", "--seeds: found 0, expected at least 1"),
    ("reproduce new --jobs 0", "--jobs: found 0"),
    ("evaluate-predictor rec --slots 5", "--slots: found '5'"),
    ("evaluate-predictor rec --slots 70:80", "slots: found 70:80, expected a part of 0:10"),
    ("evaluate-predictor rec --leads 1,x", "--leads: found '1,x'"),
    ("evaluate-predictor rec --leads 0", r"leads: found \(0,\)"),
    ("evaluate-predictor rec --leads 301", "1 to 300"),
    ("evaluate-predictor rec --leads=", "--leads: found ''"),
    ("evaluate-predictor rec --predictors x", "predictor: found 'x', expected one of"),
    ("evaluate-predictor rec --history 0", "history: found 0"),
    ("evaluate-predictor rec --history 500", "found nobody in 500 consecutive slots"),
    ("evaluate-predictor rec --missing 1", "missing: found 1"),
    ("evaluate-predictor rec --noise-mm nan", "noise: found nan"),
    ("evaluate-predictor rec --noise-mm -1", "noise: found"),
    ("evaluate-predictor rec --seed -1", "seed and every: found -1 and 1"),
    ("evaluate-predictor rec --every 0", "seed and every: found 0 and 0"),
    ("evaluate-predictor rec --plot curves.txt", "--plot: found 'curves.txt'"),
    ("evaluate-predictor rec --json rec/recording.toml", "found a file of the recording"),
    ("evaluate-predictor", "RECORDING"),
    ("train rec --out new --hold-out 0.95", "--hold-out: found"),
    ("train rec --out new --hold-out nan", "--hold-out: found"),
    ("train rec --out new --history 3", "--history: found"),
    ("train rec --out new --leads 0", "--leads: found"),
    ("train rec --out new --hidden 100000", "--hidden: found"),
    ("train rec --out new --dropout 1", "--dropout: found"),
    ("train rec --out new --steps 0", "--steps: found"),
    ("train rec --out new --minutes 0", "--minutes: found"),
    ("train rec --out new --batch 1", "--batch: found"),
    ("train rec --out new --seed -1", "--seed: found"),
    ("calibrate noise rec --plot a.png", "--plot: found 'a.png'"),
    ("calibrate noise rec --seconds 0.04", "found 0 keypoints"),
    ("calibrate extrinsics a.mp4", "found 1 path"),
    ("calibrate extrinsics a.mp4 b.mp4 x.toml", "--intrinsics: found none"),
    ("calibrate extrinsics rec x.toml --height 49cm", "--height: found 49cm, expected the height"),
    ("calibrate extrinsics rec x.toml --height 2.6m", "--height: found 2.6m, .*0.5 to 2.5 m"),
    ("calibrate extrinsics rec x.toml --limb knee=4cm", "--limb: found"),
    ("calibrate extrinsics rec x.toml --limb knee,left_ankle=43cm", "expected two of nose"),
    ("calibrate extrinsics rec x.toml --distance cam0,cam9=3m", "expected two of cam0"),
    ("calibrate extrinsics rec x.toml --ball green", "a recording of people, expected videos"),
    ("calibrate extrinsics rec x.toml --seconds 0", "--seconds: found 0"),
    ("calibrate align rec x.toml --up=w", "--up: found 'w'"),
    ("calibrate align rec x.toml --points=1,2", "--points: expected"),
    ("calibrate check rec --picture x.pdf", "--picture: found 'x.pdf'"),
    ("export p.csv walk.docx", "'.docx'"),
    ("export p.csv walk.trc --format c3d", "expected .c3d"),
    ("export p.csv walk.trc --angles", "--angles: found with trc"),
    ("export p.csv walk.csv --units m", "--units: found with csv"),
    ("export p.csv walk.trc --names vrm", "--names vrm: found with trc, expected bvh or gltf"),
    ("export p.csv walk.csv --layout archive", "archive: found with csv, expected parquet"),
    ("export p.csv walk.trc --layout wide", "--layout: found with trc, expected csv or parquet"),
    ("export p.csv walk.csv --layout long --angles", "long: found with csv, expected no"),
    ("export p.csv walk.c3d --names opencap", "--names opencap: found with c3d, expected trc"),
    ("export p.csv walk.trc --calibration rig.toml", "--calibration: found with trc"),
    ("export p.csv walk.json", "--calibration FILE"),
    ("export p.csv walk.trc --track 99", "found no poses that fit"),
    ("export p.csv walk.trc --region 1,2,3", "--region: found '1,2,3'"),
    ("export p.csv walk.trc --fill 2", "--fill: found '2'"),
    ("export p.csv walk.trc --fps 0", "--fps: found 0"),
    ("export p.csv walk.trc --smooth butterworth --cutoff 20Hz", "less than 10 Hz"),
    ("export p.csv walk.trc --cutoff 6Hz", "--cutoff: found without"),
    ("export p.csv walk.trc --from 14:00", "no dates"),
    ("export p.csv walk.trc --run 1", "--run"),
    ("export p.csv p.csv", "the source itself"),
    ("export none.db w.trc", "none.db"),
    ("export none.csv w.trc", "no such file"),
    ("export rec w.trc", "e3pose replay"),
    ("export s.db w.trc --site other", "--site: found 'other'"),
    ("reconstruct --out new", "FILM.*: found 0, expected films of three cameras or more without"),
    ("reconstruct a.mp4 b.mp4 --out new", "found 2, expected films of three cameras"),
    ("reconstruct a.mp4 b.mp4 c.mp4 --out new", "a.mp4: found no file"),
    ("reconstruct a.toml --out new", "a.toml: file not found"),
    ("reconstruct a.mp4 --calibration absent.toml --out new", "absent.toml: file not found"),
    ("simulate new --scene two-rooms --people 99999", "people: found"),
    ("simulate new --scene shaft --cameras 99", "cameras: found 99"),
]


@each_case("words, message", WORDS)
def test_a_bad_command_gets_one_line(
    place: Path, capsys: Captured, words: str, message: str
) -> None:
    refused(capsys, place, words.split(" "), message)  # which leaves the place as it was


def test_a_link_is_no_place_for_the_keys_of_a_camera(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (place / "keys" / "cameras" / "cam1").symlink_to(place / "rec")
    refused(capsys, place, ["keys", "add", "cam1"], "found a symbolic link")


def test_a_number_of_a_certificate_is_never_given_twice(place: Path) -> None:
    new(LIST, "count = 1", "count = 0")(place)
    with pytest.raises(SystemExit, match="0"):
        main(["keys", "add", "cam1"])
    assert 'cam1 = "cam1#2"' in (place / LIST).read_text()
