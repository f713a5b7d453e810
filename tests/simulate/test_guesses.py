"""Detectors that guess: errors follow the situation, and lean to who hides a joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.cases import each_case

from e3pose.base.arrays import Floats
from e3pose.base.errors import InputError
from e3pose.model.camera import Camera
from e3pose.recording import Recording
from e3pose.simulate import SCENES, DetectorSettings, Guessing, SceneSettings, adjusted, simulate
from e3pose.simulate.guesses import OUTPUTS, guess, hidden
from e3pose.simulate.place import Scene
from e3pose.simulate.situations import SIZE, draw_fields, situations

pytestmark = pytest.mark.slow

FPS = 12.5
QUIET = Guessing(
    joint_miss=0, own_trunk_miss=0, own_arm_miss=0, own_face_miss=0, other_miss=0, swap=0,
    person_miss=0, taken=0, mirrored=0,
)  # fmt: skip
NEW = ("round-table", "buffet", "reception", "operating-room", "lab")


def standing() -> Floats:
    """One person, `(17, 3)`, who faces x."""
    recording = simulate(
        SceneSettings(people=1, seconds=0.1, detector=DetectorSettings(perfect=True)), 3
    )
    assert recording.truth is not None
    joints = recording.truth.joints_m[0, 0]
    left = joints[5] - joints[6]
    turn = np.arctan2(-left[0], left[1])
    c, s = np.cos(-turn), np.sin(-turn)
    joints = joints - [*joints[11:13, :2].mean(axis=0), 0.0]
    return np.asarray(joints @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T)


def camera_at(angle: float, distance_m: float = 3.5) -> Camera:
    """A level camera that looks at a standing person from `angle` radians to the left of x."""
    x, y = distance_m * np.cos(angle), distance_m * np.sin(angle)
    forward = np.array([-np.cos(angle), -np.sin(angle), 0.0])
    right = np.cross(forward, [0.0, 0.0, 1.0])
    place = np.eye(4)
    place[:3, :3] = np.column_stack([right, [0.0, 0.0, -1.0], forward])
    place[:3, 3] = [x, y, 1.0]
    K = np.array([[1000.0, 0, 600], [0, 1000.0, 600], [0, 0, 1]])
    return Camera("one", (1200, 1200), K, place, np.zeros(0), False)


def errors(
    people: Floats, camera: Camera, settings: Guessing = QUIET, noise: float = 1.0
) -> tuple[Floats, Floats]:
    """Errors in pixels and scores of people `(num_slots, num_persons, 17, 3)`."""
    fields = draw_fields(np.random.default_rng(5), people.shape[1], OUTPUTS)
    pixels = camera.project(people)
    px_per_m = np.full(people.shape[:2], 1000 / 3.5)
    things = np.zeros(people.shape[:3], dtype=bool)
    hid = hidden(camera, people, pixels, things, px_per_m)
    rng = np.random.default_rng(1)
    lost = np.zeros(people.shape[:2])
    found = guess(camera, people, pixels, hid, px_per_m, lost, FPS, fields, settings, noise, rng)
    return found.keypoints_px - pixels, found.scores


def lasting(people: Floats, camera: Camera) -> Floats:
    """The part of the errors that lasts, `(num_persons, 17, 2)`: their mean over slots."""
    return np.asarray(errors(people, camera, replace(QUIET, lasting=1.0))[0].mean(axis=0))


def test_errors_last_while_somebody_stands_still() -> None:
    still = np.repeat(standing()[None, None], 250, axis=0)
    found, _ = errors(still, camera_at(0.3))
    mean = found.mean(axis=0)
    share = (mean**2).sum() / (found**2).sum(axis=(1, 2, 3)).mean()
    assert share == pytest.approx(QUIET.lasting, abs=0.08)
    forgetful, _ = errors(still, camera_at(0.3), replace(QUIET, lasting=0.0))
    assert (forgetful.mean(axis=0) ** 2).sum() < 0.1 * (forgetful**2).sum(axis=(1, 2, 3)).mean()


def alike(a: Floats, b: Floats) -> float:
    return float((a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum()))


def test_errors_change_with_the_direction_of_view_and_smoothly() -> None:
    still = np.repeat(standing()[None, None], 3, axis=0)
    here = lasting(still, camera_at(0.3))
    close = alike(here, lasting(still, camera_at(0.35)))
    near = alike(here, lasting(still, camera_at(0.7)))
    far = alike(here, lasting(still, camera_at(2.5)))
    assert close > 0.97 and 0.5 < near < close
    assert abs(far) < 0.5


def test_errors_change_with_the_posture_and_come_back() -> None:
    still = np.repeat(standing()[None, None], 3, axis=0)
    raised = still.copy()
    raised[..., 9, :] = raised[..., 7, :] + [0.25, 0.0, 0.1]
    camera = camera_at(0.3)
    before, other = lasting(still, camera)[0], lasting(raised, camera)[0]
    assert np.linalg.norm(before[9] - other[9]) > 1.0
    assert before[12] == pytest.approx(other[12], abs=1e-9)  # the right hip stays as it is
    assert lasting(still, camera)[0] == pytest.approx(before)


def test_two_cameras_beside_each_other_err_alike() -> None:
    recording = simulate(SceneSettings(scene="buffet", seconds=4, fps=5), 2)
    assert recording.truth is not None
    means = [mean_errors(recording, index) for index in range(5)]
    both = [np.isfinite(means[0] + mean).all(axis=-1) for mean in means]
    near = alike(means[0][both[3]], means[3][both[3]])  # half a metre apart
    far = [alike(means[0][both[i]], means[i][both[i]]) for i in (1, 2, 4)]
    assert near > 0.35 and near > max(far) + 0.2


def mean_errors(recording: Recording, index: int) -> Floats:
    """Return mean errors `(num_persons, 17, 2)` of one camera in pixels."""
    assert recording.truth is not None
    pixels = recording.rig.cameras[index].project(recording.truth.joints_m)
    found = np.full(pixels.shape, np.nan)
    for slot in range(recording.num_slots):
        view = recording.view(slot, index)
        for keypoints in view.keypoints_px if view else ():
            off = np.nanmedian(np.linalg.norm(keypoints - pixels[slot], axis=-1), axis=-1)
            if np.nanmin(off) < 20:
                found[slot, np.nanargmin(off)] = (keypoints - pixels[slot])[np.nanargmin(off)]
    found[np.linalg.norm(found, axis=-1) > 40] = np.nan
    enough = np.isfinite(found[..., 0]).sum(axis=0) > 10
    mean = np.nansum(found, axis=0) / np.maximum(np.isfinite(found).sum(axis=0), 1)
    return np.where(enough[..., None], mean, np.nan)


def test_joints_behind_somebody_are_put_on_that_person() -> None:
    body = standing()
    two = np.stack([body, body + [1.0, 0.05, 0.0]])  # the second stands before the first
    people = np.repeat(two[None], 40, axis=0)
    taking = replace(QUIET, taken=1.0)
    found, scores = errors(people, camera_at(0.0), taking, noise=0.0)
    pixels = camera_at(0.0).project(people)
    covered = hidden(
        camera_at(0.0), people, pixels, np.zeros(people.shape[:3], bool), np.full((40, 2), 286.0)
    )
    rows = (covered.other[:, 0] > 0.5) & (covered.whom[:, 0] == 1)
    assert rows.any(axis=0).sum() >= 6
    onto = (pixels[:, 1] - pixels[:, 0])[rows]
    assert found[:, 0][rows] == pytest.approx(onto, abs=1e-6)
    assert np.abs(found[:, 1]).max() < 1e-6  # nobody hides the one in front
    assert 0.25 < np.median(scores[:, 0][rows]) < 0.8  # middling


def test_joints_outside_the_image_are_guessed_at_its_edge_and_farther_ones_are_not() -> None:
    people = np.repeat(standing()[None, None], 5, axis=0)
    camera = camera_at(0.2)
    pixels = camera.project(people)
    edge = int(pixels[0, 0, 15, 1] - 5)  # the ankles are just below
    cut = Camera("one", (1200, edge), camera.K, camera.T_world_camera, np.zeros(0), False)
    hid = hidden(cut, people, pixels, np.zeros(people.shape[:3], bool), np.full((5, 1), 286.0))
    assert hid.inside[:, 0, 15].all() and (hid.other[:, 0, 13] == 1).all()
    lower = Camera("one", (1200, edge - 60), camera.K, camera.T_world_camera, np.zeros(0), False)
    hid = hidden(lower, people, pixels, np.zeros(people.shape[:3], bool), np.full((5, 1), 286.0))
    assert not hid.inside[:, 0, 15].any()


def test_fields_are_standard_normal() -> None:
    rng = np.random.default_rng(0)
    values = np.concatenate([
        draw_fields(np.random.default_rng(seed), 1, 2).at(4 * rng.standard_normal((200, 17, SIZE)))
        for seed in range(10)
    ])  # fmt: skip
    assert values.mean() == pytest.approx(0, abs=0.05)
    assert values.std() == pytest.approx(1, abs=0.05)


def test_situations_turn_with_the_person() -> None:
    body = standing()
    c, s = np.cos(1.1), np.sin(1.1)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    hiders, marks = np.full((1, 17, 3), np.nan), np.zeros((1, 2))
    centre = np.array([3.0, 1.0, 1.5])
    here = situations(centre, body[None], marks, hiders, 0.6, 0.2)
    there = situations(turn @ centre, (body @ turn.T)[None], marks, hiders, 0.6, 0.2)
    assert here == pytest.approx(there)


@each_case("scene", NEW)
def test_people_of_new_scenes_stay_for_minutes_and_are_hard_to_see(scene: str) -> None:
    assert SCENES[scene].detector.guessing is not None
    settings = SceneSettings(scene=scene, seconds=20, fps=2, cameras=1)
    recording, again = (simulate(settings, 4) for _ in range(2))
    assert recording.detector == "openpose" and recording.truth is not None
    np.testing.assert_array_equal(recording.views[0].keypoints_px, again.views[0].keypoints_px)
    np.testing.assert_array_equal(recording.views[0].scores, again.views[0].scores)
    hips = recording.truth.joints_m[:, :, 11:13].mean(axis=2)
    moved = np.linalg.norm(hips[1:] - hips[:-1], axis=-1)  # in half a second
    assert (moved < 0.15).mean() > 0.75


def test_a_table_hides_legs_and_a_raised_floor_lifts_people() -> None:
    table = SCENES["round-table"].occluders[0]
    eye, knee = np.array([2.5, 2.0, 2.4]), np.array([-0.4, -0.45, 0.5])
    assert table.blocks(eye, knee) and not table.blocks(eye, np.array([-0.4, -0.9, 1.1]))
    assert not table.blocks(np.array([2.5, 0.0, 0.4]), knee)  # one sees through below
    lab: Scene = SCENES["lab"]
    heights = lab.floor_m(np.array([[-1.0, -1.0], [1.0, 1.0], [-0.3, -1.0], [np.nan, 0.0]]))
    assert heights[:3] == pytest.approx([0.3, 0.0, 0.15])


def test_scores_of_another_detector_state_too_much() -> None:
    honest = DetectorSettings(guessing=Guessing())
    boastful = adjusted(honest, {"overconfidence": 1.0})
    settings = SceneSettings(scene="lab", seconds=2, fps=5)
    one, other = (simulate(replace(settings, detector=d), 1) for d in (honest, boastful))
    a, b = (np.concatenate([s.scores[s.scores > 0] for s in r.views]) for r in (one, other))
    assert np.median(b) > np.median(a) + 0.05
    found = [r.views[0].keypoints_px[:3] for r in (one, other)]
    np.testing.assert_allclose(found[0], found[1])


@each_case(
    ("figures", "message"),
    [
        ({"lasting": 2.0}, "guessing lasting: found 2"),
        ({"view_rad": 0.0}, "guessing view_rad: found 0"),
        ({"kindness": 1.0}, "found 'kindness', expected one of blur, ghosts,"),
    ],
)
def test_bad_figures_are_named(figures: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        adjusted(DetectorSettings(guessing=Guessing()), figures)
