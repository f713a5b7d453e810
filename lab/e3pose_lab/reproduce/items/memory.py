"""Figure of the memory usage: edge and camera processes of a live site, by people in the scene."""

from __future__ import annotations

from collections.abc import Sequence

from e3pose.detectors.weights import is_installed
from e3pose_lab.reproduce.items.base import Item, Scale
from e3pose_lab.reproduce.records import Cell, Headline, Line, Panel, Section, Table
from e3pose_lab.reproduce.site_memory import KEYPOINTS, Memory, MemoryAsked, site_memory
from e3pose_lab.reproduce.work import AnyPiece, Made, Piece

POLICIES = {"SA": "all", "E3Pose": "e3pose"}
# Runs on record differ by 0.3 % between policies and by 0.7 % from 1 to 10 people
# (docs/research/live.md); the rest is left to other machines.
ALIKE, RISE = (0.98, 1.02), (0.98, 1.02)
NETWORK = "openpose-thin"
FILMED = 3  # people whom a film can show
NETWORK_S = 20.0


def _people(scale: Scale) -> tuple[int, ...]:
    return (1, 8) if scale.quick else (1, 2, 4, 6, 8, 10)


def _asked(scale: Scale) -> dict[tuple[str, int, str], MemoryAsked]:
    """Return the runs by name of the policy, people and detector."""
    few = scale.quick
    asked = {
        (name, people, KEYPOINTS): MemoryAsked(
            policy, people, KEYPOINTS, 3 if few else 5, 2 if few else 3, float(scale.of(5, 2))
        )
        for name, policy in POLICIES.items()
        for people in _people(scale)
    }
    if not few and is_installed(NETWORK):
        for name, policy in POLICIES.items():
            asked[name, FILMED, NETWORK] = MemoryAsked(policy, FILMED, NETWORK, seconds=NETWORK_S)
    return asked


def _piece(asked: MemoryAsked) -> Piece[MemoryAsked, Memory]:
    return Piece(site_memory, asked, times=True)


def pieces(scale: Scale) -> Sequence[AnyPiece]:
    """Return a site to run for every policy and number of people."""
    return [_piece(asked) for asked in _asked(scale).values()]


def section(scale: Scale, made: Made) -> Section:
    """Return memory against people."""
    asked = _asked(scale)
    found = {key: made(_piece(each)) for key, each in asked.items()}
    few, many = _people(scale)[0], _people(scale)[-1]
    least, most = (found["E3Pose", people, KEYPOINTS] for people in (few, many))
    all_on = found["SA", many, KEYPOINTS]
    ratio = most.camera_rss / all_on.camera_rss
    network = {name: found.get((name, FILMED, NETWORK)) for name in POLICIES}
    with_network = (
        f"No camera with a network was measured: `e3pose models pull {NETWORK}` fetches one."
    )
    filmed = ""
    headlines = [
        Headline(f"Memory: camera without a network, E3Pose over SA, {many} people", ratio, *ALIKE),
        Headline(
            f"Memory: camera without a network, E3Pose, {many} people over {few}",
            most.camera_rss / least.camera_rss, *RISE,
        ),
    ]  # fmt: skip
    if network["SA"] is not None and network["E3Pose"] is not None:
        filmed = (
            f"With the network {NETWORK}: films of {FILMED} drawn people at one slot per second, "
            "one processor thread; it takes drawn people for nobody, so that its edge has no work. "
        )
        with_network = (
            f"A camera with the network {NETWORK} holds {network['SA'].camera_rss:.0f} MB with SA "
            f"and {network['E3Pose'].camera_rss:.0f} MB with E3Pose."
        )
        alike = network["E3Pose"].camera_rss / network["SA"].camera_rss
        headlines.append(Headline(f"Memory: camera with {NETWORK}, E3Pose over SA", alike, *ALIKE))
    size = next(iter(asked.values()))
    return Section(
        paper="E3Pose holds about as much memory as SA, slightly less, because cameras that do "
        "not detect keep their network in memory; memory rises slightly with the people in the "
        "scene. The paper shows a figure without numbers, of its camera devices.",
        ours="With E3Pose a camera that plays keypoints, without a network, holds "
        f"{least.camera_rss:.1f} MB with {few} person in the scene and {most.camera_rss:.1f} MB "
        f"with {many}, the edge {least.edge_rss:.0f} and {most.edge_rss:.0f} MB; with SA and "
        f"{many} people they hold {all_on.camera_rss:.1f} and {all_on.edge_rss:.0f} MB. "
        f"{with_network}",
        why="The paper's claim is about cameras that keep their network in memory, which only the "
        f"rows with {NETWORK} measure. The others say what the rest of a camera's program holds: "
        "selection changes what a camera does, not what it keeps. It is mostly libraries; poses "
        "take kilobytes, so that no rise with people shows. A network with more instances to put "
        "together may need more, which drawn people cannot show. The edge of E3Pose holds more "
        "than that of SA: the predictor's kernels. The paper's devices report the memory of the "
        "whole board.",
        how=f"Measured on this machine: an edge and {size.cameras} cameras, each a process of its "
        f"own, C = {size.selected} with E3Pose, pipeline paper, simulated crowds at "
        f"{size.fps:g} slots per second played as keypoints: cameras load no pixels and no "
        "network, the edge of E3Pose loads the predictor's. A camera holds all that it plays; few "
        f"people move for longer, so that it is as much for any number of them. {filmed}"
        "Resident memory (RSS) and proportional share (PSS, what processes have in common "
        "divided among them), median over "
        f"{size.seconds:g} s and more; a device with one camera holds its RSS.",
        tables=(_table(found),),
        panels=(
            _panel(found, "camera", "A camera's process"),
            _panel(found, "edge", "The edge's process"),
        ),
        headlines=tuple(headlines),
    )  # fmt: skip


def _table(found: dict[tuple[str, int, str], Memory]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for (name, people, detector), memory in found.items():
        shown = "none, keypoints" if detector == KEYPOINTS else detector
        rows.append(
            (
                name, shown, f"{people}", f"{memory.selected:.1f}", f"{memory.people:.1f}",
                memory.camera_rss, memory.camera_pss, memory.edge_rss, memory.edge_pss,
            )
        )  # fmt: skip
    columns = (
        "policy", "network", "people", "cameras on", "people tracked", "camera RSS, MB",
        "camera PSS, MB", "edge RSS, MB", "edge PSS, MB",
    )  # fmt: skip
    return Table("memory", "Memory of the processes of a live site", columns, tuple(rows))


def _panel(found: dict[tuple[str, int, str], Memory], part: str, title: str) -> Panel:
    lines = []
    for name in POLICIES:
        points = {p: m for (n, p, d), m in found.items() if n == name and d == KEYPOINTS}
        values = tuple(m.camera_rss if part == "camera" else m.edge_rss for m in points.values())
        lines.append(Line(name, "measured", tuple(points), values))
    return Panel(
        f"memory-{part}", title, "people in the scene", "RSS, MB", tuple(lines), from_zero=True
    )


ITEM = Item("memory", "Memory against people", "fig:memoryUsage", pieces, section)
