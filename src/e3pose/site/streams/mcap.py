"""MCAP: the messages of `foxglove` in a file."""

from __future__ import annotations

from pathlib import Path

import foxglove

from e3pose.base.errors import InputError
from e3pose.base.private import make_file
from e3pose.site.streams.base import Source
from e3pose.site.streams.foxglove import CHANNELS, FoxgloveStream
from e3pose.site.streams.foxglove_server import Channel


def open_stream(place: str, source: Source) -> FoxgloveStream:
    """Return a stream into a new file, which is complete once it is closed."""
    path = Path(place)
    if path.suffix != ".mcap" or not path.parent.is_dir():
        raise InputError("target", repr(place[:80]), "mcap:FILE.mcap in a folder that exists")
    if path.exists():
        raise InputError("target", f"{path}, a file that is there", "a new one")
    make_file(path)  # poses are for their owner alone
    context = foxglove.Context()
    writer = foxglove.open_mcap(path, allow_overwrite=True, context=context)
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

    return FoxgloveStream(source, log, writer.close)


def _schema(channel: Channel) -> foxglove.Schema | None:
    if not channel.schema:
        return None
    return foxglove.Schema(name=channel.schema_name, encoding="protobuf", data=channel.schema)
