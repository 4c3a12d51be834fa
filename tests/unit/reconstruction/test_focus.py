"""Images of some pixels alone: the same values there as in the whole image, and zero elsewhere."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import method, method_for
from reconstruction.images.mending import mended


def stream(height: int, width: int, *, rate: float = 0.3, planes: int = 40, **layout: int) -> SpikeStream:
    spikes = np.random.default_rng(0).random((planes, height, width)) < rate
    where = PlaneLayout(width, height, **layout)
    return SpikeStream(pack(spikes, where), where, 20_000.0)


@pytest.mark.parametrize("rate", [0.0, 0.02, 0.4, 1.0])
@pytest.mark.parametrize("plane", [0, 3, 20, 39])
def test_wanted_pixels_and_their_neighbours_are_those_of_the_whole_image(rate: float, plane: int):
    seen = stream(7, 13, rate=rate)
    pixels = np.zeros((7, 13), bool)
    pixels[2:4, 3:9] = pixels[6, 12] = True
    whole, part = method("interpolated")(seen, plane), method_for("interpolated", seen.layout, pixels)(seen, plane)
    near = np.zeros_like(pixels)
    near[1:5, 2:10] = near[5:7, 11:13] = True
    for name in ("intensity", "valid", "sigma"):
        expected, found = getattr(whole, name), getattr(part, name)
        np.testing.assert_array_equal(found[near], expected[near])
        assert found.dtype == expected.dtype
        assert not found[~near].any()


def test_columns_behind_the_pixels_do_not_count():
    seen = stream(5, 10, trailing_columns=6)
    pixels = np.eye(5, 10, dtype=bool)
    whole, part = method("interpolated")(seen, 20), method_for("interpolated", seen.layout, pixels)(seen, 20)
    np.testing.assert_array_equal(part.intensity[pixels], whole.intensity[pixels])


@pytest.mark.parametrize("every", [False, True])
def test_no_pixel_and_all_pixels(every: bool):
    seen = stream(6, 9)
    part = method_for("interpolated", seen.layout, np.full((6, 9), every))(seen, 20)
    np.testing.assert_array_equal(part.intensity, method("interpolated")(seen, 20).intensity * every)


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.8))
def test_bad_pixels_take_the_median_of_their_neighbours(seed: int, share: float):
    rng = np.random.default_rng(seed)
    image, bad = rng.random((9, 11), dtype=np.float32), rng.random((9, 11)) < share
    found, known = mended(image, bad), np.pad(np.where(bad, np.nan, image), 1, constant_values=np.nan)
    for row, column in np.argwhere(bad):
        around = known[row : row + 3, column : column + 3]
        if np.isfinite(around).any() and not bad.all():
            assert found[row, column] == np.nanmedian(around)
