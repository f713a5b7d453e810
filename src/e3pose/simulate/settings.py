"""Settings of a simulation: scene, people, cameras, imperfection of detectors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from e3pose.base.errors import InputError
from e3pose.model.camera import Rig
from e3pose.model.noise import ErrorMemory

MAX_PEOPLE = 50
MAX_CAMERAS = 64
MAX_SLOTS = 1_000_000
MAX_VIEW_PEOPLE = 4_000_000  # slots x cameras x people: what fits a small machine's memory
MAX_SECONDS = 4 * 3600.0
MAX_PERSON_SECONDS = 100_000
BESIDE_GUESSES = {"noise", "blur", "merge", "ghosts"}  # figures that hold for guesses, too


@dataclass(frozen=True, slots=True)
class Guessing:
    """Guesses of a detector about hidden joints; formulas: docs/reference/simulation.md.

    Fitted to OpenPose's detections of Shelf and of the first half of Panoptic's pizza scene,
    without labels, by `lab/benchmarks/detector_errors.py`.

    Attributes:
        sigma_m: standard deviation of either image axis at the person's distance, of a shoulder
            with a typical score, metres.
        lasting: share of the variance that follows the situation; the rest fades in 0.15 s.
        view_rad: change of the direction of view by which an error becomes another one.
        posture_m: way of a joint, relative to the torso, by which it does.
        joint_miss: share of joints in plain sight that are missed.
        own_trunk_miss: the same of shoulders, hips and legs behind the person's own body.
        own_arm_miss: the same of elbows and wrists.
        own_face_miss: the same of the face when the head is seen from behind.
        other_miss: the same of joints behind another person or a thing, or cut by the image.
        guess_factor: how many times larger the errors of hidden joints are.
        taken: share of joints behind another person that are put on that person.
        mirrored: share of arms and legs behind the own body that are put on the other side's.
        hidden_odds: log-odds of the score that a hidden joint loses.
        swap: share of the situations in which left and right are exchanged.
        person_miss: share of the situations in which the whole person is missed.
        overconfidence: log-odds that scores state too much; errors are those of the true score.
    """

    sigma_m: float = 0.023
    lasting: float = 0.78
    view_rad: float = 0.6
    posture_m: float = 0.16
    joint_miss: float = 0.02
    own_trunk_miss: float = 0.07
    own_arm_miss: float = 0.4
    own_face_miss: float = 0.85
    other_miss: float = 0.5
    guess_factor: float = 1.8
    taken: float = 0.25
    mirrored: float = 0.02
    hidden_odds: float = 1.1
    swap: float = 0.01
    person_miss: float = 0.02
    overconfidence: float = 0.0

    def __post_init__(self) -> None:
        limits = {
            "sigma_m": (0.0, 1.0), "view_rad": (0.05, 10.0), "posture_m": (0.01, 10.0),
            "guess_factor": (0.0, 20.0), "hidden_odds": (0.0, 20.0),
            "overconfidence": (-20.0, 20.0),
        }  # fmt: skip
        for item in fields(self):
            low, high = limits.get(item.name, (0.0, 1.0))
            check_number(f"guessing {item.name}", getattr(self, item.name), low, high)


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """Errors of a simulated detector; the defaults resemble OpenPose on Shelf, by score alone.

    Attributes:
        guessing: errors that follow the situation. With it, `blur`, `merge` and `ghosts` apply,
            and `noise` as a factor; misses and swaps are its own, and `memory` that of ghosts.
        noise: factor on the keypoint noise; 0 puts every keypoint where the joint projects.
        joint_miss: share of joints in plain sight that are missed.
        self_occluded_miss: share missed of joints hidden by the person's own body.
        behind_head_miss: the same for the face, when the head is seen from behind.
        occluded_miss: share missed of joints hidden by another person or an object.
        person_miss: share of person-views missed as a whole, in episodes.
        swap: share of person-views with left and right exchanged, in episodes.
        merge: share of the views of two overlapping people in which they become one detection.
        ghosts: expected false people in a view.
        blur: log-odds taken from every score, as by a dirty or badly focused lens.
        memory: how long the errors of keypoints last.
        perfect: report every joint inside the image at its exact pixel with score 1, hidden or
            not, and nobody else; all the above is then without effect.
    """

    noise: float = 1.0
    joint_miss: float = 0.03
    self_occluded_miss: float = 0.45
    behind_head_miss: float = 0.85
    occluded_miss: float = 0.8
    person_miss: float = 0.01
    swap: float = 0.01
    merge: float = 0.15
    ghosts: float = 0.05
    blur: float = 0.0
    memory: ErrorMemory = field(default_factory=ErrorMemory)
    guessing: Guessing | None = None
    perfect: bool = False

    def __post_init__(self) -> None:
        for item in fields(self):
            if item.name in ("memory", "guessing", "perfect"):
                continue
            high = {"noise": 100.0, "ghosts": 20.0, "blur": 20.0}.get(item.name, 1.0)
            check_number(f"detector {item.name}", getattr(self, item.name), 0.0, high)


def adjusted(detector: DetectorSettings, figures: Mapping[str, float]) -> DetectorSettings:
    """Return the detector with some figures changed, by name; those of its guesses go first.

    Raises:
        InputError: when a name is unknown or a figure out of range.
    """
    guessing = detector.guessing
    own: dict[str, Any] = {}
    names = {item.name for item in fields(DetectorSettings)} - {"memory", "guessing", "perfect"}
    guesses: set[str] = set()
    if guessing is not None:
        names, guesses = names & BESIDE_GUESSES, {item.name for item in fields(Guessing)}
    for name, value in figures.items():
        if guessing is not None and name in guesses:
            guessing = replace(guessing, **{name: value})
        elif name in names:
            own[name] = value
        else:
            raise InputError(
                f"simulate: figure of errors: found {name[:40]!r}, expected one of "
                + ", ".join(sorted(names | guesses))
            )
    return replace(detector, guessing=guessing, **own)


@dataclass(frozen=True, slots=True, eq=False)
class SceneSettings:
    """Settings of a simulated scene.

    Attributes:
        scene: a name in `SCENES`.
        people: how many individuals take part; the scene's own number by default.
        seconds: length of the recording.
        fps: slots per second; the scene's own rate by default.
        cameras: how many cameras; the scene's own number by default. Where a scene has places for
            cameras of its own, the first so many of them.
        radius_m: distance of the ring's cameras from the centre; the scene's own by default.
        height_m: height of the ring's cameras; the scene's own by default.
        image_size: `(width, height)` of the ring's images in pixels.
        rig: a user's own rig, used instead of the ring; its world has z up and the floor at z = 0.
        detector: how imperfect the detections are; the scene's own by default.

    Raises:
        InputError: when a value is out of range.
    """

    scene: str = "ring"
    people: int | None = None
    seconds: float = 60.0
    fps: float | None = None
    cameras: int | None = None
    radius_m: float | None = None
    height_m: float | None = None
    image_size: tuple[int, int] = (1032, 776)
    rig: Rig | None = None
    detector: DetectorSettings | None = None

    def __post_init__(self) -> None:
        if self.people is not None:
            check_number("people", self.people, 0, MAX_PEOPLE, whole=True)
        if self.cameras is not None:
            check_number("cameras", self.cameras, 1, MAX_CAMERAS, whole=True)
        if self.fps is not None:
            check_number("fps", self.fps, 0.5, 1000)
        check_number("seconds", self.seconds, 0, MAX_SECONDS)
        for name, value, high in (
            ("radius", self.radius_m, 100.0),
            ("height", self.height_m, 50.0),
        ):
            if value is not None:
                check_number(name, value, {"radius": 1.0, "height": 0.1}[name], high)
        if len(self.image_size) != 2:
            raise InputError(
                f"simulate: image size: found {self.image_size!r}, expected (width, height)"
            )
        for name, size in zip(("image width", "image height"), self.image_size, strict=True):
            check_number(name, size, 64, 20_000, whole=True)

    def check_size(self, num_slots: int, num_cameras: int, num_people: int) -> None:
        """Raise `InputError` if so many cameras and people over this time would not fit memory."""
        for name, size, most in (
            ("slots x cameras x people", num_slots * num_cameras * num_people, MAX_VIEW_PEOPLE),
            ("seconds x people", self.seconds * num_people, MAX_PERSON_SECONDS),
        ):
            if size > most:
                raise InputError(
                    f"simulate: {name}: found {size:.0f}, expected at most {most}; "
                    "make it shorter or smaller"
                )


def check_number(name: str, value: float, low: float, high: float, whole: bool = False) -> None:
    """Raise `InputError` unless `value` is a number in [low, high], and whole if asked."""
    if math.isfinite(value) and low <= value <= high and (not whole or value == int(value)):
        return
    kind = "a whole number" if whole else "a number"
    raise InputError(
        f"simulate: {name}: found {value:g}, expected {kind} from {low:g} to {high:.10g}"
    )
