"""The plain numpy forms of the compiled kernels, which live with the tests."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))

from tests.reference import attention_network as attention_network
from tests.reference.filter_step import step as step
from tests.reference.fuse import ReferenceFuser as ReferenceFuser
