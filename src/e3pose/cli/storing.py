"""The store as an option: what a verb's slots are kept in, and for how long."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Parameter

from e3pose import __version__
from e3pose.base.errors import InputError
from e3pose.base.quantities import age_s, plural, size_bytes
from e3pose.cli.options import STORE, as_typed
from e3pose.model.skeleton import own_file
from e3pose.store.rows import Run

if TYPE_CHECKING:
    from e3pose.energy.profiles import DeviceProfile, Mode
    from e3pose.pipeline import SlotRecord
    from e3pose.recording import Recording
    from e3pose.store import Retention


@Parameter(name="*", group=STORE)
@dataclass(frozen=True, kw_only=True)
class StoreOptions:
    """Where every slot is kept, for every verb that runs the loop."""

    store: str | None = None
    """Store every slot in this database, for `e3pose query`: a file such as `live.db`, or a URL."""
    keep: str | None = None
    """Retention: delete slots older than this, such as `30d` or `12h`."""
    max_size: Annotated[str | None, Parameter(name="--max-size")] = None
    """Retention: delete the oldest slots beyond this size, such as `20GB`."""

    def file(self) -> Path | None:
        """Return the file that the store is, None for a database elsewhere, or none at all."""
        if self.store is None:
            return None
        from e3pose.store.database import database_path, database_url

        return database_path(database_url(self.store))

    def retention(self) -> Retention:
        """Return the retention; raise `InputError` for a value that is no age or size."""
        from e3pose.store import Retention

        if self.store is None and (self.keep or self.max_size):
            raise InputError("--keep, --max-size: found no --store, expected one to keep them in")
        with as_typed({"": "--keep"}):
            max_age_s = None if self.keep is None else age_s(self.keep)
        with as_typed({"": "--max-size"}):
            max_bytes = None if self.max_size is None else size_bytes(self.max_size)
        return Retention(max_age_s, max_bytes)


def stored(
    records: Iterable[SlotRecord],
    options: StoreOptions,
    recording: Recording,
    name: str,
    profiles: Sequence[DeviceProfile],
    idle_mode: Mode,
) -> Iterator[SlotRecord]:
    """Yield records of a replay and keep each in the store that the options name, if they do.

    Energy is what the profiles, one a camera, say of the cameras that were ordered; times count
    from now.

    Raises:
        InputError: when the store cannot be written, at the start or before the end.
    """
    if options.store is None:
        yield from records
        return
    from e3pose.store import StoreWriter, WriterSettings

    run = Run(
        site=recording.name,
        name=name,
        started_ns=time.time_ns(),
        interval_s=recording.interval_s,
        skeleton=recording.skeleton.name,
        joints=recording.skeleton.joints,
        cameras=tuple(camera.camera_id for camera in recording.rig.cameras),
        software=f"e3pose {__version__}",
        own_skeleton=own_file(recording.skeleton),
    )
    active_j = np.array([each.watts("active") for each in profiles]) * recording.interval_s
    idle_j = np.array([each.watts(idle_mode) for each in profiles]) * recording.interval_s
    settings = WriterSettings(retention=options.retention())
    with StoreWriter(options.store, run, settings) as writer:
        for record in records:
            spent_j = np.where(record.selected, active_j, idle_j)
            writer.append(record, energy_j=spent_j, wait=True)
            yield record
        writer.flush(60.0)
        status = writer.status()
    if status.problem is not None or status.shed:
        raise InputError(
            f"{Path(options.store).name}: {plural(status.spooled, 'row')} not stored, "
            f"{status.shed} given up ({status.problem or 'no room'}), "
            "expected a database that takes them all"
        )
