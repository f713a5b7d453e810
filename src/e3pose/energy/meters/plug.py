"""Smart plugs with a meter, read by HTTP: Shelly and Tasmota."""

from __future__ import annotations

import json
import time
import urllib.error
import urllib.request
from dataclasses import dataclass
from typing import Any

from e3pose.base.errors import InputError, reason_of
from e3pose.energy.meters.base import MAX_WATTS, MeterError, Reading
from e3pose.energy.profiles import Activity

# Where a plug says its watts, the newest devices of a maker first.
PLACES: dict[str, tuple[tuple[str, tuple[str, ...]], ...]] = {
    "shelly": (("/rpc/Switch.GetStatus?id=0", ("apower",)), ("/meter/0", ("power",))),
    "tasmota": (("/cm?cmnd=Status%208", ("StatusSNS", "ENERGY", "Power")),),
}
TIMEOUT_S, MAX_BYTES = 3.0, 2**16
FRESH_S = 0.5  # plugs measure about once a second


@dataclass(slots=True)
class PlugMeter:
    """The plug that the whole device draws from, its power supply included.

    Attributes:
        kind: of `PLACES`.
        host: name or address, with a port if it is not 80.
    """

    kind: str
    host: str
    _watts: float = 0.0
    _read_s: float = float("-inf")

    def read(self, mode: Activity) -> Reading:
        """See `Meter.read`."""
        if time.monotonic() - self._read_s > FRESH_S:
            self._watts, self._read_s = self._ask(), time.monotonic()
        return Reading(self._watts, None, True, f"measured: {self.kind} plug, supply included")

    def _ask(self) -> float:
        why = "no answer"
        for path, keys in PLACES[self.kind]:
            try:
                with urllib.request.urlopen(f"http://{self.host}{path}", timeout=TIMEOUT_S) as got:
                    found: Any = json.loads(got.read(MAX_BYTES))
                for key in keys:
                    found = found[key]
                if 0 <= float(found) <= MAX_WATTS:
                    return float(found)
                why = f"{found} W"
            except (urllib.error.URLError, OSError) as error:
                why = reason_of(error)
            except (ValueError, KeyError, TypeError):
                why = f"no watts at {path}"
        raise MeterError(f"{self.kind} plug {self.host}: {why}")


def open_plug(name: str) -> PlugMeter:
    """Return the meter of `shelly:HOST` or `tasmota:HOST`.

    Raises:
        InputError: for another name, or a plug that does not answer with watts.
    """
    kind, _, host = name.partition(":")
    if kind not in PLACES or not host or not set(host).isdisjoint("/@?# "):
        raise InputError("meter", repr(name[:80]), "shelly:HOST or tasmota:HOST")
    meter = PlugMeter(kind, host)
    try:
        meter.read("active")
    except MeterError as error:
        raise InputError("meter", str(error), "a plug with a meter, reachable by HTTP") from None
    return meter
