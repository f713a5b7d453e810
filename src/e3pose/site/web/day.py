"""The part of the API about hours: coverage of the store, energy spent and saved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, HTTPException, Query

from e3pose.site.web.api import REFUSALS, asked, needed
from e3pose.store import Store

Nanoseconds = Annotated[int, Query(ge=0, le=2**62, description="nanoseconds since 1970")]
LONGEST_NS = 8 * 86_400 * 10**9


def make_day(store: Store | None, active_w: Mapping[str, float]) -> APIRouter:
    """Return the routes.

    Args:
        store: of the site; None where nothing is stored.
        active_w: by camera, what an active one draws.
    """
    day = APIRouter(prefix="/api", responses=REFUSALS)

    @day.get("/timeline", summary="Stored and blind slots in equal parts of a time")
    def timeline(
        start: Nanoseconds,
        end: Nanoseconds,
        parts: Annotated[int, Query(ge=1, le=2000, description="of the time")] = 300,
    ) -> dict[str, list[int]]:
        _check(start, end)
        slots, blind = asked(lambda: needed(store).coverage(start, end, parts))
        return {"slots": slots, "blind": blind}

    @day.get("/spent", summary="What each camera spent in a time, and what all of them saved")
    def spent_of(start: Nanoseconds, end: Nanoseconds) -> dict[str, Any]:
        _check(start, end)
        spent = asked(lambda: needed(store).spent(start, end))
        saved = asked(lambda: needed(store).saved(start, end, active_w))
        return {
            "cameras": [one._asdict() for one in spent],
            "whole_camera": None if saved is None else asdict(saved),
        }

    return day


def _check(start: int, end: int) -> None:
    if not start < end <= start + LONGEST_NS:
        raise HTTPException(422, "end: expected after start, by eight days at most")
