"""Pages that the documentation makes of the code.

One per verb of the command line, the Python API, the tuned numbers of the filter, and the tables of
messages. `python docs/hooks.py` writes what the browser's page and the tests know of these.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, get_args
from unittest.mock import MagicMock

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from msgspec import inspect

import e3pose
from e3pose import _HOMES
from e3pose.cli.app import GROUPS, app
from e3pose.edge.metrics import EdgeCollector
from e3pose.wire.codec import Message
from e3pose.wire.messages import VERSION, Array, fields
from e3pose.wire.site_messages import CameraStatus, Status, Tombstone

SOURCE = Path(e3pose.__file__).parent
# Where every number that somebody chose is marked: folders and files of `src/e3pose/`.
TUNED = (
    "estimate/filter",
    "model/proportions.py",
    "estimate/per_slot",
    "estimate/smooth",
    "select",
)
DIARY = Path(__file__).parent.parent / "lab" / "experiments"
TERMS = "2026-11-24-terms-of-the-filter.md"  # what each term is worth, measured
NUMBERS = "2026-11-27-numbers-halved-and-doubled.md"
NOT_MEASURED, HALVED = "not measured", "half and twice"

MESSAGES: dict[str, Any] = {kind.__name__: kind for kind in (*get_args(Message), CameraStatus)}
# Where words of the tables of messages lead.
LINKS = {
    "active seconds": "../explanation/energy.md#what-active-time-is",
    "why the slot is blind": "#blind-slots",
    "blind slots by cause": "#blind-slots",
    "energy budget": "../how-to/power.md#set-a-budget",
    "what rests cost": "../explanation/energy.md#who-stays-awake",
    "all cameras been active in every slot": "../explanation/energy.md#savings",
    "processor time saved": "../explanation/energy.md#savings",
    "the store's `runs`": "store.md",
}

# Pages of the Python API: title, what it is for, and the names to show.
API: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "estimate": (
        "Estimators",
        "Views of a slot in, people out.",
        ("estimate.base", "estimate.estimator_maker", "estimate.filter.Model"),
    ),
    "predict": (
        "Predictors",
        "Recent poses in, poses some slots ahead out.",
        ("predict.base", "predict.make_predictor"),
    ),
    "select": (
        "Policies",
        "A situation in, the cameras of a slot out.",
        ("select.policies.base", "select.policies.policy_row"),
    ),
    "pipeline": ("The loop", "One slot of it, offline and live.", ("pipeline",)),
    "simulate": (
        "Simulation",
        "Recordings of simulated people.",
        ("simulate.settings", "simulate.simulation.simulate"),
    ),
    "detectors": (
        "Detectors",
        "Images in, 2D poses out.",
        ("detectors.base", "detectors.make_detector"),
    ),
    "store": (
        "Store",
        "Write and query stored slots.",
        ("store.query.Store", "store.answers.StoredPoses", "store.writer.StoreWriter"),
    ),
    "report": ("Reports", "Write the report page.", ("output.report.page.write_report",)),
}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the generated pages and decisions to the navigation."""
    docs = Path(config.docs_dir)
    sections: dict[str, list[Any]] = {
        title: pages for entry in config.nav or [] if isinstance(entry, dict)
        for title, pages in entry.items()
    }  # fmt: skip
    verbs = [
        {group: [f"reference/cli/{verb}.md" for verb in names]} for group, names in GROUPS.items()
    ]
    sections["Reference"].insert(0, {"Command line": ["reference/cli/index.md", *verbs]})
    api = ["reference/api/index.md", *(f"reference/api/{name}.md" for name in API)]
    sections["Reference"].insert(1, {"Python API": api})
    decisions = sorted(path.name for path in (docs / "decisions").glob("*.md"))
    sections["Research"].append({"Decisions": [f"decisions/{name}" for name in decisions]})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add one page per verb and per part of the API."""
    index = ["# Command line", "", "Generated from `e3pose --help`.", ""]
    for group, verbs in GROUPS.items():
        index += [f"## {group}", "", "| verb | |", "|---|---|"]
        for verb in verbs:
            text = command_page(verb)
            first = text.split("```")[2].strip().splitlines()[0]
            index.append(f"| [`{verb}`]({verb}.md) | {first} |")
            files.append(File.generated(config, f"reference/cli/{verb}.md", content=text))
        index.append("")
    files.append(File.generated(config, "reference/cli/index.md", content="\n".join(index)))
    names = ["# Python API", "", "The names of the package itself: `from e3pose import ...`.", ""]
    names += [
        f"::: e3pose.{home}.{name}\n    options:\n      heading_level: 2\n"
        for name, home in sorted(_HOMES.items())
    ]
    files.append(File.generated(config, "reference/api/index.md", content="\n".join(names)))
    for name, (title, what, members) in API.items():
        text = f"# {title}\n\n{what}\n\n" + "\n".join(
            f"::: e3pose.{member}\n    options:\n      heading_level: 2\n" for member in members
        )
        files.append(File.generated(config, f"reference/api/{name}.md", content=text))
    text = numbers_page()
    files.append(File.generated(config, "research/tuned-numbers.md", content=text))
    text = metrics_page()
    files.append(File.generated(config, "reference/prometheus.md", content=text))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Fill in the tables of messages."""
    if page.file.src_uri != "reference/messages.md":
        return markdown
    return re.sub(r"<!-- fields of (\w+) -->", lambda found: fields_table(found[1]), markdown)


def fields_table(name: str) -> str:
    """Return the table of a message's fields."""
    kind: Any = MESSAGES[name]
    typed: Any = inspect.type_info(kind)
    told = fields(kind)
    columns = {
        "": [str(place) for place in range(1, len(told) + 1)],
        "field": [
            f"**`{field.name}`**" if field.required else f"`{field.name}`" for field in typed.fields
        ],
        "type": [type_words(field.type) for field in typed.fields],
        "meaning": [_linked(field.meaning) for field in told],
        "metric": [field.uses.metric and f"`{field.uses.metric}`" for field in told],
        "`e3pose top`": [field.uses.column[0] if field.uses.column else "" for field in told],
    }
    if not kind.__struct_config__.array_like:
        del columns[""]  # a map by names
    shown = {head: cells for head, cells in columns.items() if any(cells)}
    rows = [list(shown), ["---"] * len(shown), *zip(*shown.values(), strict=True)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _linked(meaning: str) -> str:
    """Return the meaning of a field with links, and with nil for None."""
    for words, target in LINKS.items():
        meaning = meaning.replace(words, f"[{words}]({target})")
    return meaning.replace(". None", ". Nil").replace("None", "nil")


def type_words(typed: Any) -> str:
    """Return a type as the page on messages has it."""
    match typed:
        case inspect.Metadata():
            return type_words(typed.type)
        case inspect.UnionType():
            return " or ".join(type_words(each) for each in typed.types)
        case inspect.LiteralType():
            return "mode"
        case inspect.NoneType():
            return "nil"
        case inspect.StructType():
            return "Array" if typed.cls is Array else str(typed.cls.__name__)
        case inspect.VarTupleType():
            return f"list of {type_words(typed.item_type)}"
        case inspect.TupleType():
            return f"[{', '.join(map(type_words, typed.item_types))}]"
        case inspect.DictType():
            return f"map of {type_words(typed.key_type)} to {type_words(typed.value_type)}"
        case inspect.BytesType():
            return "bin"
    return type(typed).__name__.removesuffix("Type").lower()


BROWSER_TYPES = SOURCE / "site" / "web" / "browser" / "camera_status.js"
_JAVASCRIPT = {
    "int": "number",
    "float": "number",
    "bool": "boolean",
    "nil": "null",
    "str": "string",
}


def browser_types() -> str:
    """Return the module of the live page that has the types and meanings of a camera's fields."""
    typed: Any = inspect.type_info(CameraStatus)
    lines = [
        "// What a camera reports: types and meanings of its fields, made of `CameraStatus`.",
        "// `python docs/hooks.py` writes this file.",
        "",
        "/**",
        " * @typedef {object} CameraStatus",
    ]
    told = {field.name: field.meaning for field in fields(CameraStatus)}
    for field in typed.fields:
        words = told[field.name].replace("None", "null")
        lines.append(f" * @property {{{_javascript(field.type)}}} {field.name} {words}")
    shown = {name: words.replace("None", "–") for name, words in told.items()}
    meanings = json.dumps(shown, indent=2, ensure_ascii=False)
    return "\n".join((*lines, " */", "", f"export const MEANINGS = {meanings};", ""))


def _javascript(typed: Any) -> str:
    """Return a type as JSDoc has it."""
    match typed:
        case inspect.Metadata():
            return _javascript(typed.type)
        case inspect.UnionType():
            return "|".join(_javascript(each) for each in typed.types)
        case inspect.LiteralType():
            return "|".join(json.dumps(value) for value in typed.values)
    return _JAVASCRIPT[type_words(typed)]


MESSAGE_SHAPES = Path(__file__).parent.parent / "tests" / "wire" / "fields.json"
OPTIONAL = " = default"
Shapes = dict[str, list[str]]


def message_shapes() -> Shapes:
    """Return of each message its form, and its fields in order."""
    found = {}
    for name, kind in {**MESSAGES, "Tombstone": Tombstone, "Array": Array}.items():
        typed: Any = inspect.type_info(kind)
        form = f"array {typed.tag}" if kind.__struct_config__.array_like else "map"
        found[name] = [form]
        for field in typed.fields:
            ending = "" if field.required else OPTIONAL
            found[name].append(f"{field.name}: {type_words(field.type)}{ending}")
    return found


def broken_messages(before: Shapes, after: Shapes) -> list[str]:
    """Return the messages that a reader or a writer of before would trip over."""
    found = []
    for name, old in before.items():
        new = after.get(name, [])
        kept = set(old) <= set(new) if old[0] == "map" else new[: len(old)] == old
        if not kept or not all(added.endswith(OPTIONAL) for added in set(new) - set(old)):
            found.append(name)
    return found


def write_shapes() -> None:
    """Note the messages of this version; end where one of the same version would be broken."""
    version, known = json.loads(MESSAGE_SHAPES.read_text())
    if version == VERSION and (broken := broken_messages(known, message_shapes())):
        raise SystemExit(f"{', '.join(broken)}: a field went, moved or changed: raise VERSION")
    shapes = message_shapes().items()
    rows = ",\n".join(f"{json.dumps(name)}: {json.dumps(one)}" for name, one in shapes)
    MESSAGE_SHAPES.write_text(f"[{VERSION}, {{\n{rows}\n}}]\n")


def metrics_page() -> str:
    """Return the table of the Prometheus metrics, as an edge without cameras names them."""
    edge = MagicMock()
    edge.status.return_value = Status("lab", 0, 25.0, 0, 0, ())
    edge.inbox.roster.cameras, edge.counts.ordered.tolist.return_value = (), []
    page = ["# Prometheus metrics", "", "Generated from what an edge serves at `metrics_port`."]
    page += ["", "| metric | kind | labels | is |", "|---|---|---|---|"]
    for family in EdgeCollector(edge).collect():
        name = family.name + ("_total" if family.type == "counter" else "")
        labels = ", ".join(f"`{label}`" for label in family._labelnames)
        page.append(f"| `{name}` | {family.type} | {labels} | {family.documentation} |")
    return "\n".join(page) + "\n"


class Mark(NamedTuple):
    """A comment above a tuned number: `# tuned: UNIT | CHOSEN ON | WORTH`.

    Attributes:
        name: of the constants.
        value: as the code has it.
        unit: of each.
        chosen_on: recordings, or what else decided.
        worth: the term of `TERMS` that is out of force without it; `HALVED`, where `NUMBERS` has
            what other values cost; what a judge says of other values; or `NOT_MEASURED`.
    """

    name: str
    value: str
    unit: str
    chosen_on: str
    worth: str


def marks(source: str) -> Iterator[Mark]:
    """Yield the marked numbers of a module; raise `ValueError` for a mark that lacks a part."""
    lines = source.splitlines()
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign):
            first = node.lineno - 1
            while first and lines[first - 1].startswith("#"):
                first -= 1
            above = " ".join(line[1:].strip() for line in lines[first : node.lineno - 1])
            if "tuned:" in above:
                unit, chosen_on, worth = above.split("tuned:")[1].split("|")
                name = ast.unparse(node.targets[0]).strip("()")
                parts = (part.strip() for part in (unit, chosen_on, worth))
                yield Mark(name, ast.unparse(node.value).strip("()"), *parts)


def tuned_files(*places: str) -> list[Path]:
    """Return the modules whose tuned numbers are marked, of some of `TUNED` or of all."""
    named = (SOURCE / place for place in places or TUNED)
    return [file for path in named for file in (sorted(path.rglob("*.py")) or [path])]


def worths(terms: str) -> dict[str, float]:
    """Return how much larger the mean error is without each term, percent.

    Args:
        terms: the page `TERMS`.
    """
    rows = (line.strip("| ").split(" | ") for line in terms.splitlines() if line.startswith("| "))
    return {
        row[0]: sum(float(cell.split()[0]) for cell in row[1:]) / len(row[1:])
        for row in rows
        if len(row) > 1 and all(re.match(r"[+-][\d.]+( |$)", cell) for cell in row[1:])
    }


def factors(numbers: str) -> dict[tuple[str, str], dict[str, str]]:
    """Return how much larger the mean error is with each number halved and doubled, in words.

    Args:
        numbers: the page `NUMBERS`.

    Returns:
        By module and name, and by `half` and `twice`.
    """
    found: dict[tuple[str, str], dict[str, str]] = {}
    row = re.compile(r"^\| `(\w+)\.([^`]+)` \| (half|twice) \| (.*) \| [\d.]+ \|$", re.M)
    for module, name, factor, cells in row.findall(numbers):
        errors = [cell.split(",")[0] for cell in cells.split(" | ")]
        words = "loses people"
        if "nobody found" not in errors:
            words = f"{sum(map(float, errors)) / len(errors):+.1f} %"
        found.setdefault((module, name.strip("()")), {})[factor] = words
    return found


def numbers_page() -> str:
    """Return the tables of the tuned numbers."""
    known = worths((DIARY / TERMS).read_text())
    changed = factors((DIARY / NUMBERS).read_text())
    page = [
        "# Tuned numbers",
        "",
        "Generated from the marks above the constants in `src/e3pose/`. No number was fitted to",
        "labels of a recording. *Worth* is how much larger the mean error is over twelve",
        f"recordings (`lab/experiments/{TERMS}`) without the term that a number belongs",
        "to (that page says what else each term is there for), or what a judge says of other",
        "values. *By reasoning*: no other value was tried. *Half* and *twice* are how much larger",
        f"it is over six recordings (`lab/experiments/{NUMBERS}`)",
        "with half of the number and with twice, where that was measured: up to 3 % is chance.",
    ]
    for place in TUNED:
        page += ["", f"## `{place}`", ""]
        page += [
            "| file | constant | value | unit | chosen on | worth | half, twice |",
            "|---|---|---|---|---|---|---|",
        ]
        for path in tuned_files(place):
            page += [_number_row(path, mark, known, changed) for mark in marks(path.read_text())]
    return "\n".join(page) + "\n"


def _number_row(
    path: Path,
    mark: Mark,
    known: dict[str, float],
    changed: dict[tuple[str, str], dict[str, str]],
) -> str:
    worth = mark.worth
    both = changed.get((path.stem, mark.name), {}) if "filter" in path.parts else {}
    factor = ", ".join(both.get(word, "?") for word in ("half", "twice")) if both else ""
    if worth in known:
        worth = f"{known[worth]:+.1f} % ({worth})"
    origin = re.sub(r"lab/experiments/([\w-]+)\.md", r"`\1`", mark.chosen_on)
    origin = re.sub(r"docs/research/([\w-]+)\.md", r"[\1](\1.md)", origin)
    origin = re.sub(r"docs/decisions/([\w-]+)\.md", r"[decision](../decisions/\1.md)", origin)
    cells = (path.stem, f"`{mark.name}`", f"`{mark.value}`", mark.unit, origin, worth, factor)
    return f"| {' | '.join(cells)} |"


def command_page(verb: str) -> str:
    """Return the help of a verb as a page."""
    text = app[verb].generate_docs(usage_name=f"e3pose {verb}")
    text = re.sub(r"## Table of Contents\n.*?(?=\n\*\*|\n## )", "", text, flags=re.DOTALL)
    text = re.sub(r"^ {8}", "    ", text, flags=re.MULTILINE)
    text = text.replace(f"e3pose {verb} {verb} ", f"e3pose {verb} ", 1)  # a usage of its own
    return text.replace(f"# {verb}\n", f"# e3pose {verb}\n", 1)


if __name__ == "__main__":
    BROWSER_TYPES.write_text(browser_types())
    write_shapes()
