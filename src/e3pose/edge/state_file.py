"""The file with an edge's state, written every second and read at startup."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from e3pose.base.errors import InputError
from e3pose.edge.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from e3pose.pipeline import Pipeline, step
from e3pose.wire.codec import one_line


@dataclass(slots=True, eq=False)
class StateFile:
    """Saves and loads the state of a loop.

    Attributes:
        pipeline: the parts of the loop, as it begins.
        path: the file; None saves nothing.
        report: called with the kind and message of an event; a lasting fault is reported once.
        run_ns: when the run began: that of the resumed state, if there is one; for what is saved.
        problem: why the state cannot be saved at present; empty if it can.
    """

    pipeline: Pipeline
    path: Path | None
    report: Callable[[str, str], None]
    run_ns: int = 0
    problem: str = ""
    _found: Checkpoint | None = None
    _loaded: bool = False

    def keep(self, made: Checkpoint) -> None:
        """Save a state; a full disk is no reason to stop."""
        if self.path is None:
            return
        try:
            save_checkpoint(self.path, made, self.pipeline)
        except (InputError, OSError) as error:
            if not self.problem:
                self.problem = one_line(str(error))
                self.report("checkpoint", f"cannot save the state: {self.problem}")
            return
        if self.problem:
            self.problem = ""
            self.report("checkpoint", "saving the state again")

    def take_up(self) -> Checkpoint | None:
        """Return the saved state; None if there is none or it is unusable and was moved aside."""
        if self._loaded or self.path is None or not self.path.exists():
            return self._found
        self._loaded = True
        try:
            found = load_checkpoint(self.path, self.pipeline)
            self._try(self.path, found)
        except InputError as error:
            self._set_aside(self.path, error)
            return None
        self._found, self.run_ns = found, found.run_ns
        return found

    def _try(self, path: Path, found: Checkpoint) -> None:
        """Raise `InputError` if the loop fails on a state, as it would at every start."""
        everybody = np.ones(len(self.pipeline.rig), dtype=bool)
        try:
            step(replace(self.pipeline, lead_slots=found.lead_slots), found.state, {}, everybody)
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
