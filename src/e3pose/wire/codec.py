"""Encode and decode messages: msgpack with a version, validated on arrival."""

from __future__ import annotations

from typing import TypeVar, get_args

import msgspec

from e3pose.base.errors import InputError, reason_of
from e3pose.wire.bounds import out_of_bounds
from e3pose.wire.messages import (
    VERSION,
    ClockAnswer,
    ClockQuestion,
    Heartbeat,
    Hello,
    Order,
    View,
)
from e3pose.wire.site_messages import (
    Control,
    Controlled,
    OutboxPart,
    OutboxQuestion,
    Picture,
    PictureQuestion,
    Poses,
    Status,
)
from e3pose.wire.validation import CHECKS

MAX_BYTES = 2**20  # 256 people with 133 joints take 0.6 MB

_encoder = msgspec.msgpack.Encoder()
_envelope = msgspec.msgpack.Decoder(tuple[int, msgspec.Raw])
Message = (
    Hello
    | View
    | Heartbeat
    | Order
    | ClockQuestion
    | ClockAnswer
    | Poses
    | Control
    | Controlled
    | PictureQuestion
    | Picture
    | OutboxQuestion
    | OutboxPart
    | Status
)
_body = msgspec.msgpack.Decoder(Message)
Kind = TypeVar("Kind", bound=Message)


def encode(message: Message) -> bytes:
    """Return the bytes of a message: msgpack of `[version, [tag, field, ...]]`."""
    return _encoder.encode((VERSION, message))


def decode(payload: bytes, kind: type[Kind], where: str) -> Kind:
    """Decode and validate a message of the expected kind.

    Args:
        payload: what came.
        kind: the message expected on this topic.
        where: who sent it, for errors.

    Raises:
        InputError: when it is too large, of another version or kind, or any field is not what it
            must be; the message is checked whole.
    """
    if len(payload) > MAX_BYTES:
        raise InputError(
            f"{where}: message: found {len(payload)} bytes, expected at most {MAX_BYTES}"
        )
    try:
        version, body = _envelope.decode(payload)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise InputError(f"{where}: message: found no message ({reason_of(error)[:200]})") from None
    if version != VERSION:
        raise InputError(
            f"{where}: message: found version {version}, expected {VERSION}: "
            "run the same version of e3pose at both ends"
        )
    try:
        message = _body.decode(body)
    except msgspec.ValidationError as error:
        outside = out_of_bounds(error, body, get_args(Message))
        raise InputError(f"{where}: {outside or 'message: ' + reason_of(error)[:200]}") from None
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise InputError(f"{where}: message: {reason_of(error)[:200]}") from None
    if not isinstance(message, kind):
        raise InputError(
            f"{where}: message: found {type(message).__name__}, expected {kind.__name__}"
        )
    if check := CHECKS.get(kind):
        check(message, f"{where}: {kind.__name__.lower()}")
    return message


def one_line(text: str) -> str:
    """Return text fit for a message: printable, one line, bounded length."""
    return "".join(char if char.isprintable() else " " for char in text)[:300]
