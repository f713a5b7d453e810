"""Is the error that is stated the error that is made, and is a target error kept?

    python lab/benchmarks/stated_errors.py --cameras 1,2,4 --lead 1,4
    python lab/benchmarks/stated_errors.py --cameras "" --targets 30,40,60

Simulated scenes with known truth. First table: mean error stated over mean error made, and the
share of joints within the stated 90 % distance, over scenes and seeds. With a target error: for
each scene and lead the mean over seeds, with its standard error, and then every run. Only slots
for which cameras were chosen count, from the end of the warm-up on.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptive_choice import FPS, LEADS, PARTIAL, SECONDS, SYMMETRIC

MM = 1000.0
NEAR = 0.1


@dataclass(frozen=True, slots=True)
class Run:
    """One replay: millimetres, and percent of the joints within the stated 90 % distance."""

    scene: str
    lead: int
    policy: str
    count: float
    target_mm: float | None
    cameras_on: float
    foreseen: float
    stated: float
    made: float
    within: float


def run(
    scene: str,
    seed: int,
    recording: Any,
    lead: int,
    policy: str,
    count: float,
    target_mm: float | None = None,
) -> Run:
    """Replay once; the count of cameras is left aside where there is a target."""
    from e3pose.evaluate.figures import expected_figures
    from e3pose.evaluate.replay import ReplaySettings, replay

    settings = ReplaySettings(
        policy=policy,
        num_selected=None if target_mm else min(count, len(recording.rig)),
        target_error_m=target_mm / MM if target_mm else None,
        lead_slots=lead,
        phase=seed % 1000,
    )
    records = [each for each in replay(recording, settings) if each.slot >= settings.warmup_slots]
    found = expected_figures(recording, records)
    nothing = (found.foreseen_mm, found.matched_mm, found.actual_mm, found.coverage_90)
    foreseen, stated, made, within = (np.nan if each is None else each for each in nothing)
    cameras_on = float(np.mean([record.selected.sum() for record in records]))
    return Run(scene, lead, policy, count, target_mm, cameras_on, foreseen, stated, made, within)


def runs(options: argparse.Namespace) -> Iterator[Run]:
    """Simulate each scene and replay it in every way asked for."""
    from e3pose.simulate import SCENES, SceneSettings, simulate

    for seed in range(options.first_seed, options.first_seed + options.seeds):
        for scene in options.scenes.split(","):
            fps = FPS if SCENES[scene].fps > FPS else None
            recording = simulate(SceneSettings(scene=scene, seconds=SECONDS, fps=fps), seed)
            for lead in map(int, numbers(options.lead)):
                for count in numbers(options.cameras):
                    for policy in options.policies.split(","):
                        yield run(scene, seed, recording, lead, policy, count)
                for target_mm in numbers(options.targets):
                    yield run(scene, seed, recording, lead, "information", 0, target_mm)


def numbers(text: str) -> list[float]:
    return [float(part) for part in text.split(",") if part]


def stated(found: Sequence[Run], leads: Sequence[float]) -> Iterator[str]:
    """Yield a table in Markdown over all scenes and seeds."""
    yield (
        "| policy, cameras | lead | stated / made | lowest, highest | within 10 %, 15 % | "
        "in 90 % | lowest, highest |"
    )
    yield "|---" * 7 + "|"
    for policy, count in sorted({(each.policy, each.count) for each in found}):
        for lead in leads:
            mine = [r for r in found if (r.policy, r.count, r.lead) == (policy, count, lead)]
            ratio = np.array([each.stated / each.made for each in mine])
            within = np.array([each.within for each in mine])
            off = np.abs(ratio - 1)
            yield (
                f"| {policy}, {count:g} | {lead:g} | {np.exp(np.log(ratio).mean()):.2f} | "
                f"{ratio.min():.2f}, {ratio.max():.2f} | "
                f"{100 * (off < NEAR).mean():.0f}, {100 * (off < 1.5 * NEAR).mean():.0f} % | "
                f"{within.mean():.1f} | {within.min():.0f}, {within.max():.0f} |"
            )


def kept(found: Sequence[Run], leads: Sequence[float], target_mm: float) -> Iterator[str]:
    """Yield a table in Markdown by scene, means over seeds: cameras on, stated / made in mm."""
    yield f"| {target_mm:g} mm | " + " | ".join(f"lead {lead:g}" for lead in leads) + " |"
    yield "|---" * (len(leads) + 1) + "|"
    means, deviations = [], []
    for scene in dict.fromkeys(each.scene for each in found):
        cells = []
        for lead in leads:
            mine = [each for each in found if (each.scene, each.lead) == (scene, lead)]
            made = np.array([each.made for each in mine])
            on = np.mean([each.cameras_on for each in mine])
            stated_mm = np.mean([each.stated for each in mine])
            doubt = made.std(ddof=1) if len(made) > 1 else np.nan
            cells.append(
                f"{on:.2f}, {stated_mm:.1f} / {made.mean():.1f} ± {doubt / len(made) ** 0.5:.1f}"
            )
            means.append(float(made.mean()))
            deviations.append(float(doubt))
        yield f"| `{scene}` | {' | '.join(cells)} |"
    of_leads = [np.mean([each.made for each in found if each.lead == lead]) for lead in leads]
    yield "| mean | " + " | ".join(f"{mean:.1f}" for mean in of_leads) + " |"
    within = np.mean([each.within for each in found])
    cameras = np.mean([each.cameras_on for each in found])
    yield ""
    yield counted_within("means over seeds", means, target_mm)
    yield counted_within("runs", [each.made for each in found], target_mm)
    above = [each for each in found if each.made > (1 + NEAR) * target_mm]
    said = sum(each.stated > (1 + NEAR) * target_mm for each in above)
    yield f"{said} of the {len(above)} runs above were stated above as well"
    yield (
        f"standard deviation over seeds {np.mean(deviations):.1f} mm; {within:.1f} % of joints "
        f"within the stated 90 % distance; {cameras:.2f} cameras\n"
    )


def counted_within(what: str, made_mm: Sequence[float], target_mm: float) -> str:
    """Say how many errors are near the target, above and below."""
    off = np.array(made_mm) / target_mm - 1
    return (
        f"{what}: {(np.abs(off) <= NEAR).sum()} of {len(off)} within {100 * NEAR:g} % of the "
        f"target, {(off > NEAR).sum()} above, {(off < -NEAR).sum()} below"
    )


def single(found: Sequence[Run], leads: Sequence[float], target_mm: float) -> Iterator[str]:
    """Yield a table in Markdown of the error made in every run, in mm."""
    yield (
        f"| {target_mm:g} mm, each seed | " + " | ".join(f"lead {lead:g}" for lead in leads) + " |"
    )
    yield "|---" * (len(leads) + 1) + "|"
    for scene in dict.fromkeys(each.scene for each in found):
        of_scene = [each for each in found if each.scene == scene]
        cells = (" ".join(f"{r.made:.0f}" for r in of_scene if r.lead == lead) for lead in leads)
        yield f"| `{scene}` | {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", default=",".join((*PARTIAL, *SYMMETRIC)))
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--lead", default=",".join(map(str, LEADS)))
    parser.add_argument("--cameras", default="1,2,4")
    parser.add_argument("--policies", default="round-robin,information")
    parser.add_argument("--targets", default="", help="mm, several")
    options = parser.parse_args()
    found = list(runs(options))
    leads = numbers(options.lead)
    counted = [each for each in found if each.target_mm is None]
    if counted:
        print("\n".join(stated(counted, leads)), end="\n\n")
    for target_mm in numbers(options.targets):
        aimed = [each for each in found if each.target_mm == target_mm]
        print("\n".join(kept(aimed, leads, target_mm)))
        print("\n".join(single(aimed, leads, target_mm)), end="\n\n")


if __name__ == "__main__":
    main()
