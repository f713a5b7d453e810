"""Say how many there are of a thing, as a person would."""

from __future__ import annotations


def counted(number: float, one: str, many: str = "") -> str:
    """Return `1 slot`, `2 slots`, `1.5 cameras`, `3 people`.

    Args:
        number: of them.
        one: what one of them is called.
        many: what several are called; with an s by default.
    """
    said = str(number) if isinstance(number, int) else f"{number:g}"
    return f"{said} {one if number == 1 else many or one + 's'}"
