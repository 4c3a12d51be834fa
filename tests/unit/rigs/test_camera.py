import numpy as np

from rigs.camera import Camera
from rigs.transform import Transform

CAMERA = Camera("cam00", 40, 32, 50.0, 60.0, 20.0, 16.0, Transform.identity())


def test_points_are_where_the_calibration_matrix_puts_them():
    turned = Transform.looking_at(np.array([0.3, -0.2, -1.0]), np.array([0.0, 0.1, 2.0]))
    camera = Camera("cam00", 40, 32, 50.0, 60.0, 20.0, 16.0, turned)
    points = np.random.default_rng(0).normal(size=(50, 3)) * 0.4 + (0, 0, 2)
    pixels, inside = camera.project(points)
    expected = turned.apply(points) @ camera.K.T
    assert np.allclose(pixels, expected[:, :2] / expected[:, 2:])
    assert 5 < inside.sum() <= 50
    assert np.array_equal(inside, ((pixels >= 0) & (pixels < (40, 32))).all(axis=1))


def test_what_is_not_in_front_or_not_a_number_is_nowhere():
    points = np.array([[0, 0, 0], [0, 0, -1.0], [np.nan, 0, 1], [0, 0, np.nan], [np.inf, 0, 1], [0, 0, np.inf]])
    with np.errstate(invalid="ignore"):
        pixels, inside = CAMERA.project(points)
    assert inside.tolist() == [False] * 6
    assert np.isnan(pixels[:2]).all()


def test_edges_and_no_points():
    z = 1.0
    corner = np.array([[-20.0 / 50, -16.0 / 60, z], [20.0 / 50, 0, z], [0, 16.0 / 60, z]])
    assert CAMERA.project(corner)[1].tolist() == [True, False, False]
    pixels, inside = CAMERA.project(np.empty((0, 3)))
    assert pixels.shape == (0, 2)
    assert inside.shape == (0,)
