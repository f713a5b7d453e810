"""Reduce pauses of the Python interpreter in programs that run for months, and their memory."""

from __future__ import annotations

import ctypes
import gc
import sys
from contextlib import suppress

SWITCH_S = 5e-4  # a thread that a message woke waits this long for one that computes, not 5 ms
HEAPS = 2
_M_ARENA_MAX = -8  # in malloc.h of the GNU C library


def bound_heaps() -> None:
    """Have all threads share two heaps of the C library; to be called before there are threads.

    It gives each new thread one of eight heaps for each core. Threads that check the store or
    answer a viewer live for a moment, and what their heaps keep grew by 80 MB in an hour.
    """
    with suppress(AttributeError, OSError):  # of another C library, which has no such heaps
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, HEAPS)


def reduce_pauses() -> None:
    """Switch threads sooner, and exclude long-lived objects from garbage collection.

    To be called once everything is loaded. What is there then, some hundred thousand objects of
    compilers and libraries, takes half a second to look through, and none of it will ever go.
    """
    sys.setswitchinterval(SWITCH_S)
    gc.collect()
    gc.freeze()
