"""Depth for pixels without one."""

import numpy as np
import pytest

from reconstruction.initialization.sweep import DepthMap, filled
from rigs.toml import catalog_rig

CAMERA = catalog_rig("ci3x3").cameras[0].scaled(9, 5)


def depth_map(depth):
    return DepthMap(CAMERA, np.asarray(depth, np.float32), np.zeros((5, 9), np.float32))


def test_an_unknown_depth_is_that_of_the_nearest_known_pixel():
    depth = np.full((5, 9), np.nan)
    depth[2, 1], depth[2, 7] = 1.5, 3.0
    whole = filled(depth_map(depth)).depth
    assert (whole[:, :4] == 1.5).all()
    assert (whole[:, 5:] == 3.0).all()


def test_known_depths_stay_as_they_are():
    depth = np.random.default_rng(0).uniform(1, 3, (5, 9)).astype(np.float32)
    holes = np.random.default_rng(1).random((5, 9)) < 0.5
    whole = filled(depth_map(np.where(holes, np.nan, depth))).depth
    np.testing.assert_array_equal(whole[~holes], depth[~holes])
    assert np.isin(whole[holes], depth[~holes]).all()


@pytest.mark.parametrize("value", [np.nan, 2.0])
def test_all_or_nothing_known_is_left_alone(value):
    given = depth_map(np.full((5, 9), value))
    assert filled(given) is given


@pytest.mark.parametrize("bad", [np.inf, -np.inf])
def test_an_infinite_depth_is_unknown(bad):
    depth = np.full((5, 9), 2.0)
    depth[0, 0] = bad
    assert (filled(depth_map(depth)).depth == 2.0).all()
