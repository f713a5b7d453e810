"""Live videos: 3D poses over the cameras' images, processor time, and all cameras with feedback."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan

from e3pose_lab.reproduce.clip_feedback import WAYS, FeedbackAsked, WayFigures, clip_feedback
from e3pose_lab.reproduce.items.base import Item, Scale
from e3pose_lab.reproduce.live_video import LiveAsked, LiveFigures, OverImage, live_video
from e3pose_lab.reproduce.records import Cell, Headline, Line, Panel, Section, Table
from e3pose_lab.reproduce.sources import CLIP, NETWORK
from e3pose_lab.reproduce.work import AnyPiece, Made, Piece

SELECTED, CAMERAS = 3, 4
SA, E3POSE, FEEDBACK = "SA", "E3Pose", "SA + feedback"
SLOTS = 34  # of the videos at 20 a second


def _sites(scale: Scale) -> dict[str, Piece[LiveAsked, LiveFigures]]:
    slots = scale.of(40, 6)
    asked = {
        SA: LiveAsked("all", slots=slots),
        E3POSE: LiveAsked("e3pose", selected=SELECTED, slots=slots, pictures=True),
        FEEDBACK: LiveAsked("all", feedback=True, slots=slots),
    }
    return {name: Piece(live_video, each, times=True) for name, each in asked.items()}


def _feedback(scale: Scale) -> Piece[FeedbackAsked, dict[str, WayFigures]]:
    return Piece(clip_feedback, FeedbackAsked(scale.of(SLOTS, 10)), times=True)


def pieces(scale: Scale) -> Sequence[AnyPiece]:
    """Return the sites to run and the replays with feedback."""
    return [*_sites(scale).values(), _feedback(scale)]


def section(scale: Scale, made: Made) -> Section:
    """Return the pictures and the figures."""
    live = {name: made(piece) for name, piece in _sites(scale).items()}
    ways = made(_feedback(scale))
    saved = 100 * (1 - live[E3POSE].cameras_s / live[SA].cameras_s)
    plain, parts, whole = (ways[way] for way in WAYS)
    references = ", ".join(plain.error_mm)
    return Section(
        paper="Five cameras in a laboratory, two to three people: 3D poses projected back fit the "
        "people in the images, also behind others. E3Pose saves 20.66 to 31.21 % of the power on "
        "Xavier NX and 17.72 to 28.67 % on TX2 over both data sets and these live videos. Feedback "
        "of 3D poses to the cameras (RSS 2021) makes detections better: 97.4 PCP on Shelf, SA "
        "94.4.",
        ours=f"With {SELECTED} of {CAMERAS} cameras ({live[E3POSE].selected:.2f} in the mean) "
        f"E3Pose takes {live[E3POSE].cameras_s:.2f} s of processor time a slot on all cameras "
        f"together, SA {live[SA].cameras_s:.2f} s: {saved:.0f} % less. SA with feedback takes "
        f"{live[FEEDBACK].cameras_s:.2f} s. A detection takes {plain.look_ms:.0f} ms without "
        f"feedback, {parts.look_ms:.0f} ms in parts and {whole.look_ms:.0f} ms in whole images; "
        f"the mean distance from the smoother over all cameras is {_mm(plain)}, {_mm(parts)} and "
        f"{_mm(whole)} ({references}). So feedback as in RSS 2021 {_effect(plain, whole)} here.",
        why="Detecting is nearly all the work of a camera, so that processor time falls with the "
        "share of slots, as the paper's power does. The paper's videos and boards are not public. "
        "Feedback in parts shows people larger; in whole images, as in RSS 2021, it adds the "
        "expected joints to the network's heatmaps, and repeats the errors of the expectation "
        "where that comes from the same network.",
        how=f"Measured on this machine: a site of one edge and {CAMERAS} cameras, each a process "
        f"of its own with the network {NETWORK} on one thread, on the demo's four videos of three "
        "people, pipeline paper, a slot in two seconds (a fortieth of the pace of filming). "
        "Processor time of everything that a camera's process does. Feedback: the same "
        "videos slot by slot, lead 2; distances from what a network finds in whole images of all "
        "cameras, smoothed: its own, and MoveNet's where `e3pose models pull movenet-multipose` "
        "fetched it. There is no truth.",
        tables=(_live_table(live), _feedback_table(ways)),
        panels=(*(_over(view) for view in live[E3POSE].views), _bars(live)),
        headlines=(
            Headline("Live video: processor time saved by E3Pose, %", saved, 15.0, 30.0),
        ),
    )  # fmt: skip


def _effect(plain: WayFigures, whole: WayFigures) -> str:
    """Return the effect of feedback on the error against the network's own looks."""
    change_mm = whole.error_mm[NETWORK] - plain.error_mm[NETWORK]
    return f"{'lowers' if change_mm < 0 else 'does not lower'} the error ({change_mm:+.1f} mm)"


def _mm(way: WayFigures) -> str:
    return " / ".join(f"{value:.0f}" for value in way.error_mm.values()) + " mm"


def _live_table(live: dict[str, LiveFigures]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (name, each.selected, each.arrived, each.cameras_s, each.edge_s, each.people, "measured")
        for name, each in live.items()
    ]
    columns = (
        "policy", "cameras on", "views in time", "cameras, s a slot", "edge, s a slot",
        "people a slot", "basis",
    )  # fmt: skip
    return Table("live-video", "Processor time on live video", columns, tuple(rows), digits=2)


def _feedback_table(ways: dict[str, WayFigures]) -> Table:
    names = list(next(iter(ways.values())).error_mm)
    rows: list[tuple[Cell, ...]] = [
        (name, way.look_ms, *way.error_mm.values(), 100 * way.found, "measured")
        for name, way in ways.items()
    ]
    columns = (
        "detections", "ms each", *(f"mm from {name}, smoothed" for name in names), "found, %",
        "basis",
    )  # fmt: skip
    return Table("live-video-feedback", "All cameras with feedback", columns, tuple(rows))


def _over(view: OverImage) -> Panel:
    lines = []
    for number, limbs in enumerate(view.people):
        x = tuple(value for u0, _, u1, _ in limbs for value in (u0, u1, nan))
        y = tuple(value for _, v0, _, v1 in limbs for value in (v0, v1, nan))
        lines.append(Line(f"person {number + 1}", "measured", x, y))
    title = f"{view.camera}: 3D poses in its image"
    return Panel(
        f"live-video-{view.camera}", title, "px right", "px down", tuple(lines), kind="limbs",
        jpeg=view.jpeg, image_size=view.image_size,
    )  # fmt: skip


def _bars(live: dict[str, LiveFigures]) -> Panel:
    lines = (
        Line("cameras", "measured", tuple(live), tuple(each.cameras_s for each in live.values())),
        Line("edge", "measured", tuple(live), tuple(each.edge_s for each in live.values())),
    )
    return Panel("live-video-cpu", "Processor time of a slot", "", "s", lines, kind="stacked")


ITEM = Item(
    "live-video",
    "Live video",
    "fig:liveVideoResult, fig:powerXavierAndTX2",
    pieces,
    section,
    needs=(CLIP, NETWORK),
    imports=("psutil",),
)
