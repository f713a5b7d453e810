"""MCAP: the messages of `foxglove` in a file."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import foxglove

from e3pose.base.errors import InputError
from e3pose.base.private import make_file
from e3pose.site.streams.base import Source
from e3pose.site.streams.foxglove import CHANNELS, FoxgloveStream
from e3pose.site.streams.foxglove_server import Channel


class _File:
    """A file for the library, which says each write that fails on standard error, and goes on.

    Attributes:
        failure: of the first write that failed; nothing is written from then on.
    """

    def __init__(self, path: Path) -> None:
        self.failure: OSError | None = None
        self._file, self._at, self._end = path.open("wb"), 0, 0

    def write(self, content: bytes) -> int:
        self._try(self._file.write, content)
        self._at += len(content)
        self._end = max(self._end, self._at)
        return len(content)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + (0, self._at, self._end)[whence]
        self._try(self._file.seek, self._at)
        return self._at

    def flush(self) -> None:
        self._try(self._file.flush)

    def _try(self, function: Callable[..., object], *given: object) -> None:
        if self.failure is None:
            try:
                function(*given)
            except OSError as error:
                self.failure = error

    def close(self) -> None:
        told = self.failure is not None
        self.flush()
        with suppress(OSError):
            self._file.close()
        if self.failure is not None and not told:
            raise self.failure


def open_stream(place: str, source: Source) -> FoxgloveStream:
    """Return a stream into a new file, which is complete once it is closed."""
    path = Path(place)
    if path.suffix != ".mcap" or not path.parent.is_dir():
        raise InputError("target", repr(place[:80]), "mcap:FILE.mcap in a folder that exists")
    if path.exists():
        raise InputError("target", f"{path}, a file that is there", "a new one")
    make_file(path)  # poses are for their owner alone
    context, file = foxglove.Context(), _File(path)
    writer = foxglove.open_mcap(file, context=context)
    channels = {
        channel.topic: foxglove.Channel(
            channel.topic,
            message_encoding=channel.encoding,
            schema=_schema(channel),
            context=context,
        )
        for channel in CHANNELS
    }

    def log(
        topic: str, payload: bytes, time_ns: int, _held: foxglove.Context = context
    ) -> None:  # the context's channels close with it
        channels[topic].log(payload, log_time=time_ns)
        if file.failure is not None:
            raise file.failure

    def close() -> None:
        writer.close()
        file.close()

    return FoxgloveStream(source, log, close)


def _schema(channel: Channel) -> foxglove.Schema | None:
    if not channel.schema:
        return None
    return foxglove.Schema(name=channel.schema_name, encoding="protobuf", data=channel.schema)
