"""Readers of research data sets."""

import os
from pathlib import Path


def shared_folder() -> Path:
    """Return the folder of real recordings, which the variable E3POSE_SHARED names.

    Raises:
        SystemExit: with what is missing.
    """
    named = os.environ.get("E3POSE_SHARED", "")
    if not (named and (Path(named) / "data").is_dir()):
        missing = f"{named!r} has no folder data" if named else "it is not set"
        raise SystemExit(f"E3POSE_SHARED must name the folder of the real recordings: {missing}")
    return Path(named)
