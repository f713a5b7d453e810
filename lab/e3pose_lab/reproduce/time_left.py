"""How long the rest of a reproduction takes."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from rich.progress import BarColumn, ProgressColumn, Task, TextColumn
from rich.text import Text

from e3pose.cli.progress import bar, notice_compiling
from e3pose_lab.reproduce.work import AnyPiece

# Seconds of one core by kind of work of a full run, as they were on a server of 2026; of what
# shares the cores, only the proportions matter.
EXPECTED_S = {
    "replays-replayed": 0.25,
    "without_truth-likeness": 3.0,
    "without_truth-outside": 2.0,
    "site_memory-site_memory": 19.0,
    "timeline-rates": 20.0,
    "live_video-live_video": 120.0,
}
OTHERS_S = 2.0
FILTERED = 3.0  # times as long as a replay of the paper's pipeline, with the pipeline `memory`
TRUSTED_S = 60.0  # of work: until about so much is done, what is expected counts more than the pace
LINE_S = 60.0  # between two lines on a pipe


class TimeLeft:
    """Time left for pieces of work, by their expected durations and the pace so far.

    Pieces that share the cores have a pace, and those that measure time, one after another at the
    end, another one.

    Args:
        pieces: to be done; none that is kept already.
        jobs: processes that share the work.
        clock: seconds.
    """

    def __init__(
        self, pieces: Sequence[AnyPiece], jobs: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock = clock
        self._left = {times: 0.0 for times in (False, True)}
        for piece in pieces:
            self._left[piece.times] += expected_s(piece)
        self.total_s = sum(self._left.values())
        # By kind: work done and what it took, begun as if some had been done as expected.
        self._done = {False: TRUSTED_S, True: TRUSTED_S}
        self._spent_s = {False: TRUSTED_S / jobs, True: TRUSTED_S}
        self._last_s = clock()

    @property
    def done_s(self) -> float:
        """Work that is done, in the seconds that it was expected to take."""
        return self.total_s - sum(self._left.values())

    def done(self, piece: AnyPiece) -> None:
        """Take note that a piece is done."""
        now_s = self._clock()
        self._spent_s[piece.times] += now_s - self._last_s
        self._done[piece.times] += expected_s(piece)
        self._left[piece.times] -= expected_s(piece)
        self._last_s = now_s

    def left_s(self) -> float:
        """Return the seconds that the rest takes: falling between pieces, above 0 while any is."""
        at_last_s = sum(
            left * self._spent_s[times] / self._done[times] for times, left in self._left.items()
        )
        if at_last_s <= 0:
            return 0.0
        return at_last_s * math.exp(-(self._clock() - self._last_s) / at_last_s)


def expected_s(piece: AnyPiece) -> float:
    """Return the seconds that one core is expected to take for a piece."""
    asked = getattr(piece.settings, "asked", piece.settings)
    factor = FILTERED if getattr(asked, "pipeline", None) == "memory" else 1.0
    return factor * EXPECTED_S.get(piece.name, OTHERS_S)


def duration_text(seconds: float) -> str:
    """Return a time left for people, coarse enough not to pretend."""
    if seconds < 90:
        return f"about {max(10 * math.ceil(seconds / 10), 10)} s left"
    minutes = seconds / 60
    return f"about {minutes:.0f} min left" if minutes < 90 else f"about {minutes / 60:.1f} h left"


class _Column(ProgressColumn):
    def __init__(self, left: TimeLeft) -> None:
        super().__init__()
        self._left = left

    def render(self, task: Task) -> Text:
        return Text(duration_text(self._left.left_s()))


def tracked(
    results: Iterable[tuple[AnyPiece, Any]], pieces: Sequence[AnyPiece], jobs: int
) -> Iterator[tuple[AnyPiece, Any]]:
    """Yield results while a bar shows how far the work is, or a line a minute on a pipe."""
    notice_compiling()
    left = TimeLeft(pieces, jobs)
    columns = TextColumn("reproduce"), BarColumn(), TextColumn("{task.percentage:.0f} %")
    next_s = time.monotonic() + LINE_S
    with bar("reproduce", *columns, _Column(left), transient=False) as progress:
        for number, (piece, result) in enumerate(results, 1):
            left.done(piece)
            progress(left.done_s, left.total_s)
            if not sys.stderr.isatty() and time.monotonic() > next_s and number < len(pieces):
                next_s = time.monotonic() + LINE_S
                rest = duration_text(left.left_s())
                print(f"e3pose: {number} of {len(pieces)} pieces, {rest}", file=sys.stderr)
            yield piece, result
