"""What an error tells a person, here and elsewhere."""

from __future__ import annotations

from tests.cases import each_case

from e3pose.base.errors import InputError, reason_of


@each_case(
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


@each_case(
    ("error", "reason"),
    [
        (
            FileNotFoundError(2, "No such file or directory", "/srv/x.db"),
            "No such file or directory",
        ),
        (OSError("the disk\n  is gone"), "the disk is gone"),
        (ValueError("line 1:\n no number"), "line 1: no number"),
        (TimeoutError(), "TimeoutError"),
    ],
)
def test_a_reason_is_one_line_without_its_file(error: Exception, reason: str) -> None:
    assert reason_of(error) == reason


@each_case(
    ("error", "words"),
    [
        (InputError("/srv/x.pem: file not found"), "/srv/x.pem: file not found"),
        (InputError("no certificate"), "/srv/x.pem: no certificate"),
        (InputError("until", "never", "a day"), "/srv/x.pem: until: found never, expected a day"),
        (InputError("no number", place="/srv/y"), "/srv/y: no number"),
        (InputError("/srv/x.pem2: file not found"), "/srv/x.pem: /srv/x.pem2: file not found"),
    ],
)
def test_a_place_is_said_once_and_the_nearest_counts(error: InputError, words: str) -> None:
    assert str(error.at("/srv/x.pem")) == words
