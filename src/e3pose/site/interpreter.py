"""Reduce pauses of the Python interpreter in real-time programs."""

from __future__ import annotations

import gc
import sys

SWITCH_S = 5e-4  # a thread that a message woke waits this long for one that computes, not 5 ms


def reduce_pauses() -> None:
    """Let waking threads have their turn sooner, and collect no garbage among what stays.

    To be called once everything is loaded. What is there then, some hundred thousand objects of
    compilers and libraries, takes half a second to look through, and none of it will ever go.
    """
    sys.setswitchinterval(SWITCH_S)
    gc.collect()
    gc.freeze()
