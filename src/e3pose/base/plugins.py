"""Plug-ins: find a policy, predictor, estimator or detector by its name.

A name is a key of the family's table, an entry point of an installed package (group
`e3pose.policies` and so on), or `module:Name`. See docs/how-to/own-parts.md.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import re
import sys
from collections.abc import Callable, Mapping
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, TypeVar

from e3pose.base.errors import InputError

T = TypeVar("T")

OWN = re.compile(r"(?P<module>[^:]+):(?P<name>[A-Za-z_]\w*)")
DOTTED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
FILE_ENDING = ".py"


def member(group: str, thing: str, name: str, known: Mapping[str, T], more: str = "") -> T:
    """Return the member of a family that a name stands for.

    Args:
        group: the entry points that belong to the family, such as `e3pose.policies`.
        thing: what it is called in errors.
        name: a key of `known`, an entry point, or `module:Name`, where the module is one that can
            be imported or a file that ends in `.py`.
        known: the family's own table.
        more: what else may be written, for the error.

    Raises:
        InputError: listing the known names, or saying what is wrong with one's own.
    """
    if name in known:
        return known[name]
    offered = {point.name: point for point in entry_points(group=group)}
    listed = f"one of {', '.join([*known, *sorted(offered)])}{more}, or module:Name"
    if is_own(name):
        return _own(thing, name, listed)  # type: ignore[no-any-return]
    if name in offered:
        return offered[name].load()  # type: ignore[no-any-return]
    raise InputError(thing, repr(name[:80]), listed)


def is_offered(group: str, name: str, known: Mapping[str, object]) -> bool:
    """Return whether a family or an installed package has a member of this name."""
    return name in known or any(point.name == name for point in entry_points(group=group))


def maker(
    group: str, thing: str, name: str, known: Mapping[str, Callable[..., T]], more: str = ""
) -> Callable[..., T]:
    """Return the factory of a family's member; see `member`.

    One of one's own may be a function with the arguments of the family's makers, a class, which is
    called without any, or the finished object.
    """
    return making(member(group, thing, name, known, more))


def making(found: Any) -> Callable[..., Any]:
    """Return the factory of a member, from the object that its name stands for; see `maker`."""
    if isinstance(found, type):
        return lambda *_: found()
    if inspect.isroutine(found) or isinstance(found, partial):
        return found
    return lambda *_: found


def is_own(name: str) -> bool:
    """Return whether a name is written as `module:Name`."""
    match = OWN.fullmatch(name)
    return match is not None and (
        match["module"].endswith(FILE_ENDING) or DOTTED.fullmatch(match["module"]) is not None
    )


def beside(name: str, folder: Path) -> str:
    """Return `module:Name` as the file of that module in a folder, where there is one."""
    match = OWN.fullmatch(name)
    if match is None or not is_own(name):
        return name
    file = match["module"].removesuffix(FILE_ENDING).replace(".", "/") + FILE_ENDING
    path = folder / file
    return f"{path.resolve()}:{match['name']}" if path.is_file() else name


def _own(thing: str, name: str, expected: str) -> Any:
    match = OWN.fullmatch(beside(name, Path()))
    assert match is not None
    place, wanted = match["module"], match["name"]
    try:
        module = (
            _file(Path(place)) if place.endswith(FILE_ENDING) else importlib.import_module(place)
        )
    except (ImportError, OSError) as error:
        raise InputError(thing, f"{name!r}, but {error}", expected) from None
    if not hasattr(module, wanted):
        raise InputError(thing, f"no {wanted} in {place}", expected)
    return getattr(module, wanted)


def _file(path: Path) -> Any:
    if not path.is_file():
        raise ImportError(f"there is no file {path}")
    name = f"e3pose_own_{path.stem}_{abs(hash(str(path.resolve()))):x}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python module")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
