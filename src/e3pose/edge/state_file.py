"""The file with an edge's state, written every second and read at the start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from e3pose.edge.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from e3pose.errors import InputError
from e3pose.pipeline import Pipeline, step
from e3pose.wire.codec import one_line


@dataclass(slots=True, eq=False)
class StateFile:
    """Where the state of the loop is kept.

    Attributes:
        path: the file; None keeps nothing.
        report: called with the kind and message of an event; a lasting fault is reported once.
        run_ns: when the run began: that of the state that is taken up, if there is one.
        trouble: why the state cannot be kept at present; empty if it can.
    """

    path: Path | None
    report: Callable[[str, str], None]
    run_ns: int
    trouble: str = ""
    _found: Checkpoint | None = None
    _looked: bool = False

    def keep(self, made: Checkpoint, pipeline: Pipeline) -> None:
        """Keep a state; a disk that is full is no reason to stop."""
        if self.path is None:
            return
        try:
            save_checkpoint(self.path, made, pipeline)
        except (InputError, OSError) as error:
            if not self.trouble:
                self.trouble = one_line(str(error))
                self.report("checkpoint", f"cannot save the state: {self.trouble}")
            return
        if self.trouble:
            self.trouble = ""
            self.report("checkpoint", "saving the state again")

    def take_up(self, pipeline: Pipeline) -> Checkpoint | None:
        """Return the state that was kept; None, and the old file set aside, if it is of no use."""
        if self._looked or self.path is None or not self.path.exists():
            return self._found
        self._looked = True
        try:
            found = load_checkpoint(self.path, pipeline)
            self._try(self.path, found, pipeline)
        except InputError as error:
            self._set_aside(self.path, error)
            return None
        self._found, self.run_ns = found, found.run_ns
        return found

    def _try(self, path: Path, found: Checkpoint, pipeline: Pipeline) -> None:
        """Raise `InputError` if the loop fails on a state, as it would at every start from now."""
        everybody = np.ones(len(pipeline.rig), dtype=bool)
        try:
            step(replace(pipeline, lead_slots=found.lead_slots), found.state, {}, everybody)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"[:120]
            raise InputError(f"{path}: found a state that the loop fails on ({reason})") from None

    def _set_aside(self, path: Path, error: InputError) -> None:
        aside = path.with_name(path.name + ".unusable")
        try:
            path.replace(aside)
        except OSError:
            self.report("checkpoint", f"started without the saved state: {error}")
            return
        self.report("checkpoint", f"started without the saved state, moved to {aside}: {error}")
