"""Write a power profile as its TOML file."""

from __future__ import annotations

import json

from e3pose.energy.modes import Look, Rest
from e3pose.energy.profiles import FORMAT, MODES, VERSION, DeviceProfile


def profile_text(profile: DeviceProfile) -> str:
    """Return the file of a profile, which `load_profile` reads as the same profile."""
    lines = [
        f"format = {_text(FORMAT)}",
        f"version = {VERSION}",
        f"name = {_text(profile.name)}",
        f"title = {_text(profile.title)}",
    ]
    for part in profile.components:
        lines += ["", f"[components.{_text(part.name)}]", f"group = {_text(part.group)}"]
        lines += [
            f"{mode} = {{ watts = {part.watts[mode]!r}, source = {_text(part.sources[mode])} }}"
            for mode in MODES
        ]
    for rest in profile.rests:
        lines += ["", f"[rests.{rest.name}]", *_rest(rest)]
    for look in profile.looks:
        lines += ["", f"[looks.{look.name}]", *_look(look)]
    return "\n".join(lines) + "\n"


def _rest(rest: Rest) -> list[str]:
    return [
        f"watts = {float(rest.watts)!r}",
        f"enter_s = {float(rest.enter_s)!r}",
        f"wake_s = {float(rest.wake_s)!r}",
        f"wake_sd_s = {float(rest.wake_sd_s)!r}",
        f"source = {_text(rest.source)}",
    ]


def _look(look: Look) -> list[str]:
    return [
        f"joules = {float(look.joules)!r}",
        f"latency_s = {float(look.latency_s)!r}",
        f"source = {_text(look.source)}",
    ]


def _text(text: str) -> str:
    return json.dumps(text)  # a basic string of TOML has the escapes of JSON
