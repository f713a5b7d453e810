"""Read a TOML file by the name of one in the package, or by the path of a user's."""

from __future__ import annotations

from collections.abc import Collection
from importlib import resources
from pathlib import Path
from typing import Any

from e3pose.base.bounded import parse_toml, read_toml
from e3pose.base.errors import InputError


def read_shipped(
    name_or_path: str | Path, package: str, names: Collection[str], what: str, limit_bytes: int
) -> tuple[dict[str, Any], str]:
    """Return the tables of a TOML file, and how to name it to a person.

    Args:
        name_or_path: one of `names`, or a path.
        package: that has the files of these names, `e3pose.energy.profiles`.
        names: of the files that come with the package, without `.toml`.
        what: they are, in words.
        limit_bytes: the most that is read of a file of the user.

    Raises:
        InputError: when there is no such file, or it is no TOML.
    """
    name = str(name_or_path)
    if name in names:
        text = resources.files(package).joinpath(f"{name}.toml").read_text(encoding="utf-8")
        where = f"{what} {name}"
        return parse_toml(text, where), where
    path = Path(name_or_path)
    if not path.is_file():
        raise InputError(
            f"{name[:200] or repr(name)}: {what}: no such file, "
            f"expected {', '.join(names)} or the path of a TOML file"
        )
    return read_toml(path, limit_bytes), str(path)
