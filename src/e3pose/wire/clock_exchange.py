"""Ask the edge for the time: one exchange of four time stamps."""

from __future__ import annotations

from collections.abc import Callable

from e3pose.base.clock import Clock
from e3pose.base.errors import InputError
from e3pose.wire.codec import decode, encode
from e3pose.wire.messages import ClockAnswer, ClockQuestion
from e3pose.wire.offset import Exchange
from e3pose.wire.transport import Transport

TIMEOUT_S = 0.5


def exchange_time(
    transport: Transport, topic: str, camera_id: str, clock: Clock, report: Callable[[str], None]
) -> Exchange | None:
    """Return an exchange with the edge; None where it does not answer.

    Args:
        transport: how to reach it.
        topic: of the question.
        camera_id: who asks.
        clock: of this machine.
        report: called with what is wrong with an answer.
    """
    asked_ns = clock.now_ns()
    payload = transport.ask(topic, encode(ClockQuestion(camera_id, asked_ns)), TIMEOUT_S)
    answered_ns = clock.now_ns()
    if payload is None:
        return None
    try:
        answer = decode(payload, ClockAnswer, "edge")
    except InputError as error:
        report(str(error))
        return None
    if answer.asked_ns != asked_ns:
        return None
    return Exchange.of_stamps(asked_ns, answer.received_edge_ns, answer.sent_edge_ns, answered_ns)
