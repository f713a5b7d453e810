"""What all tests need of the process they run in."""

from __future__ import annotations

import signal

from hypothesis import settings

# The same examples in every run. Others are found, and worth looking for, with
# pytest --hypothesis-profile=default
settings.register_profile("fixed", derandomize=True)
settings.load_profile("fixed")

# Started in the background of a shell, a process ignores Ctrl-C, and so would all that it starts:
# tests that interrupt a program would wait for it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
