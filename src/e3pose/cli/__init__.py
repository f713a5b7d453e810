"""The command line: parse, load, call one function, print."""

import os

# Before numpy is imported. Matrices here are small: several threads for each of them make a
# smoother seven times as slow, and twenty times on a machine that is busy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from e3pose.cli.app import main as main
