"""When a compiled kernel on disk may be used again."""

from __future__ import annotations

from e3pose.estimate.filter.kernels.step import step_slot
from e3pose.runtime import kernel as compiling


def test_kernel_on_disk_is_stamped_with_sources_and_constants() -> None:
    names = {path.name for path in compiling.FILTER_SOURCES}
    assert {"step.py", "update.py", "undistort.py", "triangulate.py"} <= names
    assert {"bias.py", "motion.py", "state.py"} <= names  # constants
    stamp = compiling.sources_stamp(compiling.FILTER_SOURCES)
    assert step_slot._cache._cache_file._source_stamp == stamp  # type: ignore[attr-defined]
    assert compiling.sources_stamp(compiling.FILTER_SOURCES[:-1]) != stamp


def test_index_on_disk_of_another_version_is_stale_and_no_error() -> None:
    def broken() -> dict[object, str]:
        raise AttributeError("Can't get attribute 'Scratch'")

    assert compiling._or_nothing(broken)() == {}
    assert compiling._or_nothing(lambda: {1: "file"})() == {1: "file"}
