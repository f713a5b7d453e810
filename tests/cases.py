"""Tables of cases in one test: all of them run, and each that fails is named."""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest

SHOWN = 10  # failures that are told in full


def each_case(
    names: str | Sequence[str],
    table: Iterable[Any],
    ids: Iterable[str] | Callable[[Any], object] | None = None,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Run a test once for each case of a table; see `pytest.mark.parametrize`.

    The cases are one test: what is collected and set up once for all of them takes longer than
    most of them do. Each case has a folder, a monkeypatch and an output of its own; other fixtures
    are shared, and so a test that changes those is parametrized instead.

    Args:
        names: of the arguments, separated by commas.
        table: a value for each name, or the value itself where there is one name.
        ids: what a case is called, or what makes that of a value.
    """
    arguments = [name.strip() for name in names.split(",")] if isinstance(names, str) else [*names]
    cases = [_values(case, len(arguments)) for case in table]
    assert cases, "a table without cases tests nothing"
    if ids is None or callable(ids):
        called = ["-".join(_name(value, ids) for value in case) for case in cases]
    else:
        called = [*ids]

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        def run_all(**fixtures: Any) -> None:
            failed: list[str] = []
            skipped: list[BaseException] = []
            for number, (name, case) in enumerate(zip(called, cases, strict=True)):
                try:
                    _run(test, dict(zip(arguments, case, strict=True)), fixtures, number)
                except pytest.skip.Exception as skip:
                    skipped.append(skip)
                except (Exception, pytest.fail.Exception) as error:
                    shown = "".join(traceback.format_exception(error)[-4:])
                    failed.append(f"{name}: {shown if len(failed) < SHOWN else error}")
            if failed:
                pytest.fail(
                    f"{len(failed)} of {len(cases)} cases:\n" + "\n".join(failed), pytrace=False
                )
            if len(skipped) == len(cases):
                raise skipped[0]

        signature = inspect.signature(test)
        run_all.__name__, run_all.__doc__ = test.__name__, test.__doc__
        run_all.__module__, run_all.__qualname__ = test.__module__, test.__qualname__
        run_all.__dict__.update(vars(test))  # marks
        run_all.__signature__ = signature.replace(  # type: ignore[attr-defined]
            parameters=[p for name, p in signature.parameters.items() if name not in arguments]
        )
        return run_all

    return decorate


def _run(
    test: Callable[..., None], case: dict[str, Any], fixtures: dict[str, Any], number: int
) -> None:
    own = dict(fixtures)
    if "tmp_path" in own:
        own["tmp_path"] = Path(own["tmp_path"]) / f"case{number}"
        own["tmp_path"].mkdir()
    if "capsys" in own:
        own["capsys"].readouterr()
    with pytest.MonkeyPatch.context() as patched:
        if "monkeypatch" in own:
            own["monkeypatch"] = patched
        test(**own, **case)


def _values(case: Any, count: int) -> tuple[Any, ...]:
    return (case,) if count == 1 else tuple(case)


def _name(value: Any, shown: Callable[[Any], object] | None) -> str:
    return str(shown(value) if shown else value)[:60]
