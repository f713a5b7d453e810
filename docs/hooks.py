"""Pages that the documentation makes of the code: one per verb of the command line, and the API."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from e3pose import _HOMES
from e3pose.cli.app import GROUPS, app

# Pages of the Python API: title, what it is for, and the names to show.
API: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "estimate": (
        "Estimators",
        "Views of a slot in, people out.",
        ("estimate.base", "estimate.make_estimator", "estimate.filter.Model"),
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
    "report": ("Reports", "Write the report page.", ("report.page.write_report",)),
}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the generated pages, experiments and decisions to the navigation."""
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
    for title, folder in (("Experiments", "experiments"), ("Decisions", "decisions")):
        pages = sorted(path.name for path in (docs / folder).glob("*.md"))
        sections["Research"].append({title: [f"{folder}/{name}" for name in pages]})
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
    return files


def command_page(verb: str) -> str:
    """Return the help of a verb as a page."""
    text = app[verb].generate_docs(usage_name=f"e3pose {verb}")
    text = re.sub(r"## Table of Contents\n.*?(?=\n\*\*|\n## )", "", text, flags=re.DOTALL)
    text = re.sub(r"^ {8}", "    ", text, flags=re.MULTILINE)
    text = text.replace(f"e3pose {verb} {verb} ", f"e3pose {verb} ", 1)  # a usage of its own
    return text.replace(f"# {verb}\n", f"# e3pose {verb}\n", 1)
