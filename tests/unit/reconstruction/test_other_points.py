"""Points that are not swept: where they lie, their light, and how many there are."""

import numpy as np
import pytest

from reconstruction.errors import StereoError
from reconstruction.images.background import Background
from reconstruction.images.composite import CompositeSource
from reconstruction.initialization.geometry import Geometry
from reconstruction.initialization.sweep import depth_range_m
from reconstruction.pipeline.other_points import Found, FoundPoints, RandomPoints
from rigs.toml import catalog_rig

RIG = catalog_rig("lab3x3").scaled(40, 25)
CAMERAS = RIG.cameras[:4]
PLANE, COUNT = 7, 60
MOVER = np.zeros((25, 40), bool)
MOVER[10:16, 15:25] = True


class Shown(CompositeSource):
    """A source with a background of 0.2 and a mover of 0.5, in the same pixels of every view."""

    def __init__(self, mover=MOVER):
        shape = (25, 40)
        trusted = np.ones(shape, bool)
        trusted[:2] = False
        still = Background(np.full(shape, 0.2, np.float32), trusted, np.zeros(shape, bool))
        for name, value in {"background": still, "mover": mover}.items():
            object.__setattr__(self, name, value)

    def at(self, plane):
        return np.where(self.mover, np.float32(0.5), np.float32(0.2))

    def movers(self, image, plane):
        return self.mover


VIEWS = {camera.id: (camera, Shown()) for camera in CAMERAS}


def rng():
    return np.random.default_rng(3)


def seen_through(pixels, depth_m=2.0):
    """Points that the first camera sees at these places [N, 2]."""
    camera = CAMERAS[0]
    rays = np.concatenate([camera.slopes(np.asarray(pixels, float)), np.ones((len(pixels), 1))], axis=1)
    return camera.cam_from_rig.inverse().apply(rays * depth_m)


def found(points, plane: int | None = PLANE):
    confidence = np.ones(len(points), np.float32)
    return FoundPoints(Found.of(Geometry(RIG, points, confidence, plane=plane)), rng())


STILL_PX, MOVING_PX = [(5.5, 5.5), (30.5, 20.5), (8.5, 20.5)], [(20.5, 13.5), (19.5, 12.5)]


def alone(mover=MOVER):
    return {CAMERAS[0].id: (CAMERAS[0], Shown(mover))}


def test_random_points_lie_behind_known_pixels_as_deep_as_a_sweep_looks():
    points = RandomPoints(rng()).still(VIEWS, COUNT)
    assert len(points) == COUNT
    assert points.intensities == pytest.approx(0.2)
    near_m, far_m = depth_range_m(CAMERAS)
    depths = np.stack([camera.cam_from_rig.apply(points.positions)[:, 2] for camera in CAMERAS])
    assert np.all((depths > 0.9 * near_m) & (depths < 1.1 * far_m), axis=1).any()
    movers = RandomPoints(rng()).movers(VIEWS, (PLANE, 0.25), COUNT)
    assert len(movers) == COUNT
    assert movers.intensities == pytest.approx(0.5)
    assert set(movers.instants_s) == {0.25}
    assert len(RandomPoints(rng()).movers(alone(np.zeros_like(MOVER)), (PLANE, 0.25), COUNT)) == 0
    again = RandomPoints(rng()).still(VIEWS, COUNT)
    np.testing.assert_array_equal(again.positions, points.positions)


def test_found_points_are_still_or_movers_as_the_views_see_them():
    points = found(seen_through(STILL_PX + MOVING_PX))
    still = points.still(alone(), 3)
    np.testing.assert_allclose(np.sort(still.positions, axis=0), np.sort(seen_through(STILL_PX), axis=0), atol=1e-9)
    assert still.intensities == pytest.approx(0.2)
    movers = points.movers(alone(), (PLANE, 0.5), 2)
    assert movers is not None
    np.testing.assert_allclose(np.sort(movers.positions, axis=0), np.sort(seen_through(MOVING_PX), axis=0), atol=1e-9)
    assert movers.intensities == pytest.approx(0.5)
    assert set(movers.instants_s) == {0.5}


def test_movers_that_were_seen_at_another_plane_or_at_none_are_swept():
    assert found(seen_through(MOVING_PX)).movers(alone(), (PLANE + 1, 0.5), 2) is None
    without = found(seen_through(STILL_PX + MOVING_PX), plane=None)
    assert without.movers(alone(), (PLANE, 0.5), 2) is None
    assert len(without.still(alone(), 5)) == 5  # a long image has shown them, so they stand still
    none = found(seen_through(STILL_PX)).movers(alone(), (PLANE, 0.5), 2)
    assert none is not None
    assert len(none) == 0


@pytest.mark.parametrize("count", [1, 2, 3, 200])
def test_too_many_are_drawn_from_and_too_few_filled_up_around_them(count):
    own = seen_through(STILL_PX)
    points = found(own).still(alone(), count)
    assert len(points) == count
    assert np.isfinite(points.positions).all()
    nearest = np.linalg.norm(points.positions[:, None] - own, axis=2).min(axis=1)
    assert np.all(nearest[:3] < 1e-9)
    assert np.all(nearest < 5 * np.linalg.norm(own[0] - own[1]))
    assert np.all(points.spacing > 0)


def test_one_point_and_points_out_of_sight():
    assert len(found(seen_through(STILL_PX[:1])).still(alone(), 4)) == 4
    behind = found(np.array([[0.0, 0.0, -50.0], [1e6, 0.0, 1.0]]))
    with pytest.raises(StereoError, match="found no point in the views"):
        behind.still(alone(), 4)
    with pytest.raises(StereoError, match="found no point"):
        found(np.zeros((0, 3))).still(VIEWS, 4)
