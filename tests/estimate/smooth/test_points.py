"""The smoother of kept poses: it reads the filter back that made them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.estimate.smooth.motions import motion, waving

from e3pose.estimate.filter.motion import alone, fading
from e3pose.estimate.filter.tree import grow
from e3pose.estimate.smooth import FIRST_SPEED_MPS, smooth_points
from e3pose.estimate.smooth.gaps import fill_gaps
from e3pose.model.skeleton import COCO17
from e3pose.model.take import FILLED

DT = 0.04


def test_answers_of_a_filter_give_the_smoother_of_what_it_measured() -> None:
    rng = np.random.default_rng(1)
    num_slots, joint = 60, 9
    drift, lasts_s = alone(grow(COCO17))
    F, Q = (each[joint] for each in fading(drift, lasts_s, DT))
    truth = waving(num_slots, 0.7, 1 / DT)[:, joint, 0]
    noise = rng.uniform(0.01, 0.05, num_slots)
    seen = truth + noise * rng.normal(size=num_slots)
    mean, covariance = np.array([seen[0], 0.0]), np.diag([noise[0] ** 2, FIRST_SPEED_MPS**2])
    means, covariances = [mean], [covariance]
    for slot in range(1, num_slots):
        mean, covariance = F @ mean, F @ covariance @ F.T + Q
        if slot % 3:  # the others see nothing
            K = covariance[:, 0] / (covariance[0, 0] + noise[slot] ** 2)
            mean = mean + K * (seen[slot] - mean[0])
            covariance = covariance - np.outer(K, covariance[0])
        means.append(mean)
        covariances.append(covariance)
    wanted = means[-1]
    path = [wanted[0]]
    for slot in range(num_slots - 2, -1, -1):
        P = F @ covariances[slot] @ F.T + Q
        K = covariances[slot] @ F.T @ np.linalg.inv(P)
        wanted = means[slot] + K @ (wanted - F @ means[slot])
        path.insert(0, wanted[0])
    joints = np.zeros((num_slots, 17, 3))
    joints[:, :, 0] = np.array(means)[:, :1]
    sigma = np.sqrt(np.array(covariances)[:, :1, 0]) * np.ones(17)
    found = smooth_points(motion(joints, sigma), COCO17, DT)
    # Slots that showed nothing count as if they had shown a thousandth.
    np.testing.assert_allclose(found.joints_m[:, joint, 0], path, atol=2e-4)


def test_a_gap_divides_and_a_filled_one_does_not() -> None:
    joints = waving(40, 0.5, 25.0)
    joints[15:18] = np.nan
    divided = smooth_points(motion(joints), COCO17, DT)
    assert np.isnan(divided.joints_m[15:18]).all()
    alone_ = smooth_points(motion(joints[:15]), COCO17, DT)
    np.testing.assert_allclose(divided.joints_m[:15], alone_.joints_m)
    filled = smooth_points(fill_gaps(motion(joints), 3), COCO17, DT)
    assert (filled.origin[15:18] == FILLED).all()
    true = waving(40, 0.5, 25.0)
    assert np.linalg.norm(filled.joints_m - true, axis=-1)[15:18].max() < 0.02


def test_poses_without_a_stated_error_are_measurements() -> None:
    rng = np.random.default_rng(2)
    true = waving(100, 0.3, 25.0)
    noisy = true + rng.normal(scale=0.03, size=true.shape)
    found = smooth_points(motion(noisy, np.nan), COCO17, DT)
    before = np.linalg.norm(noisy - true, axis=-1).mean()
    assert np.linalg.norm(found.joints_m - true, axis=-1).mean() < 0.6 * before
    assert np.isnan(found.sigma_m).all()


def test_dynamics_that_were_kept_tell_how_a_joint_moved_that_nothing_showed() -> None:
    """A wrist goes with the arm: the body's filter knew its velocity, the kept places do not."""
    rng = np.random.default_rng(3)
    num_slots, joint = 80, 9
    drift, lasts_s = alone(grow(COCO17))
    F, Q = (each[joint] for each in fading(drift, lasts_s, DT))
    truth = waving(num_slots, 0.7, 1 / DT)[:, joint, 0]
    speed = np.gradient(truth, DT)
    means, covariances = np.zeros((num_slots, 2)), np.zeros((num_slots, 2, 2))
    mean, covariance = np.array([truth[0], speed[0]]), np.diag([0.02**2, 0.3**2])
    for slot in range(num_slots):
        mean, covariance = F @ mean, F @ covariance @ F.T + Q
        # One view in five shows the wrist; how fast the arm goes is measured in every slot.
        shows = np.array([[1.0, 0.0], [0.0, 1.0]])[1 if slot % 5 else 0 :]
        noise = np.array([0.02, 0.2])[1 if slot % 5 else 0 :]
        seen = shows @ [truth[slot], speed[slot]] + noise * rng.normal(size=len(noise))
        K = covariance @ shows.T @ np.linalg.inv(shows @ covariance @ shows.T + np.diag(noise**2))
        mean, covariance = mean + K @ (seen - shows @ mean), covariance - K @ shows @ covariance
        means[slot], covariances[slot] = mean, covariance
    path = [mean[0]]
    wanted = mean
    for slot in range(num_slots - 2, -1, -1):
        P = F @ covariances[slot] @ F.T + Q
        wanted = means[slot] + covariances[slot] @ F.T @ np.linalg.inv(P) @ (
            wanted - F @ means[slot]
        )
        path.insert(0, wanted[0])
    joints, dynamics = np.zeros((num_slots, 17, 3)), np.zeros((num_slots, 17, 6))
    joints[:, :, 0], dynamics[:, :, 0] = means[:, :1], means[:, 1:]
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    dynamics[:, :, 3:5] = sigma[:, None]
    dynamics[:, :, 5] = (covariances[:, 0, 1] / sigma.prod(axis=1))[:, None]
    kept = replace(motion(joints, np.repeat(sigma[:, :1], 17, axis=1)), dynamics=dynamics)
    found = smooth_points(kept, COCO17, DT)
    np.testing.assert_allclose(found.joints_m[:, joint, 0], path, atol=1e-9)
    assert (found.sigma_m[:-1, joint] < kept.sigma_m[:-1, joint]).all()
    np.testing.assert_allclose(found.sigma_m[-1], kept.sigma_m[-1])
    # Errors that views repeat are stated beyond what the filter knows: no slots average them out.
    repeated = smooth_points(replace(kept, sigma_m=np.hypot(kept.sigma_m, 0.03)), COCO17, DT)
    np.testing.assert_allclose(repeated.sigma_m, np.hypot(found.sigma_m, 0.03))
    alone_known = smooth_points(replace(kept, dynamics=None), COCO17, DT)
    off = [np.abs(each.joints_m[:, joint, 0] - truth).mean() for each in (found, alone_known, kept)]
    assert off[0] < 0.8 * off[1] and off[0] < 0.8 * off[2], off
