"""Repeat what the pages claim, and compare.

    python lab/benchmarks/claims.py                    # the quick ones
    python lab/benchmarks/claims.py --all              # every one, in 45 minutes
    python lab/benchmarks/claims.py shelf gain-1       # those of some commands, or some by name
    python lab/benchmarks/claims.py shelf --write      # and put what was measured into the pages

A figure of a page has a mark behind it, `97.1<!-- claim: NAME -->`. `claims.toml` has for each
name the command that measures it, where in the output the figure stands, and by how much it may
differ. A figure is OFF if it differs from what is measured by more than that and the digits it is
rounded to. Every run has an empty folder, in which its commands run one after the other; `e3pose`
and `python` are of this environment, and `lab/` is that of this clone. Ends with code 1 if a figure
is OFF or a command fails, and says what was left out, and why.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import re
import resource
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import msgspec
import tomlkit

from e3pose.base.errors import InputError
from e3pose.base.quantities import plural

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("claims.toml")
DATED = "docs/research/index.md"  # says when every command last ran
DATES = re.compile(r"Last repeated: .*")
MARK = re.compile(r"([-+]?\d+(?:\.\d+)?)(?=\**<!-- claim: ([a-z0-9.-]+) -->)")
ANY_MARK = re.compile(r"<!--\s*claim\b")
TAKEN: dict[str, Callable[[Sequence[float]], float]] = {"least": min, "most": max, "mean": fmean}
UNFOUND = (InputError, LookupError, ValueError, TypeError)  # in an output of another form
LIMIT_S = 4 * 3600  # of one command


class Claim(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Where a figure stands in the output of a run, and how well it repeats.

    Attributes:
        find: a regular expression whose group is the number; or `/`, and a path through JSON, whose
            parts are keys, numbers of entries, or `key=value,key=value` of the one entry that has
            these. A mean beside its deviation (`mean`, `sd`) is the mean.
        times: what the number is multiplied by to be in the unit of the page.
        take: of several matches the least, the most or their mean; without it they must be equal.
        spread: by how much it may differ, in the unit of the page; that of the run if not given.
    """

    find: str
    times: float = 1.0
    take: str = ""
    spread: float = 0.0


class Run(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Commands that measure some figures.

    Attributes:
        commands: one after the other, with variables such as `$E3POSE_SHARED`.
        spread: by how much a figure may differ that has no spread of its own.
        because: where its spreads come from.
        claims: by name. The list may have `find` alone in place of a claim, and `each = [...]`
            beside it: a claim for each of these, in place of `$each` in the name and in `find`; or
            a table: its keys stand in names, its values in `find`. A run may have it for all.
        cpu_s: what it took; written by `--write`.
        checked: the day on which its figures were measured last; written by `--write`.
        quick: whether it is among those that run in CI.
        needs: `recordings` that no command names, `network`, or a sentence.
        file: the output to search, or a pattern of several; what the commands print if not given.
    """

    commands: list[str]
    spread: float
    because: str
    claims: dict[str, Claim]
    cpu_s: float = 60.0
    checked: datetime.date | None = None
    quick: bool = False
    needs: str = ""
    file: str = ""

    def lacks(self, everything: bool) -> str:
        """Return why it cannot run here; nothing if it can."""
        recordings = self.needs == "recordings" or "$E3POSE_SHARED" in " ".join(self.commands)
        if recordings and "E3POSE_SHARED" not in os.environ:
            return "needs E3POSE_SHARED, a folder with the real recordings"
        return "" if everything or self.needs in ("", "recordings") else f"needs {self.needs}"


class Mark(NamedTuple):
    """A figure of a page: its digits, and which claim it is."""

    page: Path
    said: str
    claim: str


def pages() -> list[Path]:
    """Return the pages whose figures are repeated."""
    folders = (ROOT / "docs/research", ROOT / "docs/tutorial")
    return [ROOT / "README.md", *(page for one in folders for page in sorted(one.glob("*.md")))]


def marks_of(page: Path) -> list[Mark]:
    """Return the marked figures of a page.

    Raises:
        InputError: if a mark is not right behind a number.
    """
    text = page.read_text()
    found = [Mark(page, said, claim) for said, claim in MARK.findall(text)]
    if len(found) != len(ANY_MARK.findall(text)):
        raise InputError(f"{page}: a mark must be right behind a number: 97.1<!-- claim: NAME -->")
    return found


def listed(text: str) -> dict[str, Run]:
    """Read the list of runs.

    Raises:
        InputError: with what is wrong in it.
    """
    try:
        written = tomlkit.parse(text).unwrap()
        for run in written.values():
            each = run.pop("each", [""])
            run["claims"] = dict(_expanded(run["claims"], run["spread"], each))
        return msgspec.convert(written, dict[str, Run])
    except (msgspec.ValidationError, tomlkit.exceptions.TOMLKitError) as error:
        raise InputError(f"{LIST.name}: {error}") from None
    except (LookupError, TypeError, AttributeError) as error:
        raise InputError(f"{LIST.name}: expected tables with claims and spread: {error}") from None


def _expanded(claims: dict[str, Any], spread: float, each: Any) -> Iterator[tuple[str, Any]]:
    for name, written in claims.items():
        claim = {"spread": spread, **({"find": written} if isinstance(written, str) else written)}
        values = claim.pop("each", each if "$each" in name else [""])
        named = values if isinstance(values, dict) else {value: value for value in values}
        for key, value in named.items():
            find = claim["find"].replace("$each", value)
            yield name.replace("$each", key), {**claim, "find": find}


def figure(output: str, claim: Claim) -> float:
    """Return a figure of the output of a run.

    Raises:
        InputError: if it is not there, or there are several.
    """
    if claim.find.startswith("/"):
        found = [_at(json.loads(output), claim.find)]
    else:
        found = [float(each) for each in re.findall(claim.find, output, re.M)]
    if not found or (len(set(found)) > 1 and not claim.take):
        raise InputError(f"{claim.find!r} is there {len(found)} times, expected one")
    return claim.times * TAKEN[claim.take or "mean"](found)


def _at(value: Any, path: str) -> float:
    for part in path.split("/")[1:]:
        if "=" in part:
            wanted = dict(pair.split("=") for pair in part.split(","))
            rows = [row for row in value if all(_text(row[k]) == wanted[k] for k in wanted)]
            if len(rows) != 1:
                raise InputError(f"{path}: {len(rows)} entries with {part}, expected one")
            value = rows[0]
        else:
            value = value[int(part) if isinstance(value, list) else part]
    return float(value["mean"] if isinstance(value, dict) else value)


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else f"{value}"


def within(said: str, measured: float, spread: float) -> bool:
    """Return whether a figure, rounded as the page has it, is within its spread."""
    rounding = 0.5 * 10.0 ** -len(said.partition(".")[2])
    return abs(measured - float(said)) <= spread + rounding + 1e-9


def rewritten(text: str, measured: dict[str, float]) -> str:
    """Return a page with what was measured, in as many digits as were there."""

    def put(match: re.Match[str]) -> str:
        said, claim = match.groups()
        if claim not in measured:
            return said
        digits = len(said.partition(".")[2])
        return f"{measured[claim]:{'+' * said.startswith('+')}.{digits}f}"

    return MARK.sub(put, text)


def output_of(run: Run) -> str:
    """Run the commands in an empty folder; return the text that holds the figures.

    Raises:
        InputError: with the last that a command said, if it fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        said = ""
        for command in run.commands:
            ended = subprocess.run(
                [_here(word) for word in shlex.split(command)],
                cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL,
                timeout=LIMIT_S, env={**os.environ, "COLUMNS": "300", "PYTHONPATH": str(ROOT)},
            )  # fmt: skip
            if ended.returncode:
                last = (ended.stderr.strip() or ended.stdout.strip() or "no word").splitlines()[-1]
                raise InputError(f"{command!r} ended with code {ended.returncode}: {last}")
            said += ended.stdout
        found = sorted(Path(folder).glob(run.file)) if run.file else []
        if run.file and not found:
            raise InputError(f"no {run.file} was written")
        return "".join(path.read_text() for path in found) or said


def _here(word: str) -> str:
    if word == "python":
        return sys.executable
    if word == "e3pose":
        return str(Path(sys.executable).with_name("e3pose"))
    return str(ROOT / word) if word.startswith("lab/") else os.path.expandvars(word)


def chosen(runs: dict[str, Run], names: Sequence[str], everything: bool) -> dict[str, Run]:
    """Return the runs that are asked for by their names or those of claims, or the quick ones.

    Raises:
        InputError: if there is no such name.
    """
    unknown = set(names) - runs.keys() - {claim for run in runs.values() for claim in run.claims}
    if unknown:
        raise InputError(f"no run or claim of {LIST.name} is called {', '.join(sorted(unknown))}")
    return {
        name: run for name, run in runs.items()
        if everything or (run.quick and not names) or name in names or {*names} & run.claims.keys()
    }  # fmt: skip


def compared(run: Run, marks: Sequence[Mark]) -> Iterator[tuple[Mark, float, bool]]:
    """Run once; yield each figure of the pages with what was measured and whether it holds."""
    output = output_of(run)
    for name, claim in run.claims.items():
        measured = figure(output, claim)
        for mark in marks:
            if mark.claim == name:
                yield mark, measured, within(mark.said, measured, claim.spread)


def dated(runs: dict[str, Run]) -> str:
    """Return the sentence of the research page on when every command last ran."""
    days = sorted(run.checked for run in runs.values() if run.checked)
    figures = plural(sum(len(run.claims) for run in runs.values() if run.checked), "figure")
    return f"Last repeated: {figures} by {plural(len(days), 'command')}, {days[0]} to {days[-1]}."


def write(name: str, cpu_s: float, whole: bool, measured: dict[str, float]) -> None:
    """Put figures into the pages, and the day and the time taken into the list."""
    for page in pages():
        page.write_text(rewritten(page.read_text(), measured))
    document: Any = tomlkit.parse(LIST.read_text())
    document[name]["cpu_s"] = round(cpu_s)
    if whole:
        document[name]["checked"] = datetime.date.today()
        page = ROOT / DATED
        page.write_text(DATES.sub(dated(listed(tomlkit.dumps(document))), page.read_text()))
    LIST.write_text(tomlkit.dumps(document))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("names", nargs="*", help="of runs or claims; the quick ones without any")
    parser.add_argument("--all", action="store_true", help="every run, in 45 minutes")
    parser.add_argument("--write", action="store_true", help="put the figures into the pages")
    options = parser.parse_args()
    marks = [mark for page in pages() for mark in marks_of(page)]
    runs = chosen(listed(LIST.read_text()), options.names, options.all)
    lacking = {name: run.lacks(bool(options.all or options.names)) for name, run in runs.items()}
    runs = {name: run for name, run in runs.items() if not lacking[name]}
    counts = {"ok": 0, "OFF": 0, "FAILED": 0}
    for place, (name, run) in enumerate(runs.items()):
        left_min = sum(each.cpu_s for each in list(runs.values())[place:]) / 60
        print(f"{place + 1} of {len(runs)}, about {left_min:.0f} min left: {name}", flush=True)
        begun_s, used_s = time.monotonic(), _used_s()
        measured: dict[str, float] = {}
        verdicts = []
        try:
            for mark, value, holds in compared(run, marks):
                measured[mark.claim] = value
                verdicts.append("ok" if holds else "OFF")
                print(
                    f"  {verdicts[-1]:<4} {mark.claim:<32} {mark.page.name}: {mark.said}, measured "
                    f"{value:.5g}, spread {run.claims[mark.claim].spread:g}", flush=True,
                )  # fmt: skip
        except (*UNFOUND, OSError, subprocess.TimeoutExpired) as error:
            verdicts.append("FAILED")
            print(f"  FAILED {error}", flush=True)
        print(f"  {_used_s() - used_s:.0f} s of CPU in {time.monotonic() - begun_s:.0f} s")
        for verdict in verdicts:
            counts[verdict] += 1
        if options.write:
            write(name, _used_s() - used_s, "FAILED" not in verdicts, measured)
    for name, reason in lacking.items():
        if reason:
            print(f"left out: {name} {reason}")
    print(f"{counts['ok']} within their spread, {counts['OFF']} OFF, {counts['FAILED']} failed")
    return 1 if counts["OFF"] or counts["FAILED"] else 0


def _used_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    try:
        sys.exit(main())
    except InputError as error:
        sys.exit(f"{error}")
