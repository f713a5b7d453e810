"""The one error that means "your input is wrong"."""

from __future__ import annotations


class InputError(ValueError):
    """A file, option or message is not what it should be.

    The message is one line a user can act on: it names the file, camera or field, what was found
    and what was expected. The command line prints it and exits with code 2.
    """
