"""The pages are true: links lead somewhere, commands parse, what they and code name exists."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
import subprocess
from dataclasses import fields
from typing import Any

import pytest
from tests.cases import each_case
from tests.distributions import ROOT

from e3pose.base.bounded import parse_toml
from e3pose.base.table import read_table
from e3pose.cli.app import VERBS, app
from e3pose.cli.options import EnergyOptions, LoopOptions
from e3pose.edge.camera_state import QUARANTINE_S, WRONG_LIMIT, WRONG_S
from e3pose.settings.camera_file import NodeTable
from e3pose.settings.site_file import SiteTable

PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "deploy").glob("*.md")]
TEXTS = {page: page.read_text() for page in sorted(PAGES)}
FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^ *```", re.S | re.M)
COMMAND = re.compile(
    r"^ *(?:sudo (?:-u e3pose )?)?(?:E3POSE_CACHE=\S+ )?(?:/opt/e3pose/bin/)?e3pose "
)
IN_GIT = re.compile(r"`git show ([0-9a-f]{8,40}):(lab/benchmarks/\w+\.py)`")
GENERATED = (
    # By docs/hooks.py; `make docs` checks links to them.
    r"(\.\./|docs/)?(reference/(cli/|api/|prometheus\.md)|(research/)?tuned-numbers\.md)"
)
PLACEHOLDER = re.compile(r"[\[\]|<>$]|\.\.\.")  # of a synopsis or a loop, not a command
# A dated page of the diary is of its commit: its links are checked, its commands are not.
DIARY = sorted((ROOT / "lab" / "experiments").glob("*.md"))
BY_PAGE = {str(page.relative_to(ROOT)): text for page, text in TEXTS.items()}
LINKED = BY_PAGE | {str(page.relative_to(ROOT)): page.read_text() for page in DIARY}


def blocks(text: str, *languages: str) -> list[str]:
    """Return the code blocks of a page that are in one of the languages."""
    return [body for _, language, body in FENCE.findall(text) if language in languages]


def anchors(text: str) -> set[str]:
    """Return what the headings of a page are called in links."""
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", text), re.M)
    return {re.sub(r"[^\w\- ]", "", h.lower().strip()).replace(" ", "-") for h in headings}


def commands_of(text: str) -> list[str]:
    """Return every whole call of the program in a page's blocks, without comments."""
    found = []
    indented = re.findall(r"(?:^ {4}e3pose .*\n)+", FENCE.sub("", text), re.M)
    for block in [*blocks(text, "", "sh", "bash", "console"), *indented]:
        for line in re.sub(r" *\\\n *", " ", block).splitlines():
            if COMMAND.match(line) and not PLACEHOLDER.search(line.partition("  #")[0]):
                found.append(COMMAND.sub("", line).partition("  #")[0].strip())
    return found


def commands() -> list[str]:
    """Return the commands of all pages."""
    return sorted({command for text in TEXTS.values() for command in commands_of(text)})


@each_case("page", LINKED)
def test_every_link_leads_somewhere(page: str) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", LINKED[page])):
        if re.match(r"https?:|mailto:", target) or re.match(GENERATED, target):
            continue
        place, _, anchor = target.partition("#")
        path = ((ROOT / page).parent / place).resolve() if place else ROOT / page
        assert path.exists(), target
        if anchor and path.suffix == ".md":
            assert anchor in anchors(path.read_text()), target


def test_every_page_that_code_or_a_page_names_is_there() -> None:
    code = {
        str(path): path.read_text() for top in ("src", "lab") for path in (ROOT / top).rglob("*.py")
    }
    named = {
        (place, name)
        for place, text in (code | BY_PAGE).items()
        for name in re.findall(r"\b(?:docs|lab/experiments)/[\w/-]+\.md", text)
    }
    assert len(named) > 100
    lacking = [
        each for each in named if not (re.match(GENERATED, each[1]) or (ROOT / each[1]).is_file())
    ]
    assert not lacking


def test_how_to_pages_stay_short_enough_to_be_read() -> None:
    words = {page: len(text.split()) for page, text in BY_PAGE.items() if "/how-to/" in page}
    assert len(words) > 25 and sum(words.values()) <= 20_000 and max(words.values()) <= 1_600
    assert len(BY_PAGE["README.md"].splitlines()) <= 120


@each_case("command", commands())
def test_every_command_parses(command: str) -> None:
    tokens = shlex.split(command)
    function = app.parse_args(tokens, exit_on_error=False, print_error=False)[0]
    assert (tokens[0] in VERBS or tokens[0].startswith("--")) and callable(function)


def test_every_verb_is_in_a_page() -> None:
    everything = "\n".join(TEXTS.values())
    assert len(commands()) > 40
    for verb in VERBS:
        assert re.search(rf"`(?:e3pose )?{verb}[` ]|^ *e3pose {verb} ", everything, re.M), verb


@each_case("verb", ["edge", "camera", "router", "up", "top", "view", "stream", "check"])
def test_every_option_of_a_live_program_says_what_it_is_for(verb: str) -> None:
    for argument in app[verb].assemble_argument_collection(parse_docstring=True):
        if argument.show:
            assert argument.parameter.help, argument.name


def test_every_file_in_a_page_is_one() -> None:
    kinds = {"e3pose-site": SiteTable, "e3pose-camera": NodeTable}
    seen = 0
    for text in TEXTS.values():
        for block in blocks(text, "toml"):
            found = re.search(r'^format = "([a-z0-9-]+)"', block, re.M)
            if found and found[1] in kinds:
                read_table(kinds[found[1]], parse_toml(block, "a page"))
                seen += 1
    assert seen >= 1


@pytest.mark.parametrize("options", [LoopOptions, EnergyOptions])
def test_page_explains_every_key_of_the_loop_and_of_energy(options: Any) -> None:
    page = BY_PAGE["docs/reference/site-file.md"]
    (text,) = re.findall(rf"<!-- {options.__name__} -->\n(.*?)\n\n", page, re.S)
    rows = dict(re.findall(r"^\| `(\w+)` \|\s*([^|]*?)\s*\|", text, re.M))
    known = {item.name: item.default for item in fields(options)}
    if options is LoopOptions:  # lead stands at the top of the file
        known = {**known, "cameras": None, "policy": None}
        del known["lead"]
    assert set(rows) == set(known)
    for name, default_cell in rows.items():
        default = known[name]
        shown = str(default).lower() if isinstance(default, bool) else f"{default}"
        assert default_cell == ("" if default is None else f"`{shown.removesuffix('.0')}`"), name


def test_pages_agree_with_the_code_on_how_long_a_liar_is_left_out() -> None:
    assert (WRONG_LIMIT, WRONG_S, QUARANTINE_S) == (20, 10.0, 5.0)
    for page in ("docs/reference/faults.md", "docs/reference/messages.md"):
        said = " ".join(BY_PAGE[page].split())
        assert re.search(r"twenty (such )?in ten seconds (leave it out|is left out) for five", said)


def test_a_script_of_the_lab_is_in_the_tree_or_in_a_commit_that_the_page_names() -> None:
    texts = {**LINKED, **{str(p): p.read_text() for p in (ROOT / "src").rglob("*.md")}}
    named, in_git = set(), set()
    for page, text in texts.items():
        if page != "CHANGELOG.md":
            named |= {(page, at) for at in re.findall(r"lab/benchmarks/\w+\.py", text)}
            in_git |= {(page, *at) for at in re.findall(IN_GIT, text)}
    gone = {(page, at) for page, at in named if not (ROOT / at).exists()}
    assert gone <= {(page, at) for page, _, at in in_git} and gone
    whole = not (ROOT / ".git" / "shallow").exists() and (ROOT / ".git").exists()
    for commit, at in {(commit, at) for _, commit, at in in_git} if whole else ():
        subprocess.run(["git", "-C", ROOT, "cat-file", "-e", f"{commit}:{at}"], check=True)


def imported() -> list[tuple[str, str, str]]:
    """Return page, module and name of all that the Python of pages imports from the package."""
    return [
        (page, node.module, name.name)
        for page, text in BY_PAGE.items()
        for block in blocks(text, "python")
        for node in ast.walk(ast.parse(block))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("e3pose")
        for name in node.names
        if node.module
    ]


def test_what_the_python_of_a_page_imports_exists() -> None:
    found = imported()
    assert len(found) > 20
    lacking = [each for each in found if not hasattr(importlib.import_module(each[1]), each[2])]
    assert not lacking


PAGE = ROOT / "docs" / "explanation" / "overview.md"
EQUATIONS = range(1, 10)  # of the paper
ROW = re.compile(r"^\| eq\. \((\d)\)(?: to \((\d)\))? \|.*`([\w/]+\.py)` \|$", re.MULTILINE)
CITED = re.compile(r"eq\. \((\d)\)(?: to \((\d)\))?")


def numbers(first: str, last: str) -> range:
    return range(int(first), int(last or first) + 1)


def test_every_equation_of_the_paper_has_a_row_and_its_file_cites_it() -> None:
    rows = ROW.findall(PAGE.read_text())
    assert [n for first, last, _ in rows for n in numbers(first, last)] == list(EQUATIONS)
    for first, last, name in rows:
        place = ROOT if name.startswith("lab/") else ROOT / "src" / "e3pose"
        source = (place / name).read_text()
        cited = {n for pair in CITED.findall(source) for n in numbers(*pair)}
        assert set(numbers(first, last)) <= cited, f"{name} cites {sorted(cited)}"
