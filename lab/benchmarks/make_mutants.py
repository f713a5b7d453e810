"""List a random sample of mutants: one small change each to a source file, made by cosmic-ray.

Run by the Python of an environment that has cosmic-ray (`make mutants`); prints JSON.
"""

from __future__ import annotations

import argparse
import ast
import json
import random
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

# Any other change of an operator fails in the first test, and tells nothing about the tests.
LIKELY = {
    "Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "FloorDiv_Mul", "Mod_Mul", "Pow_Mul",
    "BitAnd_BitOr", "BitOr_BitAnd", "BitXor_BitAnd", "LShift_RShift", "RShift_LShift",
    "Eq_NotEq", "NotEq_Eq", "Lt_LtE", "Lt_GtE", "LtE_Lt", "LtE_Gt", "Gt_GtE", "Gt_LtE", "GtE_Gt",
    "GtE_Lt", "Is_IsNot", "IsNot_Is",
}  # fmt: skip
# Decorators compile, cache or make dataclasses; the others need arguments.
LEFT_OUT = {"core/RemoveDecorator", "core/VariableReplacer", "core/VariableInserter"}
Place = tuple[str, tuple[int, int]]  # path; line and column


@dataclass(frozen=True)
class Mutant:
    """One change.

    Attributes:
        package: in which it was drawn.
        path: the file, from the root of the project.
        line: the first line that is changed.
        operator: what cosmic-ray calls the change.
        source: the whole file with the change.
    """

    package: str
    path: str
    line: int
    operator: str
    source: str


def kept_operators() -> Iterator[str]:
    """Yield the operators that make mutants worth trying."""
    for name in operator_names():
        kind, _, change = name.partition("Operator_")
        replaced = kind in ("core/ReplaceBinary", "core/ReplaceComparison")
        if name not in LEFT_OUT and (change in LIKELY if replaced else True):
            yield name


def without_effect(source: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return the spans of a file in which a change has no effect when the program runs."""
    spans = []
    for node in ast.walk(ast.parse(source)):
        parts: list[ast.expr | None] = []
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            parts = [node.returns, *node.decorator_list]
        elif isinstance(node, ast.ClassDef):
            parts = [*node.decorator_list]
        elif isinstance(node, ast.arg | ast.AnnAssign):
            parts = [node.annotation]
        elif isinstance(node, ast.keyword) and node.arg == "strict":
            parts = [node.value]
        elif isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            parts = [node.test]
        for part in parts:
            if part is not None:
                end = (part.end_lineno or 0, part.end_col_offset or 0)
                spans.append(((part.lineno, part.col_offset), end))
    return spans


def places(root: Path, paths: list[Path]) -> dict[Place, list[tuple[str, int]]]:
    """Return the places at which files can be changed: operators, and which one of theirs it is."""
    found: dict[Place, list[tuple[str, int]]] = {}
    for path in paths:
        source = path.read_text()
        nodes, spans = list(ast_nodes(get_ast(source))), without_effect(source)
        for name in kept_operators():
            starts = [
                start
                for node in nodes
                for start, _ in get_operator(name)().mutation_positions(node)
            ]
            for occurrence, start in enumerate(starts):
                if not any(begin <= start <= end for begin, end in spans):
                    place = (str(path.relative_to(root)), start)
                    found.setdefault(place, []).append((name, occurrence))
    return found


def sample(root: Path, packages: list[str], count: int, seed: int) -> list[Mutant]:
    """Return as many mutants of each package, at places drawn without replacement."""
    random_ = random.Random(seed)
    mutants = []
    for index, package in enumerate(packages):
        home = root / "src" / "e3pose" / package
        paths = sorted(home.rglob("*.py")) if home.is_dir() else [home.with_suffix(".py")]
        found = places(root, paths)
        share = count * (index + 1) // len(packages) - count * index // len(packages)
        for place in random_.sample(sorted(found), min(share, len(found))):
            name, occurrence = random_.choice(found[place])
            path, (line, _) = place
            try:
                changed = mutate_code((root / path).read_text(), get_operator(name)(), occurrence)
            except AttributeError:  # cosmic-ray 8.7 cannot change `except (*ERRORS, OSError)`
                continue
            if changed is not None:
                mutants.append(Mutant(package, path, line, name.removeprefix("core/"), changed))
    return mutants


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", type=Path, help="of the project")
    parser.add_argument("packages", nargs="+", help="of e3pose, such as select or edge/inbox")
    parser.add_argument("--count", type=int, default=150, help="mutants in all")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    mutants = sample(options.root.resolve(), options.packages, options.count, options.seed)
    print(json.dumps([asdict(mutant) for mutant in mutants]))


if __name__ == "__main__":
    main()
