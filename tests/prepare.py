"""Before `make test`: compile the kernels once, and leave out tests of what has not changed.

    python -m tests.prepare FILE [--all]

writes to a file which tests pytest is to ignore. A file of tests runs when it, or a module that it
reaches by imports, differs from the commit where this branch left `origin/main` (or `main`;
BASE=COMMIT names another one), in the working tree as well. What starts a program reaches
everything; tests of hub and lab run for what is theirs. Where no such commit is known, or nothing
differs from it, as in a fresh clone, everything is tested.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
KERNELS = ROOT / ".pytest_cache" / "kernels"  # the sources that were compiled last

# The loop of an estimator, over a few slots; then what tests of several processes would compile.
COMPILE = """
import sys
import numpy as np
from e3pose.calibrate.triangulation import place_points
from e3pose.estimate.smooth.delayed import Delayed
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.simulate import SceneSettings, simulate
recording = simulate(SceneSettings(people=2, seconds=0.5, cameras=3), 0)
for policy in ("information", "independent"):  # these two use all kernels of selection
    list(replay(recording, ReplaySettings(pipeline=sys.argv[1], policy=policy, num_selected=3)))
if sys.argv[1] == "paper":  # which ends long before the filter
    place_points(recording.rig, np.ones((3, 1, 2)), np.ones((3, 1)))
    Delayed(recording.skeleton, 3).warm_up()
"""

# A change here concerns every test.
ALWAYS = (
    "pyproject.toml",
    "requirements/",
    "tests/conftest.py",
    "tests/postgres.py",
    "tests/prepare.py",
)
# Tests of hub and lab run when these differ, or what is theirs: of the product, types tell what it
# no longer has, and `make nightly` runs them all.
APART = ("hub", "lab")
SEEN_APART = ("src/e3pose/model/", "docs/", "README.md", "examples/")
TOPS = ("", "src/", "hub/", "lab/", "lab/benchmarks/")  # where modules are found by name
OURS = r"(?:e3pose|e3pose_hub|e3pose_lab|tests)(?:\.\w+)+"
IMPORT = re.compile(
    rf"^[ ]*(?:from[ ]+([\w.]+)[ ]+import[ ]+(\([^)]*\)|[^\n]*)|import[ ]+([\w.]+))|[\"']({OURS})",
    re.MULTILINE,
)
LAZY = re.compile(
    r"^__getattr__ = names_of\(", re.MULTILINE
)  # a package that imports what it has when it is used
BY_NAME = re.compile(r"\bimport_module\(f")  # imports modules of its folder by their names
WORD = re.compile(r"\w+")
RUNS_ALL = re.compile(
    r"\"-m\", \"e3pose\"|e3pose\.cli\b"
)  # starts programs of ours, or has all verbs
# Of tests: starts programs, or reads pages, examples, or the source.
READS_ALL = re.compile(
    r"sys\.executable|tests\.distributions|ROOT /|(?:\)|HERE)\.parents\[|docs/|README|examples/"
)


def git(*words: str) -> str | None:
    """Return what git prints, or None where it fails."""
    ended = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    return ended.stdout.strip() if ended.returncode == 0 else None


def base() -> str | None:
    """Return the commit to compare with, if one is known."""
    if os.environ.get("BASE"):
        return git("rev-parse", "--verify", f"{os.environ['BASE']}^{{commit}}")
    main = "main" if git("rev-parse", "--abbrev-ref", "HEAD") != "main" else None
    for branch in ("origin/main", main):
        found = branch and git("merge-base", "HEAD", branch)
        if found:
            return found
    return None


def changed(since: str) -> set[str]:
    """Return the files that differ from a commit, with those that git does not know yet."""
    tracked = git("diff", "--name-only", "--no-renames", since)
    new = git("ls-files", "--others", "--exclude-standard")
    assert tracked is not None and new is not None
    return {*tracked.splitlines(), *new.splitlines()}


@cache
def modules() -> frozenset[str]:
    """Return all Python files of the project, by their paths in it."""
    tops = (ROOT / top for top in ("src", "hub", "lab", "tests", "examples"))
    found = (path for top in tops for path in top.rglob("*.py") if ".venv" not in path.parts)
    return frozenset(path.relative_to(ROOT).as_posix() for path in found)


def files_of(name: str) -> set[str]:
    """Return the files that run when a module is imported: its own, and those of its packages."""
    parts = name.split(".")
    paths = ("/".join(parts[: n + 1]) for n in range(len(parts)))
    ends = (f"{path}{end}" for path in paths for end in (".py", "/__init__.py"))
    return {f"{top}{end}" for end in ends for top in TOPS} & modules()


@cache
def text_of(path: str) -> str:
    """Return the text of a file of the project."""
    return (ROOT / path).read_text()


@cache
def named(path: str) -> frozenset[str]:
    """Return the files that a file imports, or names as a string."""
    found = set[str]()
    for home, names, module, said in IMPORT.findall(text_of(path)):
        asked, package = {*WORD.findall(names)}, home or module
        for name in (package or said, *(f"{home}.{one}" for one in asked)):
            found |= files_of(name)
        lazy = {f"{top}{package.replace('.', '/')}/__init__.py" for top in TOPS} & modules()
        for one in lazy - {path}:
            if LAZY.search(text_of(one)):
                found |= homes_of(one, asked)
    return frozenset(found)


def homes_of(package: str, asked: set[str]) -> set[str]:
    """Return the files that have what is asked of a lazy package; without names, of all it has."""
    homes = IMPORT.findall(text_of(package))
    chosen = (home for home, names, *_ in homes if not asked or asked & {*WORD.findall(names)})
    return {file for home in chosen for file in files_of(home)}


@cache
def imported(path: str) -> frozenset[str]:
    """Return the files that run when a file does."""
    text, folder = text_of(path), path.rpartition("/")[0]
    found = files_of("e3pose.base.deferred") if LAZY.search(text) else {*named(path)}
    if BY_NAME.search(text):
        found |= {one for one in modules() if one.rpartition("/")[0] == folder}
    while folder.startswith("tests/"):
        found |= {f"{folder}/conftest.py"} & modules()
        folder = folder.rpartition("/")[0]
    return frozenset(found)


@cache
def reaches_all(path: str) -> bool:
    """Return whether a file runs or reads what its imports do not tell."""
    text = text_of(path)
    if LAZY.search(text):  # runs what is asked of it, see `named`
        return False
    return bool(RUNS_ALL.search(text) or (path.startswith("tests/") and READS_ALL.search(text)))


def reached(path: str) -> set[str] | None:
    """Return what a file of tests reaches by imports, with itself; None for everything."""
    found, new = set[str](), {path}
    while new:
        found |= new
        if any(reaches_all(one) for one in new):
            return None
        new = {other for one in new for other in imported(one)} - found
    return found


def concerning(path: str, differ: set[str]) -> set[str]:
    """Return what of a difference a file of tests is run for."""
    room = path.split("/")[1]
    if room not in APART:
        return differ
    return {one for one in differ if one.startswith((f"{room}/", f"tests/{room}/", *SEEN_APART))}


def beside(path: str) -> set[str]:
    """Return the modules in, or below, the nearest folder with modules, of a file that is none."""
    folder = path.rpartition("/")[0]
    while folder and not any(one.rpartition("/")[0] == folder for one in modules()):
        folder = folder.rpartition("/")[0]
    return {one for one in modules() if folder and one.startswith(f"{folder}/")}


def unchanged(differ: set[str]) -> list[str]:
    """Return the files of tests that reach nothing which differs; those of no room always run."""
    if not differ or any(one.startswith(ALWAYS) for one in differ):
        return []
    differ = differ.union(*(beside(one) for one in differ - modules()))
    tests = sorted(one for one in modules() if re.fullmatch(r"tests/.+/test_\w+\.py", one))
    concerned = {one: concerning(one, differ) for one in tests}
    return [one for one in tests if not concerned[one] & (reached(one) or differ)]


def compile_kernels() -> None:
    """Compile every kernel to disk: the filter, which takes longest, beside most of the others."""
    from e3pose.base.kernel_cache import stamp_of
    from e3pose.evaluate import replay

    stamp = str(stamp_of(Path(replay.__file__).resolve()))
    if KERNELS.is_file() and KERNELS.read_text() == stamp:
        return
    commands = [[sys.executable, "-c", COMPILE, pipeline] for pipeline in ("memory", "paper")]
    for program in [subprocess.Popen(command) for command in commands]:
        if program.wait() != 0:
            sys.exit("the kernels do not compile")
    KERNELS.parent.mkdir(exist_ok=True)
    KERNELS.write_text(stamp)


def main() -> None:
    """See the module."""
    since = None if "--all" in sys.argv else base()
    left_out = unchanged(changed(since)) if since else []
    if left_out:
        rooms = Counter(path.split("/")[1] for path in left_out).most_common()
        said = ", ".join(f"{room} {count}" for room, count in rooms)
        print(f"left out {len(left_out)} files of tests ({said}):")
        print(f"nothing that they import differs from {str(since)[:12]}")
    Path(sys.argv[1]).write_text("".join(f"--ignore={path}\n" for path in left_out))
    compile_kernels()


if __name__ == "__main__":
    main()
