"""Slots, zone events and events of people as JSON, for streams that carry text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime, timezone
from typing import Any

import numpy as np

from e3pose.model.person_event import PersonEvent, sentence
from e3pose.model.zone_event import ZoneEvent
from e3pose.site.connect import LiveSlot, Names, called, no_name

DECIMALS = 4


def slot_words(slot: LiveSlot, titles: Mapping[str, str]) -> dict[str, Any]:
    """Return a slot for JSON: known joints by name, metres; cameras with their titles, by id."""
    people = []
    for track, joints_m in zip(slot.people.track_ids.tolist(), slot.people.joints_m, strict=True):
        places = joints_m.astype(np.float64).round(DECIMALS)
        known = {
            name: place.tolist()
            for name, place in zip(slot.joints, places, strict=True)
            if np.isfinite(place).all()
        }
        people.append({"track": track, "joints": known})
    return {
        "slot": slot.slot,
        "time_ns": slot.time_ns,
        "delay_ms": slot.delay_ms,
        "selected": list(slot.selected),
        "titles": {camera: titles.get(camera, camera) for camera in slot.selected},
        "people": people,
    }


def zone_words(event: ZoneEvent) -> dict[str, Any]:
    """Return a zone event as JSON can hold it."""
    return {"event" if key == "kind" else key: value for key, value in asdict(event).items()}


def event_words(event: PersonEvent, names: Names = no_name) -> dict[str, Any]:
    """Return an event of a person as JSON can hold it, with its sentence in local time.

    Args:
        event: what happened.
        names: of people, by track.
    """
    here = datetime.now().astimezone().tzinfo
    event = called(event, names)
    return {**asdict(event), "sentence": sentence(event, here or timezone.utc)}
