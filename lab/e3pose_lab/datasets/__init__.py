"""Readers of research data sets."""

import os
from pathlib import Path


def shared_folder() -> Path:
    """Return the folder of real recordings, which the variable E3POSE_SHARED names.

    Raises:
        SystemExit: with what is missing.
    """
    shared = Path(os.environ.get("E3POSE_SHARED", os.devnull))
    if not (shared / "data").is_dir():
        raise SystemExit("set E3POSE_SHARED to the folder of the real recordings, which has data/")
    return shared
