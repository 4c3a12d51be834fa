"""An ordinary camera's frames: when they are exposed, and the noise and limits of their light."""

import math
from itertools import pairwise

import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.scenes.ordinary import Exposure, OrdinaryCamera

CAMERA = OrdinaryCamera()
WHITE = 0.6


def seeded() -> np.random.Generator:
    return np.random.default_rng(1)


def read(light: float, shape: tuple[int, int] = (300, 300)) -> np.ndarray:
    return CAMERA.read(np.full(shape, light, np.float32), WHITE, seeded())


@pytest.mark.parametrize(
    ("rate_hz", "ticks", "exposures"),
    [
        (20_000, 400, [(0, 99), (100, 99), (200, 99), (300, 99)]),
        (20_000, 99, [(0, 99)]),
        (20_000, 98, []),
        (20_000, 0, []),
        (40_000, 401, [(0, 199), (200, 199)]),
        (2000, 31, [(0, 9), (10, 9), (20, 9)]),
        (15_000, 160, [(0, 73), (75, 73)]),  # 75 ticks a frame: an even number is left
        (400, 9, [(0, 1), (2, 1), (4, 1), (6, 1), (8, 1)]),
        (300, 9, [(0, 1), (2, 1), (4, 1), (6, 1), (8, 1)]),
        (200, 9, []),
        (1, 9, []),
    ],
)
def test_exposures_follow_one_another_and_have_a_plane_in_their_middle(rate_hz, ticks, exposures):
    found = CAMERA.exposures(rate_hz, ticks)
    assert found == [Exposure(*each) for each in exposures]
    assert all(2 * each.middle == 2 * each.first + each.planes - 1 for each in found)


@pytest.mark.parametrize("light", [0.01, 0.1, 0.6])
def test_a_frame_is_unbiased_and_as_noisy_as_its_electrons(light):
    frame, electrons = read(light), light * CAMERA.white_share * CAMERA.full_well_e / WHITE
    step = CAMERA.full_well_e / (2**CAMERA.bits - 1)
    sd = math.sqrt(electrons + CAMERA.read_noise_e**2 + step**2 / 12) * light / electrons
    assert frame.dtype == np.float32
    assert frame.mean(dtype=np.float64) == pytest.approx(light, abs=4 * sd / 300)
    assert frame.std(dtype=np.float64) == pytest.approx(sd, rel=0.01)


def test_the_dark_is_unbiased_and_what_is_too_bright_saturates():
    dark, bright = read(0.0), read(1e6)
    assert dark.min() < 0
    assert abs(dark.mean(dtype=np.float64)) < 4 * dark.std() / 300
    most = WHITE / CAMERA.white_share
    assert bright.max() <= most
    assert bright.min() > 0.95 * most
    assert (read(-1.0) == dark).all()


def test_one_pixel_and_no_pixel_are_read():
    assert read(0.3, (1, 1)).shape == (1, 1)
    assert read(0.3, (0, 7)).shape == (0, 7)


@pytest.mark.parametrize(
    ("light", "white"), [(math.nan, 0.6), (math.inf, 0.6), (0.1, 0.0), (0.1, math.nan), (0.1, math.inf), (0.1, -1.0)]
)
def test_light_that_is_not_finite_is_refused(light, white):
    with pytest.raises(BadRecordingError, match="expected finite light above 0"):
        CAMERA.read(np.full((2, 2), light, np.float32), white, seeded())


def test_exposures_of_a_clip_without_end_are_counted_before_they_are_made():
    found = CAMERA.exposures(20_000.0, 10**20, 200)
    assert 100 <= len(found) <= 200
    assert found[0].first == 0
    assert len({b.first - a.first for a, b in pairwise(found)}) == 1
    few = CAMERA.exposures(20_000.0, 4_000)
    assert CAMERA.exposures(20_000.0, 4_000, 1_000) == few
