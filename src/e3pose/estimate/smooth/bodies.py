"""Rauch-Tung-Striebel smoothing of whole bodies, from the filter's posteriors.

A body of the filter is a Gaussian tree over the joints (`filter.tree`). Written out it is one
Gaussian of all positions and velocities, moved on by the filter's own motion model
(`filter.motion`), with the velocities and the noise that steering left; `rauch` takes it back.
Nothing is linearised again and no view is read: all that views said is in the posteriors.

Stated errors: a smoother averages over slots what the filter takes for independent. The filter's
published covariance has two parts (`filter.covariance_inflation`, `filter.lasting`): its own, times
a factor, and the errors that views repeat, which no number of slots averages out:

    S = f^2 (P + 0.3 g (P0 - P)) + R + g (R' - R)

with P of the smoother, P0 of the filter, and g, R and R' of `filter.lasting` (fit:
`lab/experiments/2026-11-24-smoothed-covariances.md`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from e3pose.base.arrays import Floats, Integers
from e3pose.estimate.base import Posterior
from e3pose.estimate.filter.bones import Proportions
from e3pose.estimate.filter.lasting import grown_m2
from e3pose.estimate.filter.motion import places, transitions
from e3pose.estimate.filter.proportions import kept
from e3pose.estimate.filter.tree import Tree
from e3pose.estimate.smooth.rauch import Expected, expect, step_back

# tuned: share | lab/experiments/2026-11-24-smoothed-covariances.md | in the radius by the truth: 86
#   to 94 % of the joints, 58 to 92 with neither this nor g
SHARED = 0.3  # of what smoothing gains, where g is 1: errors that slots share


def own_m2(filtered_m2: Floats, smoothed_m2: Floats, inflation: Floats, excess: float) -> Floats:
    """Return the first part of S, `(*batch, 3, 3)` square metres.

    Args:
        filtered_m2: `(*batch, 3, 3)` P0.
        smoothed_m2: `(*batch, 3, 3)` P.
        inflation: `(*batch)` f.
        excess: g.
    """
    shared_m2 = SHARED * excess * (filtered_m2 - smoothed_m2)
    return np.asarray(inflation[..., None, None] ** 2 * (smoothed_m2 + shared_m2))


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """All tracks of one slot, smoothed by later slots.

    Attributes:
        posterior: what the filter knew in the slot.
        mean: `(num_tracks, 6 num_joints, 1)` position and velocity, joint by joint.
        covariance: `(num_tracks, 6 num_joints, 6 num_joints)` of them.
        bones_m: `(num_tracks, num_bones)` lengths that the last of these slots had learned.
        bone_counts: `(num_tracks, num_bones)` slots that taught them.
    """

    posterior: Posterior
    mean: Floats
    covariance: Floats
    bones_m: Floats
    bone_counts: Floats

    @property
    def joints_m(self) -> Floats:
        """`(num_tracks, num_joints, 3)` metres."""
        return np.asarray(self.mean.reshape(self.posterior.state.shape)[..., :3])

    @property
    def covariance_m2(self) -> Floats:
        """`(num_tracks, num_joints, 3, 3)` of the positions."""
        num_tracks, num_joints = self.posterior.state.shape[:2]
        blocks = self.covariance.reshape(num_tracks, num_joints, 6, num_joints, 6)
        own = np.moveaxis(np.diagonal(blocks, axis1=1, axis2=3), -1, 1)
        return np.asarray(own[..., :3, :3])

    def published(self, scores: Floats, body: Proportions) -> tuple[Floats, Floats]:
        """Return the published people of the slot, and their covariances (`stated`).

        A joint that was missing stays missing, and limbs are as long as they can be.

        Args:
            scores: `(num_persons, num_joints)` as they were shown.
            body: the bones.

        Returns:
            `(num_persons, num_joints, 3)` metres and `(num_persons, num_joints, 3, 3)`.
        """
        posterior = self.posterior
        rows = posterior.shown
        known = scores > 0
        joints_m = np.where(known[..., None], self.joints_m[rows], np.nan)
        filtered_m2 = np.where(
            known[..., None, None], posterior.covariance[rows, :, :3, :3], np.nan
        )
        own = own_m2(filtered_m2, self.covariance_m2[rows], posterior.inflation, posterior.excess)
        lengths = self.bones_m[rows], self.bone_counts[rows]
        joints_m, own, _ = kept(body, *lengths, joints_m, own, known)
        again = grown_m2(posterior.repeated_m2, posterior.lasting_m2, posterior.excess)
        return joints_m, own + again


def smooth_backwards(tree: Tree, posteriors: Iterable[Posterior]) -> Iterator[Smoothed]:
    """Yield every slot smoothed by all slots, the last first: the fixed-interval smoother.

    Args:
        tree: of the skeleton.
        posteriors: from the last slot to the first; a track is the same as long as its id is there.
    """
    later: Posterior | None = None
    smoothed: Smoothed | None = None
    for posterior in posteriors:
        smoothed = _taken_back(_linked(tree, posterior, later), smoothed)
        later = posterior
        yield smoothed


@dataclass
class FixedLag:
    """Fixed-lag smoother: each slot is returned `lag_slots` slots later.

    Attributes:
        tree: of the skeleton.
        lag_slots: how many later slots a slot waits for.
    """

    tree: Tree
    lag_slots: int
    _links: deque[_Link] = field(default_factory=deque)

    def push(self, posterior: Posterior) -> Smoothed | None:
        """Add a slot; return the one `lag_slots` before it, None while there is none."""
        if self._links:
            before = self._links[-1]
            self._links[-1] = _linked(self.tree, before.posterior, posterior)
        self._links.append(_linked(self.tree, posterior, None))
        return self._oldest() if len(self._links) > self.lag_slots else None

    def flush(self) -> Smoothed | None:
        """Return the next waiting slot, smoothed so far; None without one."""
        return self._oldest() if self._links else None

    def _oldest(self) -> Smoothed | None:
        smoothed: Smoothed | None = None
        for link in reversed(self._links):
            smoothed = _taken_back(link, smoothed)
        self._links.popleft()
        return smoothed


def written_out(tree: Tree, covariance: Floats, shared: Floats) -> Floats:
    """Return the covariance of whole bodies, `(num_tracks, 6 num_joints, 6 num_joints)`.

    Args:
        tree: of the skeleton.
        covariance: `(num_tracks, num_joints, 6, 6)` of each joint.
        shared: `(num_tracks, num_joints, 6, 6)` of each joint with its parent.
    """
    num_tracks, num_joints = covariance.shape[:2]
    whole = np.zeros((num_joints, num_joints, num_tracks, 6, 6))
    across = np.swapaxes(shared[:, tree.order[1:]], -1, -2)
    of_parents = covariance[:, tree.parents[tree.order[1:]]]
    gains = np.swapaxes(np.linalg.solve(of_parents, across), -1, -2)
    done: list[int] = []
    for row, joint in enumerate(tree.order.tolist(), start=-1):
        if row >= 0:  # given its parent, a joint does not depend on the others
            whole[joint, done] = gains[:, row] @ whole[tree.parents[joint], done]
            whole[done, joint] = np.swapaxes(whole[joint, done], -1, -2)
        whole[joint, joint] = covariance[:, joint]
        done.append(joint)
    size = 6 * num_joints
    return np.asarray(whole.transpose(2, 0, 3, 1, 4).reshape(num_tracks, size, size))


def body_transition(tree: Tree, dt: float, drift_share: Floats) -> tuple[Floats, Floats]:
    """Return F of a whole body over `dt` seconds and Q of each.

    x' = F x + w, Cov w = Q: what `filter.motion` says joint by joint.

    Args:
        tree: of the skeleton.
        dt: seconds, 0 or more.
        drift_share: `(num_tracks, num_joints)` share of the process noise that counts.

    Returns:
        `(6 num_joints, 6 num_joints)` and `(num_tracks, 6 num_joints, 6 num_joints)`.
    """
    num_joints = len(tree.parents)
    move = np.zeros((num_joints, 6, num_joints, 6))
    above = np.zeros((num_joints, num_joints))  # whose noise a joint takes part in
    R, own = transitions(tree, dt)
    for joint in tree.order.tolist():
        parent = int(tree.parents[joint])
        move[joint, :, joint] += R[joint]
        above[joint, joint] = 1.0
        if parent >= 0:
            move[joint] += move[parent]
            move[joint, :, parent] -= R[joint]
            above[joint] += above[parent]
    both = above[:, None] * above  # in whose noise two joints both take part
    shares = both * drift_share[:, None, None]  # (num_tracks, num_joints, num_joints, num_joints)
    noise = (shares @ own.reshape(num_joints, 36)).reshape(-1, num_joints, num_joints, 6, 6)
    noise = noise.swapaxes(2, 3)
    size = 6 * num_joints
    return move.reshape(size, size), noise.reshape(-1, size, size)


@dataclass(frozen=True, slots=True, eq=False)
class _Link:
    """A slot and its prediction of the next one, for tracks in both.

    Attributes:
        posterior: of the slot.
        covariance: `(num_tracks, size, size)` of whole bodies.
        now: `(num_shared,)` rows of those who are in the next slot, too.
        then: `(num_shared,)` their rows there.
        expected: of the next slot; None where nobody is in both.
    """

    posterior: Posterior
    covariance: Floats
    now: Integers
    then: Integers
    expected: Expected | None


def _linked(tree: Tree, posterior: Posterior, later: Posterior | None) -> _Link:
    covariance = written_out(tree, posterior.covariance, posterior.shared)
    none = np.zeros(0, dtype=np.int64)
    if later is None or later.time_s <= posterior.time_s:
        return _Link(posterior, covariance, none, none, None)
    _, now, then = np.intersect1d(
        posterior.tracks, later.tracks, assume_unique=True, return_indices=True
    )
    if len(now) == 0:
        return _Link(posterior, covariance, none, none, None)
    dt = later.time_s - posterior.time_s
    state, share = posterior.state[now], np.ones((len(now), len(tree.parents)))
    if later.start.time_s == posterior.time_s:  # no slot between them was left out
        rows = np.searchsorted(later.start.tracks, posterior.tracks[now])
        state, share = later.start.state[rows], later.start.drift_share[rows]
    move, noise = body_transition(tree, dt, share)
    across = covariance[now] @ move.T
    mean = _columns(places(tree, state, dt))
    expected = expect(mean, move @ across + noise, across)
    return _Link(posterior, covariance, now, then, expected)


def _taken_back(link: _Link, later: Smoothed | None) -> Smoothed:
    posterior = link.posterior
    mean = _columns(posterior.state)
    covariance = link.covariance.copy()
    bones_m, counts = posterior.bones_m.copy(), posterior.bone_counts.copy()
    if later is not None and link.expected is not None:
        now, then = link.now, link.then
        mean[now], covariance[now] = step_back(
            mean[now], covariance[now], link.expected, later.mean[then], later.covariance[then]
        )
        bones_m[now], counts[now] = later.bones_m[then], later.bone_counts[then]
    return Smoothed(posterior, mean, covariance, bones_m, counts)


def _columns(state: Floats) -> Floats:
    return np.array(state.reshape(len(state), state.shape[1] * state.shape[2], 1))
