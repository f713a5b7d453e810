"""The source as a whole: what modules import, ask, print and show, and how large they are."""

from __future__ import annotations

import ast
import functools
import importlib
import itertools
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from tests.cases import each_case
from tests.distributions import FOLDERS, PACKAGES, PRODUCT, ROOT, nodes, read
from tests.house import PARTS, lines, measure

import e3pose
from e3pose.cli.app import VERBS
from e3pose.model.camera import Camera, Rig
from e3pose.recording.calibration import save_rig
from e3pose.simulate import SceneSettings, simulate

HEAVY = {
    "torch",
    "cv2",
    "onnxruntime",
    "numba",
    "av",
    "plotly",
    "matplotlib",
    "pyarrow",
    "joblib",
    "asyncio",
    "sqlalchemy",
    "zenoh",
    "psutil",
    "cryptography",
    "structlog",
}
# The rooms, innermost first: each may import those before it.
LAYERS: list[str] = []
for rooms in (
    "base model predict energy",
    "estimate select pipeline recording detectors wire settings store",
    "simulate camera evaluate calibrate events edge output site",
    "cli __main__",
):
    LAYERS += rooms.split()
# The pure part: numpy, scipy and the standard library only.
PURE = (
    "model.camera", "model.distortion", "model.projection", "model.rigs", "model.pose",
    "model.skeleton", "model.noise", "model.noises", "model.slot_record", "model.uncertainty",
    "estimate", "estimate.base", "estimate.filter", "estimate.filter.step",
    "estimate.per_slot.fuse", "predict", "select",
    "estimate.per_slot.estimator", "select.policies", "select.expected_information",
    "select.occlusion",
    "select.motion_2d", "select.expected_information",
    "select.camera_order", "select.failure_detector", "select.feedback", "model.expected",
    "energy.queues",
    "energy.budgets", "energy.site_energy", "estimate.smooth", "model.take", "pipeline",
    "recording.record",
    "evaluate.metrics", "wire.codec", "wire.offset", "base.clock", "edge.lead", "edge.camera_state",
)  # fmt: skip
PURE_IN_LAB = ("prediction.motion", "prediction.scores", "prediction.tally")
SOURCE = PACKAGES[PRODUCT]
# What a text could import of the others: the package, and scripts beside it.
FOREIGN = {
    package: {package, "benchmarks", *(path.stem for path in folder.glob("benchmarks/*.py"))}
    for package, folder in FOLDERS.items()
}
# Files of the product that name the package of another, to say what to install or who reads them.
NAMED = {
    "e3pose_hub": {"distributions.py"},
    "e3pose_lab": {"distributions.py", "trainer.py", "attention_lstm.py", "weights_file.py"},
}


def room_of(module: str) -> str:
    """Return the first name below the package."""
    return module.split(".")[1] if "." in module else module


def imports(path: Path) -> Iterator[str]:
    """Yield the modules of this project that a file imports, in functions too."""
    yield from (name for name in all_imports(nodes(path)) if name.startswith("e3pose."))


def all_imports(tree: Iterable[ast.AST]) -> list[str]:
    """Return all modules that the nodes of a tree import."""
    found = list[str]()
    for node in tree:
        if isinstance(node, ast.ImportFrom) and node.module:
            found.append(node.module)
        elif isinstance(node, ast.Import):
            found += [name.name for name in node.names]
    return found


def foreign(tree: Iterable[ast.AST], package: str) -> list[str]:
    """Return what the nodes of a tree import of a distribution beside the product."""
    return [name for name in all_imports(tree) if name.partition(".")[0] in FOREIGN[package]]


def climbs(room: str, names: Iterable[str]) -> list[str]:
    """Return which of the imported modules lie in rooms further out."""
    allowed = {*LAYERS[: LAYERS.index(room) + 1]}
    return [n for n in names if room_of(n) not in allowed]


@functools.cache
def loaded_by(*modules: str) -> list[set[str]]:
    """Return what a fresh interpreter loads for each of some modules, imported in this order.

    Returns:
        The top-level and e3pose modules that are there after each import and were not before.
    """
    code = (
        "import importlib, json, sys\nloaded, before = [], set()\n"
        "for name in sys.argv[1:]:\n"
        "    importlib.import_module(name)\n"
        "    loaded.append(sorted({*sys.modules} - before))\n"
        "    before = {*sys.modules}\n"
        "print(json.dumps(loaded))"
    )
    output = subprocess.run(
        [sys.executable, "-c", code, *modules], capture_output=True, text=True, check=True
    ).stdout
    return [set(names) for names in json.loads(output)]


PURE_MODULES = (
    "e3pose", *(f"e3pose.{name}" for name in PURE), *(f"e3pose_lab.{name}" for name in PURE_IN_LAB),
)  # fmt: skip


@each_case("module", PURE_MODULES)
def test_pure_module_imports_nothing_heavy(module: str) -> None:
    """All of them share an interpreter: what is heavy shows at the first that needs it."""
    assert HEAVY & loaded_by(*PURE_MODULES)[PURE_MODULES.index(module)] == set()


def test_every_room_has_its_place() -> None:
    rooms = {path.relative_to(SOURCE).parts[0].removesuffix(".py") for path in SOURCE.rglob("*.py")}
    assert rooms - {"__init__"} == set(LAYERS)


@each_case("room", LAYERS)
def test_imports_point_inward(room: str) -> None:
    place = SOURCE / room
    files = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    wrong = {str(f.relative_to(SOURCE)): climbs(room, imports(f)) for f in files}
    assert {file: names for file, names in wrong.items() if names} == {}


@each_case("other", FOLDERS)
def test_the_product_imports_nothing_of_the_others(other: str) -> None:
    paths = [*SOURCE.rglob("*.py")]
    assert len(paths) > 300
    assert {str(path): names for path in paths if (names := foreign(nodes(path), other))} == {}
    assert {path.name for path in paths if other in path.read_text()} <= NAMED[other]


@each_case("package, other", itertools.permutations(FOLDERS, 2))
def test_hub_and_lab_import_nothing_of_each_other(package: str, other: str) -> None:
    paths = PACKAGES[package].rglob("*.py")
    assert {str(path): names for path in paths if (names := foreign(nodes(path), other))} == {}


def test_guard_bites_on_a_shell() -> None:
    pure, shell = loaded_by("e3pose.pipeline", "e3pose.base.dispatcher")
    assert HEAVY & pure == set() and "numba" in HEAVY & shell


def circles(imported: Mapping[str, Iterable[str]]) -> list[set[str]]:
    """Return the groups of modules that import each other, directly or not.

    Args:
        imported: each module, and those that it imports.
    """
    reach: dict[str, set[str]] = {}
    for module in imported:
        left, found = [module], set[str]()
        while left:
            for name in set(imported.get(left.pop(), ())) - found:
                found.add(name)
                left.append(name)
        reach[module] = found
    return [
        {module, *(other for other in found if module in reach.get(other, ()))}
        for module, found in reach.items()
        if module in found
    ]


def modules_of(path: Path) -> set[str]:
    """Return the modules of this project that a file imports names or submodules from."""
    imports = (n for n in nodes(path) if isinstance(n, ast.Import | ast.ImportFrom))
    return {name for node in imports for name in named(node) if name.startswith("e3pose")}


def test_no_modules_import_each_other() -> None:
    """Laws and kernels, settings and what reads them: neither can be read without the other."""
    names = {name: path for name, path in FILES.items() if path.name != "__init__.py"}
    assert circles({name: modules_of(path) - {name} for name, path in names.items()}) == []


HELP = """
import sys
from e3pose.cli import main
for words in ([], *([verb] for verb in sys.argv[1:])):
    try:
        main([*words, "--help"])
    except SystemExit:
        pass
    print("\\nLOADED", words, *{name for name in sys.modules if "." not in name})
"""


def test_help_needs_no_extra() -> None:
    """A camera shows the help of all verbs; what they need is imported where they do it."""
    said = subprocess.run(
        [sys.executable, "-c", HELP, *VERBS], capture_output=True, text=True, check=True
    ).stdout
    loaded = {
        words: set(names.split())
        for words, names in re.findall(r"^LOADED (\[.*?\]) (.*)$", said, re.M)
    }
    assert len(loaded) == len(VERBS) + 1 and "cyclopts" in loaded["[]"]
    heavy = {words: (HEAVY - {"asyncio"} | {"scipy"}) & names for words, names in loaded.items()}
    assert {words: names for words, names in heavy.items() if names} == {}


def top_level(path: Path) -> tuple[set[str], list[set[str]]]:
    """Return what a file imports at its top, and what each import in its functions does."""
    top, inside = set[str](), list[set[str]]()

    def look(node: ast.AST, in_function: bool) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, (ast.Import, ast.ImportFrom)):
                (inside.append if in_function else top.update)(set(named(child)))
            look(child, in_function or isinstance(child, FUNCTIONS))

    look(nodes(path)[0], False)
    return top, inside


def named(node: ast.Import | ast.ImportFrom) -> Iterator[str]:
    """Yield the modules that a statement loads; names that a room defers, where they are."""
    for name in node.names:
        if isinstance(node, ast.Import):
            yield name.name
        else:
            home = DEFERRED.get(str(node.module), {}).get(name.name, name.name)
            inner = f"{node.module}.{home}"
            yield inner if inner in FILES else str(node.module)


FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
FILES = {
    ".".join(path.relative_to(folder.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for folder in (SOURCE, PACKAGES["e3pose_hub"])
    for path in folder.rglob("*.py")
}
DEFERRED = {
    name: vars(importlib.import_module(name))["_HOMES"] for name in ("e3pose", "e3pose.store")
}
# What every install has; `e3pose.cli` loads rich for help.
EVERYWHERE = {"numpy", "cyclopts", "msgspec", "rich", "platformdirs", "tomli", "tomli_w"}


def packages(module: str, top: Mapping[str, set[str]]) -> set[str]:
    """Return the other packages that a module needs to be imported."""
    left, seen = [module], set[str]()
    while left:
        name = left.pop()
        if name not in seen:
            seen.add(name)
            left += top.get(name, ())
            left += [name.rpartition(".")[0]] if "." in name and name in FILES else []
    roots = {name.partition(".")[0] for name in seen}
    return roots - EVERYWHERE - {*PACKAGES, ""} - sys.stdlib_module_names


def test_functions_import_only_what_needs_an_extra() -> None:
    looked = {name: top_level(path) for name, path in FILES.items()}
    top = {name: found for name, (found, _) in looked.items()}
    needless = [
        (name, wanted)
        for name, (_, inside) in looked.items()
        for wanted in inside
        if not {name.partition(".")[0] for name in wanted} <= sys.stdlib_module_names
        and set().union(*(packages(w, top) for w in wanted)) <= packages(name, top)
    ]
    assert needless == []


SITE = """
format = "e3pose-site"
version = 1
name = "lab"
calibration = "rig.toml"
skeleton = "coco17"
fps = 20
[link]
endpoint = "tcp/127.0.0.1:7447"
[loop]
predictor = "zero-velocity"
[[camera]]
id = "cam0"
source = "usb:0"
[[camera]]
id = "cam1"
source = "usb:1"
"""
CHECK = """
import sys
import e3pose.site.camera_program
from e3pose.settings.resolved import resolve_site
from e3pose.site.edge_program import check_edge
site = resolve_site(sys.argv[1])
check_edge(site)
print(len(site.rig))
print(*sorted(m for m in sys.modules if "." not in m))
"""


def test_check_of_a_site_loads_no_compiler_and_no_database(tmp_path: Path) -> None:
    """So `check`, and the parent of all processes of `up`, start in a third of the time."""
    size, K, pose = (640, 480), np.diag([500.0, 500.0, 1.0]), np.eye(4)
    save_rig(
        Rig(tuple(Camera(name, size, K, pose) for name in ("cam0", "cam1"))), tmp_path / "rig.toml"
    )
    (tmp_path / "site.toml").write_text(SITE)
    command = [sys.executable, "-c", CHECK, str(tmp_path / "site.toml")]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    cameras, loaded = output.splitlines()
    assert cameras == "2"
    assert {"numba", "scipy", "sqlalchemy", "cv2", "onnxruntime"} & set(loaded.split()) == set()


def test_benchmarks_replace_only_what_is_there() -> None:
    """`patch.object(module, "name")` is a string to types, and benchmarks run rarely."""
    missing = []
    for path in sorted((ROOT / "lab").rglob("*.py")):
        modules = {
            alias.asname or alias.name: f"{node.module}.{alias.name}"
            for node in nodes(path)
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("e3pose")
            for alias in node.names
        }
        for node in nodes(path):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("patch.object"):
                owner, name = map(ast.unparse, node.args[:2])
                if owner in modules:
                    room, _, last = modules[owner].rpartition(".")
                    found = getattr(importlib.import_module(room), last, None)
                    found = found or importlib.import_module(modules[owner])
                    if not hasattr(found, ast.literal_eval(name)):
                        missing.append(f"{path.name}: {owner}.{name}")
    assert not missing


def test_public_names_are_listed_and_there() -> None:
    names = dir(e3pose)
    assert "replay" in names and "annotations" not in names and "importlib" not in names
    assert all(hasattr(e3pose, name) for name in names)


def test_a_recording_shows_itself_in_a_line() -> None:
    shown = repr(simulate(SceneSettings(people=1, seconds=1.0, fps=10, cameras=2), 0))
    assert len(shown) < 100 and "\n" not in shown
    assert re.fullmatch(r"<Recording '.+': 2 cameras, 10 slots at 10 fps, truth of \d+>", shown)


BOUNDS: dict[str, dict[str, int]] = read(ROOT, "house.toml")
MOST_FUNCTION_LINES = 76  # with its signature, without its docstring: verbs have long help


def lines_of_docstring(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    said = node.body[0]
    known = ast.get_docstring(node, clean=False) is not None
    return (said.end_lineno or 0) - said.lineno + 1 if known else 0


def test_functions_are_short() -> None:
    found = {
        f"{path} {node.name}": (node.end_lineno or 0) - node.lineno + 1 - lines_of_docstring(node)
        for folder in PACKAGES.values()
        for path in folder.rglob("*.py")
        for node in nodes(path)
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    }
    assert len(found) > 1000
    assert {name: n for name, n in found.items() if n > MOST_FUNCTION_LINES} == {}


@each_case("part", BOUNDS)
def test_the_house_keeps_to_its_bounds(part: str) -> None:
    bounds = BOUNDS[part]
    found = {"lines": lines(ROOT / part)} if list(bounds) == ["lines"] else measure(ROOT / part)
    over = {
        key: f"{found[key]}, at most {most}" for key, most in bounds.items() if found[key] > most
    }
    assert over == {}, "remove as much as you add, see CONTRIBUTING.md"


def test_every_part_of_the_house_has_a_bound() -> None:
    assert BOUNDS.keys() == set(PARTS)


COMMAND = re.compile(r"e3pose [a-z]+ [^`;]*$")
# What stands in a command without quotes: ids, names of models and options, numbers.
SAFE = re.compile(
    r"camera_id|camera\.camera_id|node\.camera|self\.camera_id|name|site(\.file\.name)?|option|words|"
    r"wanted|width|axis|kind|seconds|made|network|more|height|rig|walk|detector|choice\.name|options|"
    r"asked\.what|[A-Z_]+(\[.*\])?|files|shell\(.*|setup\.shown\(.*|quote\(.*|' '\.join\(.*"
)


def texts(path: Path) -> list[ast.JoinedStr]:
    """Return the texts with values of a file."""
    return [node for node in nodes(path) if isinstance(node, ast.JoinedStr)]


def printed(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the values that stand in commands of a file, and their lines."""
    for node in texts(path):
        before = ""
        for part in node.values:
            if isinstance(part, ast.Constant):
                before += str(part.value)
            elif isinstance(part, ast.FormattedValue):
                if COMMAND.search(before):
                    yield node.lineno, ast.unparse(part.value)
                before += "x"


def test_paths_in_printed_commands_are_quoted() -> None:
    """Commands that are printed can be pasted."""
    found = [
        (f"{path.relative_to(SOURCE)}:{line}", value)
        for path in sorted(SOURCE.rglob("*.py"))
        for line, value in printed(path)
    ]
    assert [each for each in found if not SAFE.fullmatch(each[1])] == []
    assert sum(value.startswith("shell(") for _, value in found) > 15


def test_a_calibration_from_people_that_is_printed_states_their_height() -> None:
    """Without it all sizes may be 6 % off."""
    found = (node for path in SOURCE.rglob("*.py") for node in texts(path))
    all_texts = [ast.unparse(node) for node in found if "update" in ast.dump(node)]
    asked = [text for text in all_texts if re.search("calibrate extrinsics .*--update", text)]
    assert len(asked) >= 6 and [text for text in asked if "height" not in text] == []


# What runs at a site, and the hub.
AT_SITES = {
    str(path.relative_to(SOURCE if at == SOURCE else at.parent)): path
    for at in (SOURCE, PACKAGES["e3pose_hub"])
    for path in at.rglob("*.py")
}
# The rooms for what differs, and what each file that names a place of Linux does elsewhere.
ASKS = {"base/system.py", "base/child_process.py"}
PLACES = {
    "base/threads.py": "names no thread",
    "camera/probe.py": "finds no device, and no state to suspend to",
    "detectors/chooser.py": "finds no GPU of a Jetson",
    "detectors/weights/index.py": "finds no settings of pip",
    "settings/limits.py": "a message",
    "site/check/camera.py": "a message",
    "site/new_site.py": "a message",
}
LINUX_ONLY = {"fcntl", "grp", "pwd", "resource", "termios", "tty", "pty", "syslog", "msvcrt"}
# Encodings as on Windows: a text of ours that leaves its own open is an error.
WARNINGS = "filterwarnings=\nignore::EncodingWarning\nerror::EncodingWarning:e3pose\\..*"
TESTS = ("tests/base/test_lock.py", "tests/recording/test_writer.py", "tests/edge/test_server.py")
CHOSEN = "lock or writ or record or people_are_published or goes_on_where_it_was"


def asked(tree: Iterable[ast.AST]) -> Iterator[str]:
    """Yield what a file asks of the platform: modules of one system, and which system it is."""
    for node in tree:
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names if name.name in LINUX_ONLY)
        elif isinstance(node, ast.ImportFrom) and node.module in LINUX_ONLY:
            yield str(node.module)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            name = f"{node.value.id}.{node.attr}"
            if name in ("sys.platform", "os.name", "platform.system"):
                yield name
        elif isinstance(node, ast.keyword) and node.arg in ("start_new_session", "preexec_fn"):
            yield str(node.arg)


def places(path: Path) -> list[str]:
    """Return the texts that begin with or hold a path only Linux has."""
    values = (node.value for node in nodes(path) if isinstance(node, ast.Constant))
    roots = ("/dev/", "/proc/", "/sys/", "/etc")
    return [one for one in values if isinstance(one, str) and any(r in one for r in roots)
            and "\n" not in one]  # fmt: skip


def test_the_platform_is_asked_in_its_rooms_alone() -> None:
    found = {file: [*asked(nodes(path))] for file, path in AT_SITES.items()}
    assert {file for file, names in found.items() if names} == ASKS
    text = "import fcntl\nPopen(x, preexec_fn=f)\nsys.platform"
    assert sorted(asked(ast.walk(ast.parse(text)))) == ["fcntl", "preexec_fn", "sys.platform"]


def test_places_of_linux_are_named_where_they_may_be_missing() -> None:
    found = {file: places(path) for file, path in AT_SITES.items()}
    assert {file for file, texts in found.items() if texts} == {*PLACES}


@pytest.mark.nightly
@pytest.mark.parametrize("system", ["darwin", "win32"])
def test_recordings_locks_and_an_edge_work_without_what_it_lacks(system: str) -> None:
    words = ("-q", "-o", WARNINGS, "-p", "tests.other_system", "-p", "no:cacheprovider")
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", *words, "-k", CHOSEN, *TESTS],
        env={**os.environ, "OTHER_SYSTEM": system, "PYTHONWARNDEFAULTENCODING": "1"},
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr[-1000:]


ROOMS = sorted(
    path for package in PACKAGES.values() for path in package.iterdir() if path.name != "py.typed"
)
LISTED = re.compile(r"^(?:Args|Attributes):\n((?:    .*\n|\n)+)", re.M)
NAME = re.compile(r"^    \*{0,2}(\w+):", re.M)
RIDDLE = re.compile(r"^(What|Who|Whose|Those)\b|\b[Rr]eturn (what|who|whose)\b|\bthose who\b")
QUOTED = re.compile(r"`(?:[a-z_]+\.)*([A-Z]?[a-z]+(?:_[a-z]+)+|(?:[A-Z][a-z]+)+)`")
Documented = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def listed(node: Documented) -> set[str]:
    """Return the names that the docstring of a function or a class explains."""
    sections = LISTED.findall(f"{ast.get_docstring(node) or ''}\n")
    return {name for section in sections for name in NAME.findall(section)}


def existing(node: Documented) -> set[str]:
    """Return the arguments of a function, or the fields, properties and arguments of a class."""
    if not isinstance(node, ast.ClassDef):
        every = ast.walk(node.args)
        return {each.arg for each in every if isinstance(each, ast.arg)}
    found = {each.target.id for each in node.body if isinstance(each, ast.AnnAssign)
             and isinstance(each.target, ast.Name)}  # fmt: skip
    for method in node.body:
        if isinstance(method, ast.FunctionDef):
            found |= {method.name} | (existing(method) if method.name == "__init__" else set())
            found |= {
                each.attr
                for each in ast.walk(method)
                if isinstance(each, ast.Attribute) and isinstance(each.ctx, ast.Store)
            }
    return found


@each_case("room", ROOMS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_docstrings_list_what_exists(room: Path) -> None:
    stale = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.name}: {name}"
        for path in (sorted(room.rglob("*.py")) if room.is_dir() else [room])
        for node in nodes(path)
        if isinstance(node, Documented)
        for name in sorted(listed(node) - existing(node))
    ]
    assert not stale, "\n".join(stale)


OURS = [path for place in (SOURCE, *FOLDERS.values()) for path in sorted(place.rglob("*.py"))]


def docstrings() -> Iterator[str]:
    """Yield the docstrings of product, hub and lab, each after its file."""
    for path in OURS:
        for node in nodes(path):
            if isinstance(node, Documented | ast.Module) and (text := ast.get_docstring(node)):
                yield f"{path.relative_to(ROOT)}: {text}"


def test_first_lines_name_what_they_are_about() -> None:
    firsts = [text.splitlines()[0] for text in docstrings()]
    assert len(firsts) > 5000
    riddles = [line for line in firsts if RIDDLE.search(line.split(": ", 1)[1])]
    assert not riddles, "\n".join(riddles)


def test_docstrings_name_what_is_there() -> None:
    def names(paths: Iterable[Path]) -> set[str]:
        code = "\n".join(re.sub("`[^`]*`", "", path.read_text()) for path in paths)
        return set(re.findall(r"\w+", code)) | {"GraphProto", "wrist_l"}  # of others' files

    every, product = names(OURS), names(SOURCE.rglob("*.py"))
    named = [(text, name) for text in docstrings() for name in QUOTED.findall(text)]
    stale = [
        f"{text.splitlines()[0]}: {name}"
        for text, name in named
        if name not in (product if text.startswith("src/") else every)
    ]
    assert len(named) > 500 and not stale, "\n".join(stale)


def test_guards_see_what_they_look_for() -> None:
    def found(text: str, package: str) -> list[str]:
        return foreign(ast.walk(ast.parse(text)), package)

    assert found("import e3pose_lab.train\nimport bench_step", "e3pose_lab") == [
        "e3pose_lab.train", "bench_step",
    ]  # fmt: skip
    assert found("from e3pose_hub import page", "e3pose_hub") == ["e3pose_hub"]
    assert found("from e3pose.site import page\nimport settings", "e3pose_hub") == []
    assert climbs("model", ["e3pose.select.policies.base"]) == ["e3pose.select.policies.base"]
    assert climbs("select", ["e3pose.model.pose"]) == []
    assert circles({"a": ["b"], "b": ["c"], "c": ["b"]}) == [{"b", "c"}, {"b", "c"}]
    assert circles({"a": ["b"], "b": ["c"]}) == []
    stale = ("def f(a: int) -> None:", '"""Do.', "", "Args:", "    a: one.", "    b: two.", '"""')
    (node,) = ast.parse("\n    ".join(stale)).body
    assert isinstance(node, ast.FunctionDef)
    assert listed(node) - existing(node) == {"b"}
