"""Before `make test`: compile the kernels once, and leave out rooms that have not changed.

    python -m tests.prepare FILE [--all]

writes to a file what pytest is to ignore. A room of `ROOMS` is tested when one of its files, the
model, or a module that its files import differs from the commit where this branch left
`origin/main` (or `main`; BASE=COMMIT names another one), in the working tree as well. Where no such
commit is known, everything is tested.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
KERNELS = ROOT / ".pytest_cache" / "kernels"  # the sources that were compiled last

# The loop of an estimator, over a few slots.
COMPILE = """
import sys
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.simulate import SceneSettings, simulate
recording = simulate(SceneSettings(people=2, seconds=0.5, cameras=3), 0)
for policy in ("information", "independent"):  # these two use all kernels of selection
    list(replay(recording, ReplaySettings(pipeline=sys.argv[1], policy=policy, num_selected=3)))
"""

ALWAYS = ("src/e3pose/model/", "pyproject.toml", "tests/conftest.py", "tests/prepare.py")
# No other room imports these, or little of them: their tests, and their other files.
ROOMS = {
    "lab": (("tests/lab/", "tests/live/test_reproduced_sites.py"), ("lab/",)),
    "hub": (
        ("tests/hub/", "tests/live/test_hub_bad_link.py", "tests/live/test_hub_page.py"),
        ("hub/",),
    ),
    "calibrate": (("tests/calibrate/",), ("src/e3pose/calibrate/",)),
}
ENDS = (".py", "/__init__.py")


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
def imported(places: tuple[str, ...]) -> frozenset[str]:
    """Return the files of this project that the modules of some places import, directly."""
    names: set[str] = set()
    for path in (
        path for place in places for path in [ROOT / place, *(ROOT / place).rglob("*.py")]
    ):
        if path.suffix == ".py" and path.is_file():
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    names |= {one.name for one in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                    names |= {node.module, *(f"{node.module}.{one.name}" for one in node.names)}
    found = [name.replace(".", "/") for name in names if name.startswith(("e3pose.", "tests."))]
    return frozenset(f"{top}{name}{end}" for name in found for top in ("", "src/") for end in ENDS)


def unchanged(differ: set[str]) -> list[str]:
    """Return the names of the rooms that nothing which differs touches."""
    found = []
    for name, (tests, sources) in ROOMS.items():
        places = (*tests, *sources)
        own = any(one.startswith((*places, *ALWAYS)) for one in differ)
        if not own and not differ & imported(places):
            found.append(name)
    return found


def compile_kernels() -> None:
    """Compile every kernel to disk: the filter, which takes longest, beside most of the others."""
    from e3pose.base.kernel_cache import stamp_of
    from e3pose.evaluate import replay

    stamp = str(stamp_of(Path(replay.__file__).resolve()))
    if KERNELS.is_file() and KERNELS.read_text() == stamp:
        return
    commands = [[sys.executable, "-c", COMPILE, pipeline] for pipeline in ("default", "paper")]
    for program in [subprocess.Popen(command) for command in commands]:
        if program.wait() != 0:
            sys.exit("the kernels do not compile")
    KERNELS.parent.mkdir(exist_ok=True)
    KERNELS.write_text(stamp)


def main() -> None:
    """See the module."""
    since = None if "--all" in sys.argv else base()
    left_out = unchanged(changed(since)) if since else []
    for name in left_out:
        print(f"tests of {name}: left out, as nothing they test differs from {str(since)[:12]}")
    ignored = [f"--ignore={place.rstrip('/')}" for name in left_out for place in ROOMS[name][0]]
    Path(sys.argv[1]).write_text("".join(f"{one}\n" for one in ignored))
    compile_kernels()


if __name__ == "__main__":
    main()
