"""What a live site kept of a stretch of time, for the page of its store: videos, times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from e3pose.base.bounded import read_toml
from e3pose.base.errors import InputError
from e3pose.camera.provenance import load_provenance, save_provenance
from e3pose.camera.session_videos import BEGAN, PACE
from e3pose.recording import ProcessorTime, Recording
from e3pose.recording.folder import HEADER, MAX_HEADER_BYTES
from e3pose.recording.processor import load_processor
from e3pose.recording.videos import VIDEOS, begin_of, choose_video, videos_in

MOST = 1000  # recordings that are looked through, the newest


@contextmanager
def filmed(
    recording: Recording, folder: Path, began_ns: int, ended_ns: int, pace: float
) -> Iterator[tuple[Recording, Path | None]]:
    """Yield a recording with the videos of its time, and the folder that says where they begin.

    Args:
        recording: of a stretch, slot 0 at its beginning.
        folder: of the site's recordings and videos.
        began_ns: time of slot 0, since 1970.
        ended_ns: of the last slot.
        pace: seconds of the scene that passed in a second.
    """
    found = videos_of(folder, recording.rig.camera_ids, began_ns, ended_ns)
    if not found:
        yield recording, None
        return
    with TemporaryDirectory() as made:
        starts_s = {name: (began_ns - begin) / 1e9 * pace for name, (begin, _) in found.items()}
        save_provenance(Path(made), {}, starts_s)
        videos = {name: str(path.resolve()) for name, (_, path) in found.items()}
        yield replace(recording, videos=videos), Path(made)


def videos_of(
    folder: Path, camera_ids: tuple[str, ...], began_ns: int, ended_ns: int
) -> dict[str, tuple[int, Path]]:
    """Return by camera when its video of a stretch of time begins, since 1970, and where it is.

    Of several, the one that is in a recording, else the one that shows most of the stretch.
    """
    found: dict[str, tuple[int, Path]] = {}
    for part, zero_ns, header in _kept(folder, began_ns):
        with suppress(InputError, KeyError, ValueError, TypeError):
            starts_s, pace = load_provenance(part).video_starts_s, _pace(part)
            for name, file in header.get(VIDEOS, {}).items():
                if name in camera_ids:
                    begin_ns = zero_ns - round(starts_s[name] / pace * 1e9)
                    found.setdefault(name, (begin_ns, part / VIDEOS / file))
    for name in camera_ids:
        video = choose_video(videos_in(folder / VIDEOS / name), began_ns, ended_ns)
        if name not in found and video is not None:
            found[name] = begin_of(video) or 0, video
    return found


def processor_of(
    folder: Path, camera_ids: tuple[str, ...], began_ns: int
) -> Mapping[str, ProcessorTime]:
    """Return what cameras took, by the newest recording of a time that says so; empty without."""
    for part, _, _ in _kept(folder, began_ns):
        with suppress(InputError):
            if found := load_processor(part, camera_ids):
                return found
    return {}


def _kept(folder: Path, time_ns: int) -> Iterator[tuple[Path, int, dict[str, Any]]]:
    """Yield the recordings of a time, newest first, with when they begin and their headers."""
    for path in sorted(folder.glob(f"*/{HEADER}"), reverse=True)[:MOST]:
        with suppress(InputError, KeyError, ValueError, TypeError, ZeroDivisionError):
            header = read_toml(path, MAX_HEADER_BYTES)
            zero_ns = int(load_provenance(path.parent).settings[BEGAN])
            end_ns = zero_ns + round(header["num_slots"] / header["fps"] / _pace(path.parent) * 1e9)
            if zero_ns <= time_ns <= end_ns:
                yield path.parent, zero_ns, header


def _pace(part: Path) -> float:
    return float(load_provenance(part).settings[PACE])
