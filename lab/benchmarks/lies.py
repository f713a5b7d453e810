"""Lies of a camera with valid keys: every field of its messages at its extremes, and schemes.

A lie changes honest messages just before they are sent.
"""

from __future__ import annotations

import random
import struct
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from e3pose.base.errors import InputError
from e3pose.wire.arrays import pack
from e3pose.wire.codec import decode, encode
from e3pose.wire.messages import Array, CameraMode, ClockQuestion, Heartbeat, Hello, View
from e3pose.wire.site_messages import Picture
from e3pose.wire.transport import Answer, Presence, Receive, Transport

HOUR_NS = 3600 * 10**9
LATE_S = 3.0  # after which nobody waits for a picture
YEAR_2100_NS = 4_102_444_800 * 10**9
KINDS: dict[str, type[Any]] = {
    "hello": Hello,
    "view": View,
    "heartbeat": Heartbeat,
    "clock": ClockQuestion,
    "picture": Picture,  # an answer
}
# Message, how many before -> message, None for none, or bytes that are none.
Change = Callable[[Any, int, random.Random], Any]


@dataclass(frozen=True)
class Lie:
    """A way to change what a camera says.

    Attributes:
        name: of the lie.
        changes: by kind of message; None in place of a message drops it.
    """

    name: str
    changes: Mapping[type[Any], Change] = field(default_factory=dict)


HONEST = Lie("none")


def _always(value: Any) -> Change:
    return lambda message, n, dice: value


def _numbers(name: str, whole: bool) -> list[Change]:
    """Return changes of a number: fixed extremes, times of long ago, rising, and random."""
    fixed: list[Any] = (
        [0, -1, 1, 2**31, 2**53, 2**62, 2**63 - 1]
        if whole
        else [0.0, -1.0, 1e-300, 1.0, 1e6, 1e12, 1e300, float("nan"), float("inf")]
    )
    if name.endswith("_ns"):
        fixed += [YEAR_2100_NS, round(0.1e9), round(0.4e9), round(1.9e9), round(3e9)]
    changes: list[Change] = [_always(v) for v in fixed]

    def honest(message: Any) -> Any:
        return getattr(message, name) or 0

    changes += [
        lambda message, n, dice: honest(message) + 1000 * n,
        lambda message, n, dice: max(honest(message) - 1000 * n, 0),
        lambda message, n, dice: dice.randrange(2**62) if whole else dice.uniform(0, 1e12),
    ]
    if name.endswith("edge_ns"):
        changes += [
            lambda message, n, dice: honest(message) - HOUR_NS,
            lambda message, n, dice: honest(message) + HOUR_NS,
            lambda message, n, dice: honest(message) + dice.choice((-4, 4)) * 10**9,
        ]
    return changes


def _arrays(name: str) -> list[Change]:
    """Return changes of keypoints or scores that fit the other field, or do not."""

    def people(count: int, px: float) -> Change:
        def change(message: View, n: int, dice: random.Random) -> dict[str, Array]:
            joints = message.scores.shape[1]
            rng = np.random.default_rng(dice.randrange(2**32))
            keypoints = rng.uniform(-px, px, (count, joints, 2)).astype(np.float32)
            scores = rng.uniform(0, 1, (count, joints)).astype(np.float32)
            return {"keypoints_px": pack(keypoints), "scores": pack(scores)}

        return change

    def values(value: float) -> Change:
        def change(message: View, n: int, dice: random.Random) -> Array:
            shape = getattr(message, name).shape
            return pack(np.full(shape, value, dtype=np.float32))

        return change

    return [
        people(0, 1.0), people(1, 1e3), people(256, 1e3), people(256, 1e6), people(2, 1e9),
        *(values(value) for value in (0.0, -1.0, 1.0, 1e6, float("nan"), float("inf"))),
        lambda message, n, dice: Array("f4", (2**31, 2), b""),
    ]  # fmt: skip


def _fields(kind: type[Any]) -> Iterator[tuple[str, list[Change]]]:
    """Yield the fields of a message with the changes of each."""
    for name, hint in get_type_hints(kind).items():
        options = set(get_args(hint)) if get_origin(hint) is not None else {hint}
        fixed: list[Any] = [None] if type(None) in options else []
        changes: list[Change] = []
        if hint is CameraMode or get_origin(hint) is Literal:
            fixed += [*get_args(hint), "asleep"]
        elif hint is str:
            fixed += ["", "x" * 500, "x" * 30_000, "\x1b[2J", "../cam0", "cam0"]
        elif hint is bytes:
            fixed += [b"", b"no JPEG", jpeg_header(60_000, 60_000), bytes(900_000), bytes(2**21)]
        elif hint is bool:
            fixed += [True, False]
            changes.append(lambda message, n, dice: n % 2 == 0)
        elif hint is Array:
            changes += _arrays(name)
        elif hint == tuple[str, ...]:
            fixed += [(), ("nose",) * 17, tuple(f"joint{i}" for i in range(512)), ("x" * 500,)]
        elif hint == tuple[int, int]:
            fixed += [(0, 0), (1, 1), (10**6, 10**6), (2**62, -1)]
        else:
            changes += _numbers(name, whole=hint is int)
        yield name, changes + [_always(v) for v in fixed]


def jpeg_header(width: int, height: int) -> bytes:
    """Return the begin of a JPEG of some size, which has no image."""
    frame = struct.pack(">BHHB", 8, height, width, 1) + b"\1\x11\0"
    return b"\xff\xd8\xff\xc0" + struct.pack(">H", 2 + len(frame)) + frame


def lies_of_fields(hold: int = 8) -> list[tuple[Lie, int]]:
    """Return a lie for each field of each message, and how many messages it takes.

    Args:
        hold: messages that say the same, before the next extreme comes.
    """
    lies = []
    for kind in KINDS.values():
        for name, changes in _fields(kind):
            lie = Lie(f"{kind.__name__}.{name}", {kind: _in_turn(name, changes, hold)})
            lies.append((lie, hold * len(changes)))
    return lies


def swept(kind: type[Any]) -> Lie:
    """Return a lie that goes through the extremes of all fields of a message, one after another."""
    fields = [lie.changes[kind] for lie, _ in lies_of_fields(hold=1) if kind in lie.changes]

    def change(message: Any, n: int, dice: random.Random) -> Any:
        return fields[n % len(fields)](message, n // len(fields), dice)

    return Lie(f"every field of {kind.__name__} at its extremes", {kind: change})


def _in_turn(name: str, changes: Sequence[Change], hold: int) -> Change:
    """Return a change that goes through some, and holds each for a number of messages."""

    def change(message: Any, n: int, dice: random.Random) -> Any:
        value = changes[n // hold % len(changes)](message, n, dice)
        new = value if isinstance(value, dict) else {name: value}
        return msgspec.structs.replace(message, **new)

    return change


def _set(**values: Any) -> Change:
    return lambda message, n, dice: msgspec.structs.replace(message, **values)


def _rising(**steps: float) -> Change:
    def change(message: Any, n: int, dice: random.Random) -> Any:
        new = {name: (getattr(message, name) or 0) + (n + 1) * s for name, s in steps.items()}
        return msgspec.structs.replace(message, **new)

    return change


def _share(one_in: int) -> Change:
    return lambda message, n, dice: message if n % one_in == 0 else None


def _never(message: Any, n: int, dice: random.Random) -> None:
    """Drop a message."""


def picture_schemes() -> list[Lie]:
    """Return the false answers of a camera to an operator who asks for its picture."""

    def late(message: Picture, n: int, dice: random.Random) -> Picture:
        time.sleep(LATE_S)
        return message

    return [
        Lie("picture of 60000 x 60000", {Picture: _set(jpeg=jpeg_header(60_000, 60_000))}),
        Lie("picture that is no JPEG", {Picture: _set(jpeg=b"GIF89a")}),
        Lie("picture without a byte", {Picture: _set(jpeg=b"")}),
        Lie("picture of 2 MB", {Picture: _set(jpeg=bytes(2**21))}),
        Lie("picture of the year 2100", {Picture: _set(captured_edge_ns=YEAR_2100_NS)}),
        Lie("picture of another camera", {Picture: _set(camera_id="cam0")}),
        Lie("no picture but garbage", {Picture: lambda m, n, dice: dice.randbytes(300)}),
        Lie("no picture but a clock's question", {
            Picture: lambda m, n, dice: encode(ClockQuestion("cam0", n))
        }),
        Lie("no answer", {Picture: _never}),
        Lie("late answer", {Picture: late}),
    ]  # fmt: skip


def schemes() -> list[Lie]:
    """Return the schemes of a camera that lies in several fields at once."""
    late = _rising(late_orders=10)

    def slow(delay_s: float) -> Change:
        return _set(order_delay_ns=round(delay_s * 1e9), late_orders=10**6)

    def costly(message: Heartbeat, n: int, dice: random.Random) -> Heartbeat:
        return msgspec.structs.replace(
            message,
            measured=True,
            power_w=1e6,
            energy_j=1e6 * n,
            active_s=0.25 * n,
            idle_s=0.25 * n,
        )

    def crowd(message: View, n: int, dice: random.Random) -> View:
        joints = message.scores.shape[1]
        rng = np.random.default_rng(n)
        keypoints = rng.uniform(0, 1000, (256, joints, 2)).astype(np.float32)
        scores = np.ones((256, joints), np.float32)
        return msgspec.structs.replace(message, keypoints_px=pack(keypoints), scores=pack(scores))

    return [
        Lie("no view", {View: _never}),
        Lie("late orders, no view", {Heartbeat: late, View: _never}),
        Lie("late orders, one view in 15", {Heartbeat: late, View: _share(15)}),
        Lie("one view in 3", {View: _share(3)}),
        *(
            Lie(f"orders take {delay_s:g} s, {words}", {Heartbeat: slow(delay_s), **views})
            for delay_s in (0.1, 0.4, 0.7, 1.9)
            for words, views in (("views come", {}), ("no view", {View: _never}))
        ),
        Lie("wakes in 3600 s", {Hello: _set(wake_s=3600.0)}),
        Lie("wakes in 1.5 s", {Hello: _set(wake_s=1.5)}),
        Lie("wakes in 3600 s, no view", {Hello: _set(wake_s=3600.0), View: _never}),
        Lie("views of the year 2100", {View: _set(captured_edge_ns=YEAR_2100_NS)}),
        Lie("heartbeats of the year 2100", {Heartbeat: _set(sent_edge_ns=YEAR_2100_NS)}),
        Lie("a megawatt", {Heartbeat: costly}),
        Lie("battery empty", {Heartbeat: _set(battery_j=0.0, gauge=True)}),
        Lie("battery of a terajoule", {Heartbeat: _set(battery_j=1e12, charging_w=1e12)}),
        Lie("a crowd in every view", {View: crowd}),
        Lie("a problem that comes and goes", {
            Heartbeat: lambda m, n, dice: msgspec.structs.replace(m, problem="broken" * (n % 2))
        }),
        Lie("another program each time", {
            Hello: lambda m, n, dice: msgspec.structs.replace(m, session=1 + n)
        }),
    ]  # fmt: skip


class LyingTransport:
    """A transport that changes what is sent; see `Transport`.

    Attributes:
        lie: what is changed; may be replaced at any time.
        sent: changed messages.
    """

    def __init__(self, inner: Transport, lie: Lie = HONEST, seed: int = 0) -> None:
        self.inner, self.lie, self.sent = inner, lie, 0
        self._dice, self._counts = random.Random(seed), dict.fromkeys(KINDS, 0)

    def _changed(self, topic: str, payload: bytes) -> bytes | None:
        what = topic.rpartition("/")[2]
        kind = KINDS.get(what)
        change = None if kind is None else self.lie.changes.get(kind)
        if kind is None or change is None:
            return payload
        number = self._counts[what]
        self._counts[what] += 1
        self.sent += 1
        message = change(decode(payload, kind, "liar"), number, self._dice)
        if isinstance(message, bytes):
            return message
        try:
            return None if message is None else encode(message)
        except (OverflowError, msgspec.MsgspecError, InputError):
            return b"\xc1"  # what msgpack cannot hold

    def publish(self, topic: str, payload: bytes) -> None:
        changed = self._changed(topic, payload)
        if changed is not None:
            self.inner.publish(topic, changed)

    def ask(self, topic: str, payload: bytes, timeout_s: float) -> bytes | None:
        changed = self._changed(topic, payload)
        return None if changed is None else self.inner.ask(topic, changed, timeout_s)

    def subscribe(self, topic: str, receive: Receive) -> None:
        self.inner.subscribe(topic, receive)

    def answer(self, topic: str, answer: Answer) -> None:
        def reply(asked: str, payload: bytes) -> bytes | None:
            honest = answer(asked, payload)
            return None if honest is None else self._changed(asked, honest)

        self.inner.answer(topic, reply)

    def be_present(self, topic: str) -> None:
        self.inner.be_present(topic)

    def watch(self, topic: str, presence: Presence) -> None:
        self.inner.watch(topic, presence)

    def connected(self) -> bool:
        return self.inner.connected()

    def close(self) -> None:
        self.inner.close()
