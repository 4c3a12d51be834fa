"""Lenses against OpenCV, against their own inverse, and at their folds."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from rigs.camera import Camera
from rigs.errors import RigError
from rigs.lens import MOST, Lens
from rigs.transform import Transform

CAMERA = Camera("cam00", 400, 250, 350.0, 340.0, 205.0, 121.0, Transform.identity())
LENSES = {
    "barrel": ("opencv", (-0.25, 0.06, 0.0, 0.0)),
    "pincushion": ("opencv", (0.3, -0.1, 0.0, 0.0)),
    "tangential": ("opencv", (-0.2, 0.05, 0.004, -0.003)),
    "five": ("opencv", (-0.3, 0.15, 0.001, 0.002, -0.04)),
    "fisheye": ("fisheye", (-0.02, 0.01, -0.004, 0.001)),
    "equidistant": ("fisheye", (0.0, 0.0, 0.0, 0.0)),
    "tiny": ("opencv", (1e-300, -1e-200, 1e-250, 0.0, 1e-308)),
}


def bent_by_opencv(lens: Lens, slopes: np.ndarray) -> np.ndarray:
    points = np.column_stack([slopes, np.ones(len(slopes))])[:, None]
    k, none = np.array(lens.coefficients), np.zeros(3)
    if lens.model == "fisheye":
        return cv2.fisheye.projectPoints(points, none, none, np.eye(3), k)[0][:, 0]
    return cv2.projectPoints(points, none, none, np.eye(3), k)[0][:, 0]


def over_the_picture() -> np.ndarray:
    across, down = np.meshgrid(np.linspace(-0.7, 0.7, 41), np.linspace(-0.45, 0.45, 27))
    return np.stack([across.ravel(), down.ravel()], axis=1)


@pytest.mark.parametrize("name", LENSES)
def test_lenses_bend_as_opencv_does_and_straighten_what_they_bent(name):
    lens, slopes = Lens(*LENSES[name]), over_the_picture()
    bent = lens.bent(slopes)
    np.testing.assert_allclose(bent, bent_by_opencv(lens, slopes), rtol=0, atol=1e-14)
    np.testing.assert_allclose(lens.straightened(bent), slopes, rtol=0, atol=1e-12)
    camera = replace(CAMERA, lens_model=lens.model, distortion=lens.coefficients)
    pixels, inside = camera.project(np.column_stack([slopes, np.ones(len(slopes))]) * 3.0)
    np.testing.assert_allclose(pixels, bent * (350.0, 340.0) + (205.0, 121.0), atol=1e-10)
    assert 0.3 < inside.mean() <= 1
    np.testing.assert_allclose(camera.slopes(pixels), slopes, rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", LENSES)
def test_the_derivative_is_that_of_the_bend(name):
    lens, slopes, step = Lens(*LENSES[name]), over_the_picture(), 1e-6
    _, derivative = lens._bent(slopes)
    for axis in (0, 1):
        nudge = np.eye(2)[axis] * step
        wanted = (lens._bent(slopes + nudge)[0] - lens._bent(slopes - nudge)[0]) / (2 * step)
        np.testing.assert_allclose(derivative[:, :, axis], wanted, atol=1e-8)


def test_what_lies_beyond_the_fold_is_neither_seen_nor_looked_at():
    lens = Lens("opencv", (-0.5, 0.0, 0.0, 0.0))
    fold = math.sqrt(1 / 1.5)  # where 1 - 1.5 r^2 is zero
    assert lens.fold == pytest.approx(fold, rel=1e-14)
    most = fold * (1 - 0.5 * fold**2)
    slopes = np.array(
        [[fold * 0.999999, 0], [fold * 1.000001, 0], [2 * fold, 0], [1.2, 0]]
    )  # the last two come back into view
    # The last two would come back into view.
    assert np.isfinite(lens.bent(slopes)).all(axis=1).tolist() == [True, False, False, False]
    places = np.array([[0.0, most * (1 - 1e-9)], [0.0, most * (1 + 1e-9)], [5.0, 0.0]])
    found = lens.straightened(places)
    assert found[0, 1] == pytest.approx(fold, rel=1e-4)
    assert found[0, 1] < fold
    assert np.isnan(found[1:]).all()
    pixels, inside = replace(CAMERA, distortion=lens.coefficients).project(np.array([[1.2, 0.0, 1.0], [0.1, 0.0, 1.0]]))
    assert np.isnan(pixels[0]).all()
    assert inside.tolist() == [False, True]


def test_a_fisheye_sees_less_than_half_of_the_world():
    lens = Lens("fisheye", (0.0,) * 4)
    places = np.array([[1.0, 0.0], [math.pi / 2 + 1e-3, 0.0]])  # angles in rad
    slopes = lens.straightened(places)
    assert slopes[0, 0] == pytest.approx(math.tan(1.0))
    assert np.isnan(slopes[1]).all()
    assert Lens("fisheye", (-0.5, 0, 0, 0)).fold == pytest.approx(math.sqrt(1 / 1.5))


@pytest.mark.parametrize("k", [1e-12, 1.0, 1e4, MOST])
def test_huge_and_tiny_coefficients_still_have_an_inverse(k):
    radius = np.geomspace(1e-12, 1.0, 60)
    for lens in (Lens("opencv", (k, 0, 0, 0)), Lens("opencv", (0, 0, 0, 0, k)), Lens("fisheye", (k, 0, 0, 0))):
        slopes = np.stack([radius * 0.8, radius * 0.6], axis=1)
        np.testing.assert_allclose(lens.straightened(lens.bent(slopes)), slopes, rtol=1e-9)
    folds = Lens("opencv", (-k, 0, 0, 0)).fold
    assert folds == pytest.approx(min(100.0, 1 / math.sqrt(3 * k)), rel=1e-9)


def test_the_centre_and_nothing_and_no_number():
    for lens in (Lens(*LENSES["tangential"]), Lens(*LENSES["fisheye"])):
        assert lens.bent(np.zeros((1, 2))).tolist() == [[0, 0]]
        assert lens.straightened(np.zeros((1, 2))).tolist() == [[0, 0]]
        assert lens.straightened(np.zeros((0, 2))).shape == lens.bent(np.zeros((0, 2))).shape == (0, 2)
        assert np.isnan(lens.straightened(np.array([[np.nan, 0.0]]))).all()
        assert np.isnan(lens.bent(np.array([[np.inf, 0.0], [np.nan, 1.0]]))).all()


def test_a_pinhole_is_untouched_by_its_lens():
    points = np.random.default_rng(0).normal(size=(50, 3)) * 0.4 + (0, 0, 2)
    pixels, _ = CAMERA.project(points)
    x, y, z = points.T
    np.testing.assert_array_equal(pixels, np.stack([350.0 * x / z + 205.0, 340.0 * y / z + 121.0], axis=1))
    assert not CAMERA.bends
    assert CAMERA.pinhole() is CAMERA
    assert replace(CAMERA, lens_model="fisheye").bends  # with zeros, too


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"distortion": (0.1, 0.2, 0.3)}, "found 3 numbers of distortion, expected k1 k2 p1 p2 k3"),
        ({"distortion": (0.1,) * 5, "lens_model": "fisheye"}, "found 5 numbers of distortion, expected k1 k2 k3 k4"),
        ({"distortion": (0.0, 0.0, 0.0, 2e9)}, "found distortion of 2e\\+09, expected at most 1e\\+09"),
        ({"lens_model": "thin"}, "found the lens model 'thin', expected one of opencv, fisheye"),
    ],
)
def test_what_no_lens_can_have_is_refused_with_the_camera(changes, words):
    with pytest.raises(RigError, match=f"cam00: {words}"):
        replace(CAMERA, **changes)
