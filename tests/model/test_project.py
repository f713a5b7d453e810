"""The compiled projection against `Rig.project`, with all kinds of lenses."""

from __future__ import annotations

import numpy as np
from tests.cases import each_case
from tests.model.test_undistort import LENSES, camera

from e3pose.model.camera import Rig
from e3pose.model.project import make_optics, project_people

FAR_PX = 1e6  # beyond it digits differ, and nothing is in view


@each_case("lens", sorted(LENSES))
def test_people_are_where_the_rig_projects_them(lens: str) -> None:
    rng = np.random.default_rng(3)
    rig = Rig((camera(lens),))
    points_m = rng.normal(scale=(1.5, 1.5, 3.0), size=(40, 17, 3))
    points_m[rng.random(points_m.shape[:2]) < 0.1] = np.nan
    points_m[0, 0] = 0.0
    points_m[0, 1] = [0.0, 0.0, 2.0]
    found, expected = np.empty((40, 17, 2)), rig.project(points_m)[0]
    project_people(0, make_optics(rig), points_m, found)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    near = np.abs(expected).max(axis=-1) < FAR_PX
    assert near.any() or lens == "enormous"
    np.testing.assert_allclose(found[near], expected[near], rtol=1e-9, atol=1e-9)
