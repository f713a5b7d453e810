"""The state of every camera at the edge, and which of them can be selected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from e3pose.base.quantities import plural
from e3pose.model.skeleton import BODY_JOINTS, SKELETONS, lacking, serves
from e3pose.wire.messages import RESTING, CameraMode, Heartbeat, Hello

CONNECTING = "connecting"  # said of a camera that is heard, before its hello
SILENT_S = 1.9  # a camera without messages for so long is offline; it sends two per second
WRONG_LIMIT = 20  # invalid messages, within the time below: it is quarantined
WRONG_S = 10.0
QUARANTINE_S = 5.0  # and readmitted after this
FLOOD_RATE = 4.0  # times the messages that a camera needs; more are not read
# A camera bounds the error of its clock by half the shortest round trip; the real error is far
# smaller. Above this limit the slot numbers of its views cannot be trusted.
CLOCK_ERROR_NS = 250_000_000
RIVAL_RETURNS = 3  # of a session after another one: a restart has none, a slow link one
RIVAL_S = 10.0  # window of these
SESSIONS = 4  # kept per camera
FROZEN_S = 5.0  # active, but without a new frame
RATE_S = (4.0, 10.0)  # in which frames are counted, at least and at most
CLOSED = ("aggressive-power-saving", *RESTING)  # modes in which a source may be closed
FROZEN_FRAMES = 3  # of a film that is played slowly, where that is longer


@dataclass(frozen=True, slots=True)
class CameraState:
    """The state of one camera at the edge; a value.

    Attributes:
        camera_id: of the camera.
        present: whether its program is connected.
        hello: its newest hello.
        beat: its newest heartbeat.
        heard_ns: arrival of its newest message; None before the first.
        wrong: arrival of invalid messages, newest last.
        quarantined_until_ns: until when it is quarantined because of those.
        fault: error of the newest of them.
        messages: messages of this second, for `flooding`.
        second: which second that is.
        frame_ns: when its count of frames last grew.
        restarts: of its program.
        orders_late: whether its newest heartbeat counted more late orders.
        sessions: of programs that recently sent messages in its name, newest last.
        returns: when one of them sent again after another one, newest last.
        counted: time, frames and dropped frames from which rates are measured; None in modes in
            which a camera may not film.
        frames_hz: frames per second that its source brings; None until it is measured.
        dropped_hz: frames and views per second that were replaced by newer ones; None likewise.
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
    counted: tuple[int, int, int] | None = None
    frames_hz: float | None = None
    dropped_hz: float | None = None


def with_presence(camera: CameraState, there: bool, now_ns: int) -> CameraState:
    """Return a camera whose program connected or disconnected."""
    return replace(camera, present=there, heard_ns=now_ns if there else camera.heard_ns)


def with_hello(camera: CameraState, hello: Hello, now_ns: int) -> CameraState:
    """Return a camera that sent a hello."""
    again = camera.hello is not None and camera.hello.session != hello.session
    return replace(
        _with_session(camera, hello.session, now_ns),
        present=True,
        hello=hello,
        heard_ns=now_ns,
        beat=None if again else camera.beat,
        counted=None if again else camera.counted,
        frames_hz=None if again else camera.frames_hz,
        dropped_hz=None if again else camera.dropped_hz,
        frame_ns=now_ns if again or camera.hello is None else camera.frame_ns,
        restarts=camera.restarts + again,
    )


def with_heartbeat(camera: CameraState, beat: Heartbeat, now_ns: int) -> CameraState:
    """Return a camera that sent a heartbeat."""
    moved = camera.beat is None or beat.captured != camera.beat.captured
    closed = beat.mode in CLOSED or (camera.beat is not None and camera.beat.mode in RESTING)
    camera = _with_rates(camera, beat, now_ns)
    return replace(
        _with_session(camera, beat.session, now_ns),
        present=True,
        beat=beat,
        heard_ns=now_ns,
        frame_ns=now_ns if moved or closed else camera.frame_ns,
        orders_late=camera.beat is not None and beat.late_orders > camera.beat.late_orders,
    )


def _with_rates(camera: CameraState, beat: Heartbeat, now_ns: int) -> CameraState:
    """Return a camera with the rates of its frames, measured over some seconds."""
    if beat.mode in CLOSED:
        return replace(camera, counted=None)
    now = now_ns, beat.captured, beat.dropped
    if camera.counted is None or beat.captured < camera.counted[1]:
        return replace(camera, counted=now)
    span_s = (now_ns - camera.counted[0]) / 1e9
    if 0 <= span_s < RATE_S[0]:
        return camera
    frames_hz, dropped_hz = (
        max(here - there, 0) / span_s if span_s > 0 else None
        for here, there in zip(now[1:], camera.counted[1:], strict=True)
    )
    counted = camera.counted if 0 <= span_s < RATE_S[1] else now
    return replace(camera, counted=counted, frames_hz=frames_hz, dropped_hz=dropped_hz)


def _with_session(camera: CameraState, session: int, now_ns: int) -> CameraState:
    """Return a camera in whose name a program sent a message."""
    if camera.sessions[-1:] == (session,):
        return camera
    recent = tuple(at for at in camera.returns if now_ns - at < RIVAL_S * 1e9)[-RIVAL_RETURNS:]
    if session in camera.sessions:
        recent = (*recent, now_ns)
    others = tuple(other for other in camera.sessions if other != session)
    return replace(camera, sessions=(*others, session)[-SESSIONS:], returns=recent)


def duplicate_sessions(camera: CameraState, now_ns: int) -> tuple[int, ...]:
    """Return the sessions of several programs that run as this camera; empty for only one."""
    recent = [at for at in camera.returns if now_ns - at < RIVAL_S * 1e9]
    return tuple(sorted(camera.sessions[-2:])) if len(recent) >= RIVAL_RETURNS else ()


def with_message(camera: CameraState, now_ns: int) -> CameraState:
    """Return a camera that sent any message."""
    second = now_ns // 10**9
    messages = camera.messages + 1 if second == camera.second else 1
    return replace(camera, present=True, heard_ns=now_ns, messages=messages, second=second)


def flooding(camera: CameraState, fps: float) -> bool:
    """Return whether a camera sends far more messages this second than it needs to."""
    return camera.messages > FLOOD_RATE * (fps + 10)


def with_invalid_message(camera: CameraState, fault: str, now_ns: int) -> CameraState:
    """Return a camera that sent an invalid message."""
    recent = tuple(at for at in camera.wrong if now_ns - at < WRONG_S * 1e9)[-WRONG_LIMIT:]
    wrong = (*recent, now_ns)
    if len(wrong) < WRONG_LIMIT:
        return replace(camera, wrong=wrong, fault=fault)
    until_ns = now_ns + round(QUARANTINE_S * 1e9)
    return replace(camera, wrong=(), fault=fault, quarantined_until_ns=until_ns)


def problem(
    camera: CameraState,
    joints: Sequence[str],
    image_size: tuple[int, int] | None,
    now_ns: int,
) -> str:
    """Return why a camera cannot be selected, for operators; empty if it can.

    Args:
        camera: its state.
        joints: of the edge's skeleton, into which those of its detector are converted.
        image_size: of its calibration; None for any.
        now_ns: the time.
    """
    if camera.heard_ns is None:
        return "never connected"
    if camera.beat is not None and camera.beat.ends:
        return "stopped"
    if not camera.present:
        return "not connected"
    if now_ns - camera.heard_ns > SILENT_S * 1e9:
        return f"silent for {(now_ns - camera.heard_ns) / 1e9:.0f} s"
    if speakers := duplicate_sessions(camera, now_ns):
        return (
            f"two programs run as {camera.camera_id} (sessions "
            f"{' and '.join(map(str, speakers))}): stop one of them"
        )
    if now_ns < camera.quarantined_until_ns:
        return f"sends invalid messages ({camera.fault})"
    if camera.hello is None:  # without a frame it does not know its size; the heartbeat may say why
        return (camera.beat.problem if camera.beat else "") or CONNECTING
    if camera.hello.joints != tuple(joints) and not serves(camera.hello.joints, joints):
        return _other_joints(camera.hello.joints, joints)
    if image_size is not None and tuple(camera.hello.image_size) != tuple(image_size):
        width, height = camera.hello.image_size
        return (
            f"image size {width} x {height}, but the calibration has "
            f"{image_size[0]} x {image_size[1]}"
        )
    if camera.beat is None:
        return "connected, waiting for its first status"
    return _ailing(camera, camera.beat, now_ns)


def _other_joints(found: Sequence[str], expected: Sequence[str]) -> str:
    """Return the message about a detector whose skeleton cannot be converted."""
    names = {skeleton.joints: name for name, skeleton in SKELETONS.items()}
    outputs, expects = (
        names.get(tuple(joints), plural(len(joints), "joint")) for joints in (found, expected)
    )
    lost = lacking(found, expected)
    missing = [joint for joint in lost if joint in BODY_JOINTS] or lost
    return f"detector outputs {outputs} without {', '.join(missing)}, the site expects {expects}"


def _ailing(camera: CameraState, beat: Heartbeat, now_ns: int) -> str:
    if beat.problem:
        return beat.problem
    if beat.battery_j is not None and beat.battery_j <= 0:
        return "battery empty" if beat.gauge else "battery empty (modelled)"
    if beat.clock_error_ns > CLOCK_ERROR_NS:
        return f"clock uncertain by {beat.clock_error_ns / 1e6:.0f} ms"
    slow_s = FROZEN_FRAMES / camera.hello.fps if camera.hello else 0.0
    if now_ns - camera.frame_ns > max(FROZEN_S, slow_s) * 1e9:
        return "no new frames"
    return ""


def wakes_s(cameras: Sequence[CameraState], idle_modes: Sequence[CameraMode]) -> list[float | None]:
    """Return for each camera the wake-up time that it reports; None for one that never sleeps."""
    return [
        camera.hello.wake_s
        if camera.hello is not None and mode == "aggressive-power-saving"
        else None
        for camera, mode in zip(cameras, idle_modes, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class Roster:
    """All cameras of a rig, in its order; a value.

    Attributes:
        cameras: their states.
    """

    cameras: tuple[CameraState, ...] = field(default_factory=tuple)

    @classmethod
    def of(cls, camera_ids: Sequence[str]) -> Roster:
        """Return the roster before any message."""
        return cls(tuple(CameraState(camera_id) for camera_id in camera_ids))

    def with_camera(self, index: int, camera: CameraState) -> Roster:
        """Return the roster with another state of one camera."""
        return Roster((*self.cameras[:index], camera, *self.cameras[index + 1 :]))
