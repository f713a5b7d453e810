"""The distributions of this project: the product, and those in folders beside it (hub, lab)."""

from __future__ import annotations

import ast
import sys
from functools import cache
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PRODUCT = "e3pose"


def read(folder: Path, name: str = "pyproject.toml") -> dict[str, Any]:
    """Return what a TOML file of a folder says."""
    return tomllib.loads((folder / name).read_text())


@cache
def nodes(path: Path) -> list[ast.AST]:
    """Return all nodes of the tree of a file, its module first: parsed once for all who ask."""
    return [*ast.walk(ast.parse(path.read_text()))]


# Folders of the others by their package; the project file of the product lists them.
FOLDERS = {
    name.replace("-", "_"): ROOT / source["path"]
    for name, source in read(ROOT)["tool"]["uv"]["sources"].items()
}
PACKAGES = {PRODUCT: ROOT / "src" / PRODUCT, **{name: at / name for name, at in FOLDERS.items()}}
# What each distribution says of itself, by its name.
PROJECTS = {str((said := read(at)["project"])["name"]): said for at in (ROOT, *FOLDERS.values())}
