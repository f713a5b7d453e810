"""The name of a thread as the system's tools show it (`top -H`), where that can be set."""

from __future__ import annotations

import threading
from pathlib import Path

MOST = 15  # characters that Linux keeps


def show_thread_name() -> None:
    """Give the running thread the name that it has in Python; does nothing beside Linux."""
    thread = threading.current_thread()
    try:
        # Opened to be changed, not made: elsewhere there is no such file.
        with Path(f"/proc/self/task/{thread.native_id}/comm").open("r+", encoding="utf-8") as file:
            file.write(thread.name[:MOST])
    except OSError:
        return
