"""A reader of OSC packets, written from the specification of OSC 1.0."""

from __future__ import annotations

import struct
from typing import Any

Messages = list[tuple[str, list[Any]]]


def read_osc(packet: bytes) -> Messages:
    """Return the messages of a packet, as the specification of OSC 1.0 has it."""
    if packet.startswith(b"#bundle\0"):
        at, found = 16, []  # behind the time
        while at < len(packet):
            (size,) = struct.unpack_from(">i", packet, at)
            assert size % 4 == 0
            found += read_osc(packet[at + 4 : at + 4 + size])
            at += 4 + size
        return found

    def text(at: int) -> tuple[str, int]:
        end = packet.index(b"\0", at)
        return packet[at:end].decode("ascii"), at + (end - at) // 4 * 4 + 4

    address, at = text(0)
    tags, at = text(at)
    assert tags[0] == ","
    values: list[Any] = []
    for tag in tags[1:]:
        if tag == "s":
            value, at = text(at)
            values.append(value)
        else:
            values += struct.unpack_from({"i": ">i", "f": ">f"}[tag], packet, at)
            at += 4
    assert at == len(packet)
    return [(address, values)]
