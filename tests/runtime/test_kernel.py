"""When a compiled kernel on disk may be used again."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from tests.test_docs import ROOT

from e3pose.estimate.filter.kernels.step import step_slot
from e3pose.runtime import kernel as compiling


def test_kernel_on_disk_is_stamped_with_sources_and_constants() -> None:
    names = {path.name for path in compiling.FILTER_SOURCES}
    assert {"step.py", "update.py", "undistort.py", "triangulate.py"} <= names
    stamp = compiling.sources_stamp(compiling.FILTER_SOURCES)
    assert step_slot._cache._cache_file._source_stamp == stamp  # type: ignore[attr-defined]
    assert compiling.sources_stamp(compiling.FILTER_SOURCES[:-1]) != stamp


@pytest.mark.parametrize(
    ("kernels", "sources"),
    [
        ("estimate/filter/kernels", compiling.FILTER_SOURCES),
        ("select/kernels", compiling.SELECTION_SOURCES),
        ("predict/kernels", compiling.PREDICTOR_SOURCES),
    ],
)
def test_constants_that_kernels_take_over_are_in_the_stamp(
    kernels: str, sources: tuple[Path, ...]
) -> None:
    """A constant has a name in capitals; a kernel on disk would keep an old one."""
    package = ROOT / "src" / "e3pose"
    stamped = {path.relative_to(package).with_suffix("") for path in sources}
    for path in (package / kernels).glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("e3pose."):
                constants = [each.name for each in node.names if each.name.isupper()]
                module = Path(*(node.module or "").split(".")[1:])
                assert not constants or module in stamped, f"{path.name}: {module} {constants}"


def test_index_on_disk_of_another_version_is_stale_and_no_error() -> None:
    def broken() -> dict[object, str]:
        raise AttributeError("Can't get attribute 'Scratch'")

    assert compiling._or_nothing(broken)() == {}
    assert compiling._or_nothing(lambda: {1: "file"})() == {1: "file"}
