"""Structured logs: readable lines on a terminal, JSON otherwise."""

from __future__ import annotations

import sys
from collections.abc import MutableMapping
from typing import Any

import structlog

from e3pose.base.log_stream import LogStream
from e3pose.base.masking import masked


def open_log(program: str, as_json: bool, **about: Any) -> Any:
    """Return a logger that writes to standard error.

    Args:
        program: which one logs.
        as_json: one JSON object a line, instead of text.
        about: added to every line.
    """
    renderer: Any = (
        structlog.processors.JSONRenderer()
        if as_json
        else structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty(), pad_event_to=0)
    )
    if isinstance(sys.stderr, LogStream):
        sys.stderr.as_json = as_json
    structlog.configure(
        processors=[
            _masked,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            renderer,
        ],
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=True,
    )
    return structlog.get_logger().bind(program=program, **about)


def _masked(_logger: Any, _name: str, line: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    return {key: masked(said) if isinstance(said, str) else said for key, said in line.items()}
