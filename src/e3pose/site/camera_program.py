"""The camera program: from a camera file to a running `CameraNode`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from e3pose.base.atomic import atomic_folder, check_free, check_output, write_file
from e3pose.base.clock import Clock, WallClock
from e3pose.base.errors import MISSING, InputError
from e3pose.base.system import require_64_bits
from e3pose.camera.base import DetectingSource, LiveDetector, LiveSource, NodeSettings
from e3pose.camera.live import CameraNode, ProcessorTime
from e3pose.camera.live_source import make_source
from e3pose.camera.orientation import turned
from e3pose.camera.pictures import Pictures
from e3pose.camera.sleep import open_suspend
from e3pose.camera.video_recorder import VideoRecorder, VideoSettings
from e3pose.detectors import chosen_name, make_detector
from e3pose.detectors.base import Detector
from e3pose.energy.activity import ModeClock
from e3pose.energy.meters.charge_file import ChargeFile
from e3pose.energy.meters.sampler import open_sampler
from e3pose.energy.profiles import load_profile
from e3pose.recording.videos import MAX_BYTES, PART_S
from e3pose.settings.camera_file import CAMERA_FORMAT, NodeTable, load_node
from e3pose.settings.limits import Sleep
from e3pose.site.program_log import NO_LOG, Log
from e3pose.site.run import run_until_stopped
from e3pose.wire.endpoint import Endpoint, is_loopback
from e3pose.wire.keys import joining
from e3pose.wire.keys.folder import link_of
from e3pose.wire.network import open_network
from e3pose.wire.reach import expired_on_the_way
from e3pose.wire.transport import Transport

ALONE_S, LOOK_S = 5.0, 60.0
RESTS: dict[Sleep, tuple[str, ...]] = {
    "off": (),
    "process": ("asleep",),
    "suspend": ("asleep", "suspended"),
}


def open_charge_file(node: NodeTable, report: Callable[[str], None]) -> ChargeFile | None:
    """Return the charge file of a camera's battery; None on mains.

    Args:
        node: its configuration.
        report: called with messages for operators.
    """
    if node.battery_wh is None:
        return None
    if node.state is None:
        report("no battery gauge: assuming a full battery at each start; --state stores the charge")
    return ChargeFile(node.state or None, node.camera, node.battery_wh, report)


@dataclass(slots=True, eq=False)
class EdgeWatch:
    """Reports whether the edge answers: a camera without one sends nothing.

    Attributes:
        report: called with messages for operators.
        endpoint: of the edge.
        camera_id: of the camera.
        alone_s: seconds without the edge before a warning.
        expired: returns which certificate has expired; it may take seconds.
    """

    report: Callable[[str], None]
    endpoint: Endpoint
    camera_id: str
    alone_s: float = ALONE_S
    expired: Callable[[], str] = str
    _look_s: float = 0.0
    _expired: str = ""
    _there: bool = False
    _since_s: float | None = None
    _reported: str = ""

    def update(self, there: bool, connected: bool, now_s: float) -> None:
        """Report changes since the last call, and once why the edge does not answer.

        Args:
            there: whether the edge answers this camera.
            connected: whether a connection to it stands; one that it does not admit has no answer.
            now_s: the time.
        """
        if self._since_s is None:
            self._since_s = now_s
        if there != self._there:
            self._there, self._since_s, self._look_s, self._reported = there, now_s, 0.0, ""
            self.report("edge connected" if there else "edge disconnected, reconnecting")
        elif not there and now_s - self._since_s >= self.alone_s:
            why = f"no answer from the edge at {self.endpoint}, still trying"
            if connected:
                why = (
                    f"the edge at {self.endpoint} does not admit this camera: certificate revoked "
                    f"or unknown, or another site; `e3pose keys list` on the edge shows it, "
                    f"`e3pose keys add {self.camera_id}` makes a new one"
                )
            if now_s >= self._look_s:
                self._look_s, self._expired = now_s + LOOK_S, self.expired()
            why = self._expired or why
            if why != self._reported:
                self._reported = why
                self.report(why)


class Camera:
    """A camera at work, until it is closed. Use it as a context manager.

    Attributes:
        node: what captures, detects and sends.
    """

    def __init__(self, node: CameraNode, watch: EdgeWatch, clock: Clock, stack: ExitStack) -> None:
        """Own a started camera, and the resources to close after it."""
        self.node, self._watch, self._clock, self._stack = node, watch, clock, stack

    def __enter__(self) -> Camera:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """See `close`."""
        self.close()

    def running(self) -> bool:
        """Return whether it is running; reports an edge that connects or disconnects."""
        there = self.node.edge_there
        connected = there or self.node.transport.connected()
        self._watch.update(there, connected, self._clock.now_ns() / 1e9)
        return self.node.running()

    def run(self, for_s: float | None = None) -> None:
        """Run until Ctrl-C, SIGTERM, or for a number of seconds.

        To be called on the main thread.

        Raises:
            Fault: when a thread of the camera failed.
        """
        run_until_stopped(self.running, for_s)
        self.close()
        self.node.threads.check()

    def close(self) -> None:
        """End, and leave the site."""
        self._stack.close()


def open_camera(
    node: Path | str | NodeTable,
    log: Log | None = None,
    *,
    detector: Detector | None = None,
    source: LiveSource | None = None,
    clock: Clock | None = None,
    processor: ProcessorTime | None = None,
) -> Camera:
    """Start a camera of a site, which then works by itself until it is closed.

    Args:
        node: the camera file, or what it says.
        log: gets messages for operators; by default they are discarded.
        detector: in place of the file's: any object with `skeleton` and `detect`.
        source: in place of the file's: any `LiveSource`, or a `DetectingSource`, which needs no
            detector; its times are those of `clock`.
        clock: the camera's.
        processor: takes the processor time of its looks; None for a program of its own.

    Raises:
        InputError: naming the file, the key, what was found and what was expected.
    """
    require_64_bits()
    table = node if isinstance(node, NodeTable) else load_node(Path(node))
    log, clock = log or NO_LOG, clock or WallClock()
    link = link_of("camera", table.site, table.endpoint, table.keys, insecure=table.insecure)
    charge = open_charge_file(table, log.warning)
    profile, modes = load_profile(table.profile), ModeClock(clock.now_ns)
    power = open_sampler(profile, modes, table.meter, table.battery_wh, charge)
    transport = open_network(link)
    with ExitStack() as stack:
        stack.callback(transport.close)
        more = detector, modes, source, processor
        made = make_camera(table, transport, clock, log.warning, power, *more)
        if (recorder := made.recorder) is not None:
            power.extra_j = lambda: recorder.spent_j
        stack.enter_context(power)
        stack.enter_context(made)
        runs_on = getattr(made.detector, "provider", "")  # a recording has no network
        provider = {"provider": runs_on} if runs_on else {}
        log.info("ready", source=table.source, endpoint=str(table.endpoint), **provider)
        watch = EdgeWatch(
            log.info, table.endpoint, table.camera, expired=lambda: expired_on_the_way(link)
        )
        return Camera(made, watch, clock, stack.pop_all())
    raise AssertionError("an exit stack lets no error pass")


def make_camera(
    node: NodeTable,
    transport: Transport,
    clock: Clock,
    report: Callable[[str], Any],
    meter: Callable[[Any], dict[str, Any]],
    detector: Detector | None = None,
    modes: ModeClock | None = None,
    source: LiveSource | None = None,
    processor: ProcessorTime | None = None,
) -> CameraNode:
    """Return a camera, its network loaded and tried, not yet started.

    Args:
        node: its configuration.
        transport: how to reach the edge.
        clock: its own.
        report: called with messages for operators.
        meter: the power fields of its heartbeats.
        detector: in place of the one that the configuration names.
        modes: what `meter` reads of what the camera does.
        source: in place of the one that the configuration names.
        processor: takes the processor time of its looks.

    Raises:
        InputError: when the source or the network cannot be used, or the machine not be suspended.
    """
    suspend = open_suspend(node.sleep, node.suspend_command)
    if source is None:
        timing = node.pace, node.begin_s
        source = make_source(node.source, node.camera, clock, node.fps, *timing, node.size)
    finds: LiveDetector | None = None
    if isinstance(source, DetectingSource) and detector is None:
        skeleton, name = source.skeleton, source.detector
    else:
        name = chosen_name(node.detector, node.model)
        made = turned(detector or load_detector(node, name), node.rotation)
        finds, skeleton = made, made.skeleton
    settings = NodeSettings(
        site=node.site,
        camera_id=node.camera,
        joints=tuple(skeleton.joints),
        wake_s=node.wake_s,
        delay_ns=round(node.delay_ms * 1e6),
        detector=name,
        battery_wh=node.battery_wh,
        rests=RESTS[node.sleep],
        gate=node.gate,
    )
    pictures = Pictures(node.camera, clock, skeleton.limbs) if node.pictures else None
    recorder = _recorder(node, report)

    def metered(mode: Any) -> dict[str, Any]:
        fields = meter(mode)
        if pictures is not None:
            pictures.watts = fields.get("power_w")
        if recorder is not None:
            fields["recording_j"] = recorder.spent_j
        return fields

    more = pictures, recorder, suspend, modes, processor
    return CameraNode(settings, source, finds, transport, clock, metered, report, *more)


def _recorder(node: NodeTable, report: Callable[[str], Any]) -> VideoRecorder | None:
    """Return the recorder of the camera's videos; None if none is configured.

    A second of encoding is charged what a second of looking draws beyond idling. That is too much
    rather than too little: the network keeps more of the device busy than one thread can.
    """
    if node.videos is None:
        return None
    profile = load_profile(node.profile)
    settings = VideoSettings(
        folder=node.videos,
        camera_id=node.camera,
        part_s=node.videos_part_s or PART_S,
        max_bytes=node.videos_max_bytes or MAX_BYTES,
        pace=node.pace,
        busy_w=profile.watts("active") - profile.watts("power-saving"),
    )
    return VideoRecorder(settings, report)


def load_detector(node: NodeTable, name: str) -> Detector:
    """Return the detector of a camera, loaded and tried: the first detection is slow.

    Args:
        node: the camera's configuration.
        name: of the detector, as of `make_detector`.

    Raises:
        InputError: when the network cannot be used.
    """
    made = make_detector(name, node.model, node.provider, node.threads)
    made.detect(np.zeros((480, 640, 3), dtype=np.uint8))
    return made


def join_site(path: Path, given: Mapping[str, Any], ask: Callable[[str], str]) -> str:
    """Let a camera join a site by a code: make its key, get its certificate, write its file.

    Args:
        path: of the camera file; made where there is none.
        given: keys of the file that take precedence over it.
        ask: returns what the person answers to a question.

    Returns:
        What to type next, in words.

    Raises:
        InputError: before the code is used up for what can be known then; and for a wrong code.
    """
    from e3pose.wire.keys.authority import make_key

    new = not path.exists()
    defaults = {"endpoint": "tls/edge:1", "keys": given.get("camera", "")}
    draft = {"site": "site", **given, **{key: given.get(key, defaults[key]) for key in defaults}}
    node = load_node(path, draft if new else given, new)
    place = "" if new else str(path)
    if not node.endpoint.encrypted:
        raise InputError("endpoint", node.endpoint, "tls/HOST:PORT of the edge", place)
    if (keys := node.keys) is None:
        raise InputError("keys", MISSING, f'keys = "{node.camera}"', place)
    if new:
        check_output(path)
    check_free(keys, overwrite=None)
    site = given.get("site", "") if new else node.site
    where = _site_to_join(None if new and "endpoint" not in given else node.endpoint, site)
    code = joining.read_code(
        ask(f"Code that site {where.site or 'at ' + where.address[0]} shows: ")
    )
    private, public = make_key()

    def keep(admitted: joining.JoinLine) -> None:
        if not new and node.site != admitted.site:
            raise InputError("site", node.site, f'"{admitted.site}", which has that code', place)
        with atomic_folder(keys, private=True) as made:
            write_file(made / "camera.key", private, private=True)
            write_file(made / "authority.pem", admitted.authority)
            write_file(made / "camera.pem", admitted.certificate)
            if new:
                if "endpoint" not in given:
                    draft["endpoint"] = _endpoint_of(admitted, where.address[0])
                file = {"format": CAMERA_FORMAT, "version": 1, **draft, "site": admitted.site}
                write_file(path, tomli_w.dumps(file), private=True)

    admitted = joining.ask_to_join(where.address, code, node.camera, public, keep)
    return f"{node.camera} joined site {admitted.site}, its keys are in {keys}"


def _endpoint_of(admitted: joining.JoinLine, host: str) -> str:
    """Return the endpoint of an edge that was found at a host, by its certificate."""
    hosts = sorted(admitted.hosts, key=lambda each: each != host)
    named = [each for each in hosts if not is_loopback(each)]
    return f"tls/{'localhost' if is_loopback(host) else [*named, 'localhost'][0]}:{admitted.port}"


def _site_to_join(endpoint: Endpoint | None, site: str) -> joining.OpenSite:
    """Return the site at the endpoint of its edge, or else one that the network has."""
    if endpoint is not None:
        host, port = endpoint.address
        at = host, joining.join_port(port)
        if not joining.reaches(at):
            raise InputError(f"nobody listens at {host}:{at[1]}: {joining.NOBODY}")
        return joining.OpenSite(site, at)
    found = [one for one in joining.find_sites() if site in ("", one.site)]
    if len(found) != 1:
        said = ", ".join(f"{one.site} at {one.address[0]}" for one in found) or "none"
        wanted = f"one ({joining.NOBODY}), or --endpoint with that of its edge"
        raise InputError("sites that let a camera join", said, wanted)
    return found[0]
