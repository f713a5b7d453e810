"""How well feet are followed, by where they hang in the filter's tree."""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np

from e3pose.estimate.filter import bones as bones_of
from e3pose.estimate.filter import tree
from e3pose.evaluate.replay import ReplaySettings, replay
from e3pose.simulate import SceneSettings, simulate
from e3pose.simulate.feet import with_skeleton

SCENE = SceneSettings("ring", people=2, seconds=6.0, fps=25.0, cameras=5)
SEEDS = tuple(range(701, 709))
WARM_SLOTS = 25
FEET = ("toe", "heel")
FOOT_BONES = (("ankle", "big_toe"), ("ankle", "heel"), ("big_toe", "small_toe"),
              ("heel", "big_toe"), ("heel", "small_toe"))  # fmt: skip


def unknown() -> None:
    """Forget the feet and the top of the head: they hang on the hips."""
    for name in [n for n in tree.PARENTS if n.endswith(FEET) or n == "top_head"]:
        del tree.PARENTS[name]


def head_on_nose() -> None:
    """Let the top of the head hang on the nose."""
    tree.PARENTS["top_head"] = (("nose",), tree.STIFF)


def bones() -> None:
    """Learn the lengths of the bones of feet, too, with the top of the head on the nose."""
    head_on_nose()
    more = ((f"{s}_{a}", f"{s}_{b}") for s in bones_of.SIDES for a, b in FOOT_BONES)
    vars(bones_of)["STIFF"] = (*bones_of.STIFF, *more)


def no_lengths() -> None:
    """Forget how long feet usually are."""
    for name, (parents, habit) in list(tree.PARENTS.items()):
        tree.PARENTS[name] = (parents, habit._replace(usual_m=0.0))


VARIANTS: dict[str, Callable[[], object]] = {
    "as-it-is": lambda: None,
    "unknown": unknown,
    "bones": bones,
    "no-lengths": no_lengths,
    "head-on-nose": head_on_nose,
}


def errors_mm(name: str) -> dict[str, float]:
    """Return mean errors of groups of joints, two cameras per slot."""
    found: dict[str, list[float]] = {}
    for seed in SEEDS:
        recording = with_skeleton(simulate(SCENE, seed), name, seed)
        assert recording.truth is not None
        truth_m = recording.truth.joints_m
        for record in replay(recording, ReplaySettings(num_selected=2, predictor="zero-velocity")):
            if record.slot < WARM_SLOTS:
                continue
            for joints_m in record.poses.joints_m:
                off = np.linalg.norm(truth_m[record.slot] - joints_m, axis=-1)
                person = off[np.nanmedian(off, axis=1).argmin()]
                if np.nanmedian(person) > 0.3:
                    continue
                for joint, error in zip(recording.skeleton.joints, person.tolist(), strict=True):
                    group = "feet" if joint.endswith(FEET) else "body"
                    group = joint if joint == "top_head" else group
                    for each in {group, "ankles" if joint.endswith("ankle") else group}:
                        found.setdefault(each, []).append(error)
    return {group: 1000 * float(np.nanmean(values)) for group, values in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("variant", choices=VARIANTS, nargs="?", default="as-it-is")
    VARIANTS[(variant := parser.parse_args().variant)]()
    for name in ("body25", "halpe26"):
        shown = ", ".join(f"{group} {error:.1f}" for group, error in errors_mm(name).items())
        print(f"{variant}, {name}: {shown} mm", flush=True)


if __name__ == "__main__":
    main()
