"""The state of every camera at the edge, and which of them can be selected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from e3pose.model.skeleton import BODY_JOINTS, SKELETONS, lacking, serves
from e3pose.quantities import plural
from e3pose.wire.messages import CameraMode, Heartbeat, Hello

SILENT_S = 1.9  # without a word for so long a camera is given up; it speaks twice a second
WRONG_LIMIT = 20  # messages that make no sense, within the time below: it is left out
WRONG_S = 10.0
QUARANTINE_S = 5.0  # and looked at again after this
FLOOD_RATE = 4.0  # times the messages that a camera needs, beyond which the rest is not read
# What a camera knows of the error of its clock is half the quickest round trip: a bound, and the
# truth is far within it. Beyond this it cannot be trusted to say which slot it saw.
CLOCK_ERROR_NS = 250_000_000
RIVAL_RETURNS = 3  # of a session after another one spoke: a restart has none, a slow link one
RIVAL_S = 10.0  # within which they come, and after which it is over
SESSIONS = 4  # of one camera, to remember
FROZEN_S = 5.0  # active all that time, but no new frame taken


@dataclass(frozen=True, slots=True)
class CameraLife:
    """One camera as the edge knows it; a value.

    Attributes:
        camera_id: who.
        present: whether its program is connected.
        hello: what it said it is.
        beat: its newest heartbeat.
        heard_ns: when its newest message came; None before the first.
        wrong: when messages came that made no sense, newest last.
        quarantined_until_ns: until when it is left out because of those.
        fault: what was wrong with the newest of them.
        messages: messages of this second, for `flooding`.
        second: which second that is.
        frame_ns: when its count of frames last grew.
        restarts: how often its program was started anew.
        orders_late: whether its newest heartbeat told of more orders that came too late.
        sessions: of the programs that spoke in its name of late, who spoke last being the last.
        returns: when one of them spoke again after another one, newest last.
    """

    camera_id: str
    present: bool = False
    hello: Hello | None = None
    beat: Heartbeat | None = None
    heard_ns: int | None = None
    wrong: tuple[int, ...] = ()
    quarantined_until_ns: int = 0
    fault: str = ""
    messages: int = 0
    second: int = 0
    frame_ns: int = 0
    restarts: int = 0
    orders_late: bool = False
    sessions: tuple[int, ...] = ()
    returns: tuple[int, ...] = ()


def come_or_go(life: CameraLife, there: bool, now_ns: int) -> CameraLife:
    """Return the life of a camera whose program connected or went away."""
    return replace(life, present=there, heard_ns=now_ns if there else life.heard_ns)


def greet(life: CameraLife, hello: Hello, now_ns: int) -> CameraLife:
    """Return the life of a camera that said what it is."""
    again = life.hello is not None and life.hello.session != hello.session
    return replace(
        _speak(life, hello.session, now_ns),
        present=True,
        hello=hello,
        heard_ns=now_ns,
        beat=None if again else life.beat,
        frame_ns=now_ns if again or life.hello is None else life.frame_ns,
        restarts=life.restarts + again,
    )


def take_beat(life: CameraLife, beat: Heartbeat, now_ns: int) -> CameraLife:
    """Return the life of a camera that said how it is."""
    moved = life.beat is None or beat.captured != life.beat.captured
    return replace(
        _speak(life, beat.session, now_ns),
        present=True,
        beat=beat,
        heard_ns=now_ns,
        frame_ns=now_ns if moved or beat.mode == "aggressive-power-saving" else life.frame_ns,
        orders_late=life.beat is not None and beat.late_orders > life.beat.late_orders,
    )


def _speak(life: CameraLife, session: int, now_ns: int) -> CameraLife:
    """Return the life of a camera in whose name a program spoke."""
    if life.sessions[-1:] == (session,):
        return life
    recent = tuple(at for at in life.returns if now_ns - at < RIVAL_S * 1e9)[-RIVAL_RETURNS:]
    if session in life.sessions:
        recent = (*recent, now_ns)
    others = tuple(other for other in life.sessions if other != session)
    return replace(life, sessions=(*others, session)[-SESSIONS:], returns=recent)


def rivals(life: CameraLife, now_ns: int) -> tuple[int, ...]:
    """Return the sessions of the programs that speak as this camera; empty if there is only one."""
    recent = [at for at in life.returns if now_ns - at < RIVAL_S * 1e9]
    return tuple(sorted(life.sessions[-2:])) if len(recent) >= RIVAL_RETURNS else ()


def mark_heard(life: CameraLife, now_ns: int) -> CameraLife:
    """Return the life of a camera from which anything came."""
    second = now_ns // 10**9
    messages = life.messages + 1 if second == life.second else 1
    return replace(life, present=True, heard_ns=now_ns, messages=messages, second=second)


def flooding(life: CameraLife, fps: float) -> bool:
    """Return whether a camera says far more this second than it has to say."""
    return life.messages > FLOOD_RATE * (fps + 10)


def take_wrong(life: CameraLife, fault: str, now_ns: int) -> CameraLife:
    """Return the life of a camera that sent something that makes no sense, for a reason."""
    recent = tuple(at for at in life.wrong if now_ns - at < WRONG_S * 1e9)[-WRONG_LIMIT:]
    wrong = (*recent, now_ns)
    if len(wrong) < WRONG_LIMIT:
        return replace(life, wrong=wrong, fault=fault)
    until_ns = now_ns + round(QUARANTINE_S * 1e9)
    return replace(life, wrong=(), fault=fault, quarantined_until_ns=until_ns)


def trouble(
    life: CameraLife,
    joints: Sequence[str],
    image_size: tuple[int, int] | None,
    now_ns: int,
) -> str:
    """Return why a camera cannot be chosen, in words; empty if it can.

    Args:
        life: what is known of it.
        joints: of the edge's skeleton, into which those of its detector are converted.
        image_size: of its calibration; None for whatever it has.
        now_ns: the time.
    """
    if life.heard_ns is None:
        return "never connected"
    if life.beat is not None and life.beat.ends:
        return "stopped"
    if not life.present:
        return "not connected"
    if now_ns - life.heard_ns > SILENT_S * 1e9:
        return f"silent for {(now_ns - life.heard_ns) / 1e9:.0f} s"
    if speakers := rivals(life, now_ns):
        return (
            f"two programs run as {life.camera_id} (sessions "
            f"{' and '.join(map(str, speakers))}): stop one of them"
        )
    if now_ns < life.quarantined_until_ns:
        return f"sends invalid messages ({life.fault})"
    if life.hello is None:  # without a frame it cannot know, and may say why
        return (life.beat.problem if life.beat else "") or "connecting"
    if life.hello.joints != tuple(joints) and not serves(life.hello.joints, joints):
        return _other_joints(life.hello.joints, joints)
    if image_size is not None and tuple(life.hello.image_size) != tuple(image_size):
        width, height = life.hello.image_size
        return (
            f"image size {width} x {height}, but the calibration has "
            f"{image_size[0]} x {image_size[1]}"
        )
    if life.beat is None:
        return "connected, waiting for its first status"
    return _ailing(life, life.beat, now_ns)


def _other_joints(found: Sequence[str], expected: Sequence[str]) -> str:
    """Say which skeleton a detector outputs that cannot stand for the one expected."""
    names = {skeleton.joints: name for name, skeleton in SKELETONS.items()}
    outputs, expects = (
        names.get(tuple(joints), plural(len(joints), "joint")) for joints in (found, expected)
    )
    lost = lacking(found, expected)
    missing = [joint for joint in lost if joint in BODY_JOINTS] or lost
    return f"detector outputs {outputs} without {', '.join(missing)}, the site expects {expects}"


def _ailing(life: CameraLife, beat: Heartbeat, now_ns: int) -> str:
    if beat.problem:
        return beat.problem
    if beat.battery_j is not None and beat.battery_j <= 0:
        return "battery empty" if beat.gauge else "battery empty (modelled)"
    if beat.clock_error_ns > CLOCK_ERROR_NS:
        return f"clock uncertain by {beat.clock_error_ns / 1e6:.0f} ms"
    if now_ns - life.frame_ns > FROZEN_S * 1e9:
        return "no new frames"
    return ""


def slowest_wake_s(lives: Sequence[CameraLife], idle_modes: Sequence[CameraMode]) -> float:
    """Return how long the slowest camera that may be asleep takes to wake."""
    return max(
        (
            life.hello.wake_s
            for life, mode in zip(lives, idle_modes, strict=True)
            if life.hello is not None and mode == "aggressive-power-saving"
        ),
        default=0.0,
    )


@dataclass(frozen=True, slots=True)
class Roster:
    """All cameras of a rig, in its order; a value.

    Attributes:
        lives: one per camera.
    """

    lives: tuple[CameraLife, ...] = field(default_factory=tuple)

    @classmethod
    def of(cls, camera_ids: Sequence[str]) -> Roster:
        """Return the roster before anybody was heard."""
        return cls(tuple(CameraLife(camera_id) for camera_id in camera_ids))

    def with_life(self, index: int, life: CameraLife) -> Roster:
        """Return the roster with another life of one camera."""
        return Roster((*self.lives[:index], life, *self.lives[index + 1 :]))
