"""The Protocol of an item: its pieces of work and its section of the report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from e3pose.base.quantities import plural
from e3pose_lab.reproduce.records import Section
from e3pose_lab.reproduce.work import AnyPiece, Made


@dataclass(frozen=True, slots=True)
class Scale:
    """How much is done.

    Attributes:
        quick: as little as shows that everything works, in minutes.
        data: names of the data sets that are there.
        most_seeds: of any item; None for as many as it asks for.
        detectors: what found the keypoints, by data set.
    """

    quick: bool = False
    data: tuple[str, ...] = ()
    most_seeds: int | None = None
    detectors: Mapping[str, str] = field(default_factory=dict)

    def of(self, full: int, quick: int) -> int:
        """Return how many of something: slots, seconds, places of a sweep."""
        return quick if self.quick else full

    def seeds(self, full: int, quick: int) -> int:
        """Return how many repetitions, at most those that were asked for."""
        wanted = self.of(full, quick)
        return wanted if self.most_seeds is None else min(wanted, self.most_seeds)

    def repeats(self, full: int, quick: int) -> str:
        """Return the number of repetitions as `1 seed` or `5 seeds`."""
        return plural(self.seeds(full, quick), "seed")


@dataclass(frozen=True, slots=True)
class Item:
    """A table or figure of the paper.

    Attributes:
        key: of its files.
        title: of its section.
        label: of the table or figure in the paper's source; empty for what the paper has not.
        pieces: what is to be computed.
        section: what is shown.
        needs: names of data sets, `sources.SHELF` and `sources.PANOPTIC`.
        imports: libraries of the extra `reproduce`, as they are imported.
    """

    key: str
    title: str
    label: str
    pieces: Callable[[Scale], Sequence[AnyPiece]]
    section: Callable[[Scale, Made], Section]
    needs: tuple[str, ...] = ()
    imports: tuple[str, ...] = ()
