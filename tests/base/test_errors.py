"""What an error tells whoever is not of this machine."""

from __future__ import annotations

import pytest

from e3pose.base.errors import InputError


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (InputError("/srv/lab/x.db: found no poses"), "found no poses"),
        (InputError("C:\\lab\\x.db: found no poses"), "found no poses"),
        (InputError("postgresql://ada@db.local/lab: cannot be read"), "cannot be read"),
        (
            InputError("time", "3 slots", "fewer", "/srv/x.db"),
            "time: found 3 slots, expected fewer",
        ),
        (InputError("/srv/x.db", "no such file", "one"), "x.db: found no such file, expected one"),
        (InputError("region: found 1/2, expected x,y"), "region: found 1/2, expected x,y"),
    ],
)
def test_folders_are_for_this_machine_alone(error: InputError, words: str) -> None:
    assert str(error.elsewhere()) == words
