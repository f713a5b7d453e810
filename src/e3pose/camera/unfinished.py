"""The folder of an interrupted detection, from which the same command resumes."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import msgspec

from e3pose.base.atomic import write_file
from e3pose.base.bounded import UNDECODABLE, read_bytes
from e3pose.base.errors import InputError
from e3pose.recording import decode_view
from e3pose.recording.json_lines import cut_torn

STATE = "unfinished.json"
LOCK = "lock"  # of earlier versions
MAX_STATE_BYTES = 2**20


class State(msgspec.Struct, forbid_unknown_fields=True):
    """Settings of an unfinished detection, and damage in its finished videos."""

    format: Literal["e3pose-unfinished-detection"]
    version: Literal[1]
    settings: dict[str, str]
    done: dict[str, str]


class Unfinished:
    """An unfinished detection in `folder`: one growing file of lines per camera, and its settings.

    Args:
        folder: made if missing; continued if it was begun with the same `settings`.
        settings: all that decides what the lines hold, by name.
        restart: whether to begin anew where the settings differ.

    Raises:
        InputError: when the folder is something else, or was begun with other settings.
    """

    def __init__(self, folder: Path, settings: Mapping[str, str], restart: bool = False) -> None:
        self.folder = folder
        state = self._load(settings, restart)
        self.resumed = state is not None
        self._state = state or State("e3pose-unfinished-detection", 1, dict(settings), {})
        (folder / "keypoints").mkdir(exist_ok=True)
        self._save()

    def path(self, camera_id: str) -> Path:
        """Return the camera's file of lines."""
        return self.folder / "keypoints" / f"{camera_id}.jsonl"

    def damage(self, camera_id: str) -> str | None:
        """Return the damage of a video that was read to its end; None before the end."""
        return self._state.done.get(camera_id)

    def mark_done(self, camera_id: str, damage: str) -> None:
        """Note that the camera's video has been read to its end, and its damage."""
        self._state.done[camera_id] = damage
        self._save()

    def last_slot(self, camera_id: str, num_joints: int) -> int:
        """Drop a torn last line and return the slot of the last whole one; -1 if there is none."""
        path = self.path(camera_id)
        if not path.is_file():
            return -1
        _, line = cut_torn(path)
        return decode_view(line, num_joints, f"{path}: last line")[0] if line else -1

    def remove(self) -> None:
        """Delete the folder; its lines have been written elsewhere."""
        shutil.rmtree(self.folder)

    def _load(self, settings: Mapping[str, str], restart: bool) -> State | None:
        path = self.folder / STATE
        if not path.is_file():
            others = {entry.name for entry in self.folder.iterdir()} - {LOCK, "keypoints"}
            if any(not name.startswith(f".{STATE}.") for name in others):
                raise InputError(
                    f"{self.folder}: found a folder without {STATE}, expected room for unfinished "
                    "work; move it away"
                )
            return None
        try:
            state = msgspec.json.decode(read_bytes(path, MAX_STATE_BYTES), type=State)
        except UNDECODABLE as error:
            raise InputError(f"{path}: {str(error)[:200]}; delete {self.folder}") from None
        differing = [
            f"{name}: {state.settings.get(name, 'none')}, now {settings.get(name, 'none')}"
            for name in sorted(state.settings.keys() | settings.keys())
            if state.settings.get(name) != settings.get(name)
        ]
        if not differing:
            return state
        if not restart:
            raise InputError(
                f"{self.folder}: was begun with other settings ({'; '.join(differing)}); repeat "
                "that command to continue, or pass --overwrite to start again"
            )
        shutil.rmtree(self.folder / "keypoints", ignore_errors=True)
        return None

    def _save(self) -> None:
        write_file(
            self.folder / STATE, msgspec.json.format(msgspec.json.encode(self._state), indent=2)
        )
