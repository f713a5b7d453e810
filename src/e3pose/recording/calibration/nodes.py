"""Parse YAML of OpenCV's FileStorage without OpenCV.

Every scalar stays text and every tag is ignored, so nothing in a file can name a Python object and
a camera called `01` does not become the number 1. Aliases, which can make a small file expand to a
huge one, are refused, and so are values nested deeper than any calibration is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from e3pose.base.errors import InputError, reason_of
from e3pose.base.installing import not_installed
from e3pose.recording.calibration import fields

if TYPE_CHECKING:
    import yaml

MAX_NODES = 200_000
MAX_DEPTH = 32  # OpenCV and EasyMocap write at most four


def parse_json(path: Path, text: str) -> Any:
    """Return the content of a calibration's JSON; raise `InputError` for other text."""

    def unique(pairs: list[tuple[str, Any]]) -> Mapping[str, Any]:
        named = dict(pairs)
        if len(named) < len(pairs):
            raise InputError(f"{path}: found a field that is given twice")
        return named

    try:
        return json.loads(text, object_pairs_hook=unique)
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: found text that is not JSON: {str(error)[:120]}") from None


def load_nodes(path: Path) -> dict[str, Any]:
    """Return the named nodes of an OpenCV YAML file."""
    return parse(path, fields.read_text(path))


def parse(path: Path, text: str) -> dict[str, Any]:
    """Return the named nodes of OpenCV YAML text."""
    try:
        import yaml
    except ImportError:
        raise InputError(f"{path}: {not_installed('PyYAML', 'edge')}") from None

    class Loader(yaml.BaseLoader):
        nodes = 0

        # PyYAML reads ahead a thousand characters before it parses, and looks at every open bracket
        # for each token, so the depth is limited where tokens are read.
        def fetch_more_tokens(self) -> None:
            if self.flow_level + len(self.indents) > MAX_DEPTH:
                raise InputError(
                    f"line {self.line + 1}",
                    "values nested too deep",
                    f"at most {MAX_DEPTH} levels",
                    place=str(path),
                )
            super().fetch_more_tokens()

        def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
            self.nodes += 1
            if self.nodes > MAX_NODES:
                raise InputError(f"{path}: found more than {MAX_NODES} values")
            if self.check_event(yaml.events.AliasEvent):
                raise InputError(f"{path}: found a YAML alias, expected plain values")
            return super().compose_node(parent, index)

        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
            names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
            if len(set(names)) < len(node.value):
                line = node.start_mark.line + 1
                raise InputError(f"{path}: line {line}: found a field that is given twice")
            return super().construct_mapping(node, deep=deep)

    # OpenCV's first line is `%YAML:1.0`, which is not the directive YAML knows.
    body = "\n".join(line for line in text.splitlines() if not line.startswith("%YAML"))
    try:
        document = yaml.load(body, Loader)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = reason_of(error)[:120]
        raise InputError(f"{path}: found text that is not YAML: {reason}") from None
    return dict(fields.table(document, f"{path}"))
