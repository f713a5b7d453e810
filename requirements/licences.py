"""List the licences of a software bill of materials, and refuse what the project may not use.

cyclonedx-py environment PYTHON -o sbom.json && python requirements/licences.py sbom.json

The exit code is 1 for a component under AGPL, GPL, a source-available or a non-commercial licence
without an alternative, and for one that states none and was not looked at.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from license_expression import ExpressionError, get_spdx_licensing

FORBIDDEN = re.compile(
    r"\b(A?GPL|SSPL|BUSL|Affero|(?<!Lesser )General Public|Non-?Commercial|CC-BY-NC\S*|"
    r"Commons.Clause|PolyForm\S*|Elastic-2\S*)",
    re.IGNORECASE,
)
# Its authors allow combinations with other licences.
EXCEPTION = re.compile(r"(Classpath|GCC|linking)[ -].*exception", re.IGNORECASE)
# Components that state nothing a program can read: what their files say, read by a person.
READ = {
    "ezc3d": "MIT",
    "partd": "BSD-3-Clause",
    "protobuf": "BSD-3-Clause",
    "pycocotools": "BSD-2-Clause",
}


def main() -> None:
    components: list[dict[str, Any]] = json.loads(Path(sys.argv[1]).read_text())["components"]
    refused = 0
    for component in sorted(components, key=lambda one: str(one["name"]).lower()):
        name = str(component["name"])
        stated = stated_by(component) or READ.get(name.lower(), "")
        problem = "states no licence" if not stated else "" if allowed(stated) else "forbidden"
        refused += bool(problem)
        line = f"{name:32} {component.get('version', ''):16} {stated[:90] or '-'}"
        print(line + (f"   <- {problem}" if problem else ""))
    print(f"{len(components)} components, {refused} refused")
    sys.exit(1 if refused else 0)


def stated_by(component: dict[str, Any]) -> str:
    """Return the licence of a component: an expression, or names that all hold."""
    found: list[str] = []
    for one in component.get("licenses", []):
        if "expression" in one:
            return str(one["expression"])
        licence = one["license"]
        name = str(licence.get("id") or licence.get("name") or "")
        found.append(" ".join(name.rpartition("::")[2].split()))
    # A classifier without a licence, such as `OSI Approved`, says nothing.
    kept = [name for name in dict.fromkeys(found) if name and name != "OSI Approved"]
    # Texts of licences in place of their names are known by their first words.
    return " AND ".join(name[:200] for name in kept)


def allowed(stated: str) -> bool:
    """Return whether a licence may be used: one of alternatives, all of several."""
    try:
        parsed = get_spdx_licensing().parse(stated)
    except (ExpressionError, ValueError):
        return not _forbids(stated)
    return _allows(parsed)


def _allows(part: Any) -> bool:
    if hasattr(part, "args") and part.args and part.__class__.__name__ in ("OR", "AND"):
        each = [_allows(one) for one in part.args]
        return any(each) if part.__class__.__name__ == "OR" else all(each)
    return not _forbids(str(part))


def _forbids(words: str) -> bool:
    return bool(FORBIDDEN.search(words)) and not EXCEPTION.search(words)


if __name__ == "__main__":
    main()
