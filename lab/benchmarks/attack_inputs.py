"""Hostile inputs without a network: decoders fuzzed by the million, damaged files of a site."""

from __future__ import annotations

import contextlib
import io
import math
import random
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import psutil
from rich.console import Console

import hostile_inputs
from e3pose.base.errors import InputError
from e3pose.cli import main as e3pose
from e3pose.recording import save_recording
from e3pose.simulate.settings import SceneSettings
from e3pose.simulate.simulation import simulate
from e3pose.site.example import write_recorded
from e3pose.site.screen import screen
from e3pose.wire.arrays import pack, poses_2d
from e3pose.wire.codec import Message, decode, encode
from e3pose.wire.messages import ClockAnswer, ClockQuestion, Heartbeat, Hello, Order, View
from e3pose.wire.site_messages import CameraStatus, Poses, Status
from hostile_trials import NO_ERRORS

SECOND = ", a second time"  # at the end of the name of what is tried once more
GROWTH_MB = 100.0  # more than this, and something was kept
BATCH = 1000  # decodes between two looks at the clock
NUMBERS: tuple[Any, ...] = (
    0, -1, 1, 2**31, 2**53, 2**62, -(2**63), 2**64 - 1, 1e-300, 1e300, float("inf"),
    float("-inf"), float("nan"), "", "\x1b[2J", "x" * 600, "../x", b"", None, True, [], {},
    [[]], [0] * 50,
)  # fmt: skip


@dataclass
class Result:
    """Result of one attack.

    Attributes:
        name: of the attack.
        figures: what was measured, in words.
        held: whether everything held.
        must: what must be, in words.
        kept: poses per second, as a share of those just before; NaN where nobody counted.
        again: whether it is tried once more.
        left_out: whether it could not be tried here.
    """

    name: str
    figures: str
    held: bool
    must: str
    kept: float = math.nan
    again: bool = False
    left_out: bool = False


Report = Callable[[Result], None]


def messages() -> list[Message]:
    """Return one good message of every kind."""
    rng = np.random.default_rng(1)
    joints = ("nose", "neck", "hip")
    keypoints = pack(rng.uniform(0, 900, (2, 3, 2)).astype(np.float32))
    scores = pack(np.full((2, 3), 0.5, np.float32))
    cameras = (CameraStatus("cam1", True, mode="active", duty=0.5, power_w=5.0, battery=0.5),)
    return [
        Hello("cam1", 7, joints, (1920, 1080), 25.0, 0.4, "movenet", "0.1", 50.0),
        View("cam1", 7, 12, 5, keypoints, scores, 1, 2, 3),
        Heartbeat("cam1", 7, 99, "active", power_w=4.5, energy_j=10.0, battery_j=5.0),
        Order("cam1", 12, True, "power-saving", 5, 40_000_000, 6, 8, 2),
        ClockQuestion("cam1", 12),
        ClockAnswer(12, 13, 14),
        Poses(
            3, 5, joints, pack(np.array([4, 9])), pack(np.ones((2, 3, 3), np.float32)),
            scores, pack(np.ones((2, 3), bool)),
        ),
        Status("lab", 3, 25.0, 1, 2, cameras, (1.0, 2.0), (1.0, 2.0), 9.0, ("an event",), 20.0),
    ]  # fmt: skip


def odd(value: Any, dice: random.Random) -> Any:
    """Return a message as plain lists and maps with one or a few of its values changed."""
    if isinstance(value, dict) and value and dice.random() > 0.1:
        name = dice.choice(sorted(value))
        kept = {key: each for key, each in value.items() if key != name or dice.random() > 0.1}
        return {**kept, dice.choice([name, "a name of tomorrow"]): odd(value[name], dice)}
    if not isinstance(value, list) or not value or dice.random() < 0.1:
        return dice.choice(NUMBERS)
    changed = list(value)
    place = dice.randrange(len(changed))
    kind = dice.random()
    if kind < 0.05:
        del changed[place]
    elif kind < 0.1:
        changed.insert(place, dice.choice(NUMBERS))
    else:
        changed[place] = odd(changed[place], dice)
    return changed


def damaged(payload: bytes, dice: random.Random) -> bytes:
    """Return bytes with some of them changed, cut off or doubled."""
    data, kind = bytearray(payload), dice.random()
    if kind < 0.6:
        for _ in range(dice.randint(1, 4)):
            data[dice.randrange(len(data))] = dice.randrange(256)
    elif kind < 0.75:
        del data[dice.randrange(len(data)) :]
    elif kind < 0.9:
        place = dice.randrange(len(data))
        data[place:place] = dice.randbytes(dice.randint(1, 16))
    else:
        return dice.randbytes(dice.randint(0, 64))
    return bytes(data)


def used(message: Message) -> None:
    """Do with a message that was accepted what its reader does with it."""
    if isinstance(message, View):
        poses_2d(message)
    elif isinstance(message, Status):
        Console(file=io.StringIO(), width=100).print(screen(message, 0.0))


def fuzz(seconds: float, decodes: int, seed: int) -> Result:
    """Decode messages with odd values and damaged bytes; nothing but `InputError` may come."""
    dice, good = random.Random(seed), messages()
    plain = [msgspec.msgpack.decode(encode(message)) for message in good]
    rss = psutil.Process().memory_info().rss
    begun_s, done, accepted, worst = time.monotonic(), 0, 0, ""
    while done < decodes and time.monotonic() - begun_s < seconds:
        for _ in range(BATCH):
            which = dice.randrange(len(good))
            try:
                if dice.random() < 0.5:
                    payload = msgspec.msgpack.encode([plain[which][0], odd(plain[which][1], dice)])
                else:
                    payload = damaged(encode(good[which]), dice)
            except (OverflowError, msgspec.MsgspecError):
                continue  # what msgpack cannot hold
            done += 1
            try:
                message = decode(payload, type(good[which]), "attacker")
                accepted += 1
                used(message)
            except InputError:
                pass
            except Exception as error:  # what this looks for
                worst = worst or f"; {type(good[which]).__name__}: {type(error).__name__}: {error}"
    took_s = time.monotonic() - begun_s
    grown_mb = (psutil.Process().memory_info().rss - rss) / 1e6
    figures = (
        f"{done} messages of {len(good)} kinds in {took_s:.0f} s, {accepted} accepted and used, "
        f"grew by {grown_mb:.0f} MB{worst}"
    )
    must = f"no error but `InputError`, growth below {GROWTH_MB:.0f} MB"
    return Result("decoders", figures, not worst and grown_mb < GROWTH_MB, must)


def hostile_files(
    seconds: float, seed: int, kinds: tuple[str, ...] = ("tables", "videos")
) -> Result:
    """Try hostile tables and videos, then damage the files of a site one at a time, for a while.

    Verbs say one line and end with 0, 1 or 2.
    """
    dice, tried, refused, worst = random.Random(seed), 0, 0, ""
    trials = [trial for kind in kinds for trial in hostile_inputs.try_all(kind, init=False)]
    for trial in trials:
        if not trial.held:
            worst = (
                worst
                or f"; {trial.name}: {trial.verb} ended with {trial.code}: {trial.said[-200:]}"
            )
    with tempfile.TemporaryDirectory(prefix="e3pose-attack-") as name:
        folder = Path(name)
        recording = simulate(SceneSettings(people=2, seconds=0.6, cameras=3, fps=10), seed=0)
        save_recording(recording, folder / "rec")
        write_recorded(folder / "site", recording, "lab")
        verbs = {
            "rec": (["info", "rec"], ["replay", "rec", "--pipeline", "paper"]),
            "site": (["check", "site", "--timeout", "0"],),
        }
        run_quietly(["replay", str(folder / "rec"), "--store", str(folder / "s.db")])
        targets = [(p, verbs[top]) for top in verbs for p in files_of(folder / top)]
        targets.append((folder / "s.db", (["query", "s.db"], ["query", "s.db", "--what", "slots"])))
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < seconds:
            path, commands = dice.choice(targets)
            good = path.read_bytes()
            for _ in range(dice.randint(1, 5)):
                path.write_bytes(damaged(path.read_bytes() or b"x", dice))
            for words in commands:
                words = [str(folder / w) if (folder / w).exists() else w for w in words]
                code, said = run_quietly(words)
                tried, refused = tried + 1, refused + (code == 2)
                errors = [s for s in said.splitlines() if not s.startswith(NO_ERRORS)]
                if code not in (0, 1, 2) or (code == 2 and len(errors) != 1):
                    worst = worst or f"; {path.name}: {words[0]} ended with {code}: {said[-200:]}"
            path.write_bytes(good)
    made = sum(trial.code == 2 for trial in trials)
    figures = (
        f"{len(trials)} hostile videos and tables tried, {made} refused, at most "
        f"{max((t.took_s for t in trials), default=0.0):.1f} s and "
        f"{max((t.grown_mb for t in trials), default=0.0):.0f} MB; "
        f"{tried} damaged files read, {refused} refused{worst}"
    )
    return Result("files", figures, not worst, "each used, or refused in one line")


def files_of(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.is_file() and p.stat().st_size)


def run_quietly(words: list[str]) -> tuple[int, str]:
    """Run a verb in this process; return its exit code, or -1 and the error, and what it said."""
    stderr = io.StringIO()
    code: Any = 0
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(stderr):
        try:
            e3pose(words)
        except SystemExit as ended:
            code = ended.code or 0
        except Exception as error:  # what this looks for
            return -1, f"{type(error).__name__}: {error}"
    return int(code), stderr.getvalue()
