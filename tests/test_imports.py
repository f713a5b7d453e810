"""What modules import and show."""

from __future__ import annotations

import ast
import functools
import importlib
import itertools
import json
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
from tests.cases import each_case
from tests.distributions import FOLDERS, PACKAGES, PRODUCT

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
    yield from (name for name in all_imports(path.read_text()) if name.startswith("e3pose."))


@functools.cache
def statements(text: str) -> list[ast.Import | ast.ImportFrom]:
    """Return all imports of a text."""
    return [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Import | ast.ImportFrom)]


def all_imports(text: str) -> list[str]:
    """Return all modules that a text imports."""
    found = list[str]()
    for node in statements(text):
        if isinstance(node, ast.ImportFrom) and node.module:
            found.append(node.module)
        elif isinstance(node, ast.Import):
            found += [name.name for name in node.names]
    return found


def foreign(text: str, package: str) -> list[str]:
    """Return what a text imports of a distribution beside the product."""
    return [name for name in all_imports(text) if name.partition(".")[0] in FOREIGN[package]]


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
    texts = {path: path.read_text() for path in SOURCE.rglob("*.py")}
    assert len(texts) > 300
    assert {
        str(path): names for path, text in texts.items() if (names := foreign(text, other))
    } == {}
    assert {path.name for path, text in texts.items() if other in text} <= NAMED[other]


@each_case("package, other", itertools.permutations(FOLDERS, 2))
def test_hub_and_lab_import_nothing_of_each_other(package: str, other: str) -> None:
    texts = {str(path): path.read_text() for path in PACKAGES[package].rglob("*.py")}
    assert {path: names for path, text in texts.items() if (names := foreign(text, other))} == {}


def test_an_import_of_another_distribution_is_seen() -> None:
    assert (
        len(foreign("from e3pose_lab.train.online import main\nimport bench_step", "e3pose_lab"))
        == 2
    )
    assert foreign("from e3pose_hub import page", "e3pose_hub") == ["e3pose_hub"]
    assert foreign("from e3pose.site import page\nimport settings", "e3pose_hub") == []


def test_a_climb_is_seen() -> None:
    assert climbs("model", ["e3pose.select.policies.base"]) == ["e3pose.select.policies.base"]
    assert climbs("select", ["e3pose.model.pose"]) == []


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
    found = (named(node) for node in statements(path.read_text()))
    return {name for names in found for name in names if name.startswith("e3pose")}


def test_no_modules_import_each_other() -> None:
    """Laws and kernels, settings and what reads them: neither can be read without the other."""
    names = {name: path for name, path in FILES.items() if path.name != "__init__.py"}
    assert circles({name: modules_of(path) - {name} for name, path in names.items()}) == []


def test_a_circle_is_seen() -> None:
    assert circles({"a": ["b"], "b": ["c"], "c": ["b"]}) == [{"b", "c"}, {"b", "c"}]
    assert circles({"a": ["b"], "b": ["c"]}) == []


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

    look(ast.parse(path.read_text()), False)
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


def test_public_names_are_listed_and_there() -> None:
    names = dir(e3pose)
    assert "replay" in names and "annotations" not in names and "importlib" not in names
    assert all(hasattr(e3pose, name) for name in names)


def test_a_recording_shows_itself_in_a_line() -> None:
    shown = repr(simulate(SceneSettings(people=1, seconds=1.0, fps=10, cameras=2), 0))
    assert len(shown) < 100 and "\n" not in shown
    assert re.fullmatch(r"<Recording '.+': 2 cameras, 10 slots at 10 fps, truth of \d+>", shown)
