"""Run the tests against mutants, small changes to the source that a test should notice.

`make mutants` does both steps: `make_mutants.py` draws a sample, this tries it in a copy of the
project. First all tests run once, to see how long each takes and which lines it runs. Then each
mutant gets the tests that run its line, the quickest first, up to `TESTS_S` seconds of them.
Each run is a fork of this process, in which numpy, numba and pytest are imported already.

Kernels are compiled for a minute or more after each change. Tests of a changed kernel therefore run
all kernels as plain Python, and those that take longer than `PLAIN_TEST_S` then are left out. Where
no kernel is changed, the compiled ones of the project are used.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
import traceback
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

TESTS_S = 60.0  # of a core, of the tests that one mutant gets
PLAIN_TEST_S, TEST_S = 8.0, 60.0  # of a core, of one test with and without plain kernels
START_S = 30.0  # of a core, besides the tests
BROKEN = 70  # exit code of a run that did not end by itself
SILENT_S = 900.0  # on the clock, after which a run hangs
PLAIN_TESTS = (  # of kernels by themselves, and against their plain forms
    "tests/select/test_occlusion.py",
    "tests/select/test_expected_information.py",
    "tests/estimate/filter",
    "tests/estimate/per_slot",
)
MARKS = "not shared and not live and not timed and not network"
KERNEL = "\n@kernel"  # in files that declare kernels


class Stopwatch:
    """Notes how long each test takes, and ends those that take too long to set up or to run.

    Attributes:
        limit_s: of a core, for one test.
        took_s: seconds of each test that passed.
    """

    def __init__(self, limit_s: float) -> None:
        self.limit_s, self.took_s = limit_s, dict[str, float]()
        self._failed: set[str] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        begun_s = time.process_time()
        try:
            return (yield)
        finally:
            if item.nodeid not in self._failed:
                self.took_s[item.nodeid] = time.process_time() - begun_s

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self) -> Iterator[None]:
        with self._limited():
            return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self) -> Iterator[None]:
        with self._limited():
            return (yield)

    @contextmanager
    def _limited(self) -> Iterator[None]:
        """End what runs inside, and not what pytest and its plugins do around it."""

        def end(*_: object) -> None:
            raise TimeoutError(f"more than {self.limit_s} s of a core")

        signal.signal(signal.SIGPROF, end)
        signal.setitimer(signal.ITIMER_PROF, self.limit_s)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.outcome != "passed":
            self._failed.add(report.nodeid)


def copy_project(root: Path, tree: Path) -> None:
    """Copy the files of a project and its compiled kernels."""
    listed = subprocess.run(
        ["git", "-C", root, "ls-files", "-co", "--exclude-standard"],
        check=True,
        capture_output=True,
    )
    compiled = [path.relative_to(root) for path in (root / "src").rglob("*.nb[ic]")]
    shutil.rmtree(tree, ignore_errors=True)
    for path in (*map(Path, listed.stdout.decode().splitlines()), *compiled):
        if (root / path).is_file():
            (tree / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / path, tree / path)


def plain_kernels() -> None:
    """Leave kernels as they are written; before anything that has one is imported."""
    import e3pose.base.kernel as kernel
    import e3pose.base.kernel_arguments as kernel_arguments

    class Held:
        def __init__(self, values: Any) -> None:
            self.values = values

    replaced: dict[Any, dict[str, Any]] = {
        kernel: {"kernel": lambda function: function},
        kernel_arguments: {"hold": Held},
    }
    for module, names in replaced.items():
        for name, value in names.items():
            setattr(module, name, value)


def import_first(tree: Path) -> set[str]:
    """Import what every run needs; return the files whose kernels or constants are compiled."""
    os.chdir(tree)
    sys.path.insert(0, str(tree / "src"))
    os.environ["PYTHONPATH"] = str(tree / "src")
    for name in ("numba", "scipy.optimize", "scipy.spatial", "coverage", "zenoh"):
        __import__(name)
    from e3pose.base import kernel_cache

    compiled: set[Path] = set()
    for path in (tree / "src").resolve().rglob("*.py"):
        kernel_cache.stamp_of(path)  # remembered: of the unchanged files
        if KERNEL in path.read_text():
            compiled |= {*kernel_cache.sources_of(path)}
    return {str(path.relative_to(tree.resolve())) for path in compiled}


def forked(run: Callable[[], int], log: Path, limit_s: float) -> int:
    """Run a function in a fork; return its exit code, or a negative signal.

    Args:
        run: the function.
        log: where its output goes.
        limit_s: of a core, before it is killed.
    """
    child = os.fork()
    if child == 0:
        try:
            os.setpgid(0, 0)
            seconds = round(limit_s)
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
            with log.open("w") as output:
                os.dup2(output.fileno(), 1)
                os.dup2(output.fileno(), 2)
                sys.stdout = sys.stderr = output
                try:
                    code = run()
                except BaseException:
                    traceback.print_exc()
                    code = BROKEN
        except BaseException:
            code = BROKEN
        os._exit(code)
    end_s = time.monotonic() + max(SILENT_S, 3 * limit_s)
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        if time.monotonic() > end_s:
            os.killpg(child, signal.SIGKILL)
        time.sleep(0.02)
    return os.waitstatus_to_exitcode(status)


def run_tests(words: list[str], plain: bool, *plugins: object) -> int:
    """Run pytest in this process."""
    if plain:
        plain_kernels()
        words = ["-W", "ignore::RuntimeWarning", *words]
    return int(pytest.main(["-q", "-p", "no:cacheprovider", "-m", MARKS, *words], [*plugins]))


def own_tests(packages: list[str]) -> set[str]:
    """Return the tests of packages and of the loop; of one file those of its name and importers."""
    tests = {path: path.read_text() for path in Path("tests").rglob("test_*.py")}
    found = set[Path]()
    for package in packages:
        home, module = Path("tests", package), f"e3pose.{package.replace('/', '.')}"
        found |= {*home.parent.glob(f"test_{home.name}*.py")} | {*home.rglob("test_*.py")}
        if "/" in package:
            found |= {path for path, words in tests.items() if module in words}
        else:
            found |= {*Path("tests").glob("test_pipeline*.py")}
    return {*map(str, found)}


def measure(
    plain: bool, packages: list[str], out: Path
) -> tuple[dict[str, float], dict[str, dict[int, set[str]]]]:
    """Run the tests once: those of the packages and of the loop, or those of kernels.

    Returns:
        Seconds of each test that passes, and the tests that run each line of each file.
    """
    name = "plain" if plain else "-".join(packages).replace("/", ".")
    data, times = out / f"lines-{name}", out / f"times-{name}.json"
    if not times.exists():
        watch = Stopwatch(PLAIN_TEST_S if plain else TEST_S)
        tests = [*PLAIN_TESTS] if plain else sorted(own_tests(packages))

        def run() -> int:
            os.environ["COVERAGE_FILE"] = str(data)
            words = ["--cov=e3pose", "--cov-context=test", "--cov-report=", "--cov-fail-under=0"]
            code = run_tests([*words, *tests], plain, watch)
            times.write_text(json.dumps(watch.took_s))
            return code

        code = forked(run, out / f"measure-{name}.txt", 7200)
        print(f"measured the tests of {name}: exit code {code}", flush=True)
    from coverage import CoverageData

    took_s: dict[str, float] = json.loads(times.read_text())
    covered = CoverageData(str(next(iter(sorted(out.glob(f"{data.name}*"))))))
    covered.read()
    lines: dict[str, dict[int, set[str]]] = {}
    for name in covered.measured_files():
        of_file = defaultdict[int, set[str]](set)
        for line, contexts in covered.contexts_by_lineno(name).items():
            of_file[line] |= {context.partition("|")[0] for context in contexts} & took_s.keys()
        lines[str(Path(name).relative_to(Path.cwd()))] = of_file
    return took_s, lines


def statement_at(source: str, line: int) -> tuple[range, bool]:
    """Return the lines of the statement at a line, and whether it is in a function.

    Of a statement that holds others, such as `if`, these are the lines before them; of the head of
    a function, such as a default, all of its lines.
    """
    found, inside = range(line, line + 1), False

    def look(nodes: list[ast.stmt], in_function: bool) -> None:
        nonlocal found, inside
        for node in nodes:
            if not node.lineno <= line <= (node.end_lineno or node.lineno):
                continue
            bodies = [getattr(node, name, []) for name in ("body", "orelse", "finalbody")]
            bodies += [handler.body for handler in getattr(node, "handlers", [])]
            first = min((body[0].lineno for body in bodies if body), default=None)
            last = (node.end_lineno or node.lineno) + 1 if first is None else first
            is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            if line < last or first == node.lineno:
                end = (node.end_lineno or node.lineno) + 1 if is_function else last
                found = range(node.lineno, max(end, node.lineno + 1))
                inside = in_function or is_function
            for body in bodies:
                look(body, in_function or is_function)

    look(ast.parse(source).body, False)
    return found, inside


def chosen(
    lines: dict[int, set[str]], span: range, inside: bool, took_s: dict[str, float]
) -> list[str]:
    """Return the tests for a mutant: those that run its lines, or the file if it is imported."""
    tests: set[str] = set()
    for line, of_line in lines.items():
        if line in span or not inside:
            tests |= of_line
    kept, sum_s = list[str](), 0.0
    for test in sorted(tests, key=lambda test: took_s[test]):
        sum_s += took_s[test]
        if sum_s < TESTS_S or not kept:
            kept.append(test)
    return kept


def attempt(
    mutant: dict[str, Any],
    packages: list[str],
    compiled: set[str],
    out: Path,
    measured: dict[bool, Any],
) -> dict[str, Any]:
    """Return the fate of one mutant: killed, survived, or no test runs its line."""
    path = Path(mutant["path"])
    source = path.read_text()
    span, inside = statement_at(source, mutant["line"])
    plain = mutant["path"] in compiled and (KERNEL in source or not inside)
    if plain not in measured:
        measured[plain] = measure(plain, packages, out)
    took_s, lines = measured[plain]
    of_file = lines.get(mutant["path"], {})
    tests = chosen(of_file, span, inside, took_s)
    if not tests:  # runs when it is imported, or never: no test is known to need it
        tests = chosen(of_file or {mutant["line"]: {*took_s}}, span, False, took_s)
    changed = [
        f"{mutant['path']}:{number}: {after.strip()}"
        for number, (before, after) in enumerate(
            zip(source.splitlines(), mutant["source"].splitlines(), strict=False), start=1
        )
        if before != after
    ]
    row = {"change": (changed or [f"{path}:{mutant['line']}"])[0], "operator": mutant["operator"]}
    if not tests:
        return {**row, "outcome": "no test"}
    limit_s = START_S + 3 * sum(took_s[test] for test in tests)
    path.write_text(mutant["source"])
    try:
        code = forked(lambda: run_tests(["-x", *tests], plain), out / "mutant.txt", limit_s)
    finally:
        path.write_text(source)
    return {**row, "outcome": "survived" if code == 0 else "killed", "code": code}


def digest(root: Path) -> str:
    """Return a digest of all source and tests."""
    files = sorted(path for name in ("src", "tests") for path in (root / name).rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:12]


def report(rows: list[dict[str, Any]], packages: list[str]) -> None:
    """Print the score of each package and what survived."""
    print(f"{'package':<15} mutants  killed  survived  no test  score")
    for package in [*packages, "all"]:
        of_package = [row for row in rows if package in ("all", row["package"])]
        number = {
            outcome: sum(row["outcome"] == outcome for row in of_package)
            for outcome in ("killed", "survived", "no test")
        }
        score = number["killed"] / max(len(of_package), 1)
        print(f"{package:<15} {len(of_package):7}", end="")
        print(f" {number['killed']:7} {number['survived']:9} {number['no test']:8}  {score:5.0%}")
    for row in rows:
        if row["outcome"] != "killed":
            print(f"{row['outcome']}: {row['change']}  # {row['operator']}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("maker", type=Path, help="Python of an environment that has cosmic-ray")
    parser.add_argument("packages", nargs="+", help="of e3pose, such as select or edge/inbox")
    parser.add_argument("--count", type=int, default=150, help="mutants in all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=120.0, help="after which no mutant begins")
    parser.add_argument("--out", type=Path, default=Path(".mutants"), help="folder of results")
    options = parser.parse_args()
    here, end_s = Path(__file__).resolve(), time.monotonic() + 60 * options.minutes
    root = Path(__file__).resolve().parents[2]
    out = options.out.resolve()
    stamp = out / digest(root)
    stamp.mkdir(parents=True, exist_ok=True)
    copy_project(root, out / "tree")
    words = [options.maker, here.with_name("make_mutants.py"), out / "tree", *options.packages]
    words += ["--count", str(options.count), "--seed", str(options.seed)]
    mutants = json.loads(subprocess.run(words, check=True, capture_output=True).stdout)
    # Packages in turn, so that a run that ends early has tried some of each.
    groups: dict[str, list[dict[str, Any]]] = {package: [] for package in options.packages}
    for mutant in mutants:
        groups[mutant["package"]].append(mutant)
    turns = [(index, group) for group in groups.values() for index in range(len(group))]
    compiled = import_first(out / "tree")
    measured, rows = dict[bool, Any](), []
    for index, group in sorted(turns, key=lambda turn: turn[0]):
        if time.monotonic() > end_s:
            print(f"ended after {options.minutes:.0f} minutes")
            break
        row = attempt(group[index], options.packages, compiled, stamp, measured)
        rows.append({**row, "package": group[index]["package"]})
        (out / "results.json").write_text(json.dumps(rows, indent=1) + "\n")
        print(f"{len(rows):4} {row['outcome']:<9} {row['change']}", flush=True)
    report(rows, options.packages)


if __name__ == "__main__":
    main()
