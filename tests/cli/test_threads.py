"""Small matrices are computed on one thread, unless the user says otherwise."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

# The threads that come with the first large product of matrices, or at the import of numpy.
CODE = """
import os, sys
def threads(): return len(os.listdir("/proc/self/task"))
import {first}
import numpy
numpy.ones((512, 512)) @ numpy.ones((512, 512))
print(threads())
"""


@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="counts threads as Linux does")
def test_programs_multiply_on_one_thread_unless_told() -> None:
    def threads(first: str, **said: str) -> int:
        usual = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
        command = [sys.executable, "-c", CODE.format(first=first)]
        return int(subprocess.check_output(command, env={**usual, **said}))

    if threads("sys") == 1:
        pytest.skip("numpy has one thread here")
    assert threads("e3pose.cli") == 1
    assert threads("e3pose.cli", OPENBLAS_NUM_THREADS="2") == 2
