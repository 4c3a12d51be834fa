import numpy as np
import pytest
from references.changes import changed_windows_reference

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.background import _changed_windows, background, moving_pixels
from reconstruction.images.failures import failing_pixels
from reconstruction.images.flicker import BLOCK_PX, DARK, FLICKER, WINDOW, Light, estimate_light, spikes_of_blocks
from reconstruction.images.response import NEVER

WIDTH, HEIGHT, PLANES = 96, 64, 400
SIZES = [(96, 64, 0), (40, 67, 0), (40, 64, 8), (50, 31, 0), (7, 5, 1)]


def recorded(gains, camera=0, mover=False):
    """Record an uneven wall and a block that crosses it, under light of these gains, with a real sensor."""
    rng = np.random.default_rng(camera)
    wall = rng.uniform(0.1, 0.4, (HEIGHT, WIDTH)).astype(np.float32)
    light = wall[None] * np.asarray(gains, dtype=np.float32)[:, None, None]
    if mover:
        for plane in range(len(gains)):
            left = plane * (WIDTH - 30) // len(gains)
            light[plane, 10:50, left : left + 30] = 0.6 * gains[plane]
    layout = PlaneLayout(WIDTH, HEIGHT)
    return SpikeStream(pack(Sensor(WIDTH, HEIGHT, "real", 1, camera).expose(light), layout), layout, 20000.0)


def mains(depth=0.4):
    phase = 2 * np.pi * 100 * np.arange(PLANES) / 20000.0
    gains = 1 + depth * np.cos(phase + 0.7)
    return gains / gains.mean()


@pytest.mark.parametrize("mover", [False, True])
def test_mains_flicker_is_measured_to_a_percent_movers_or_not(mover):
    light = estimate_light([recorded(mains(), camera, mover) for camera in range(3)])
    assert light.flickers
    gaps = np.abs(light.gains - mains())
    assert gaps.mean() < 0.01  # 0.003 without a mover, 0.0084 with one
    assert gaps.max() < (0.05 if mover else 0.02)  # 0.043 in the last planes, behind the last whole window
    assert float(light.gains.mean()) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("planes", [120, 200, 400])
def test_a_few_spikes_do_not_flicker(planes):
    """A dim wall, of which a few blocks alone have spikes enough, by noise or by a hot pixel."""
    layout = PlaneLayout(WIDTH, HEIGHT)
    light = np.full((planes, HEIGHT, WIDTH), 0.004, dtype=np.float32)
    for seed in range(4):
        light[:, 8 * seed : 8 * seed + 8, 16:24] = 0.018
        streams = [
            SpikeStream(pack(Sensor(WIDTH, HEIGHT, "real", seed, c).expose(light), layout), layout, 20000.0)
            for c in range(3)
        ]
        assert not estimate_light(streams).flickers, seed


@pytest.mark.parametrize("mover", [False, True])
def test_steady_light_is_called_steady(mover):
    light = estimate_light([recorded(np.ones(PLANES), camera, mover) for camera in range(3)])
    assert not light.flickers
    assert (light.gains == 1).all()


@pytest.mark.parametrize("row_order", ["bottom", "top"])
@pytest.mark.parametrize("bit_order", ["lsb", "msb"])
@pytest.mark.parametrize(
    ("width", "height", "trailing"), [(96, 64, 0), (40, 67, 0), (40, 64, 8), (50, 31, 0), (7, 5, 1)]
)
def test_spikes_of_blocks_are_the_sums_of_their_pixels(width, height, trailing, bit_order, row_order):
    layout = PlaneLayout(width, height, bit_order, row_order, trailing)
    planes = np.random.default_rng(0).random((12, height, width)) < 0.4
    planes[4:8] = True
    found = spikes_of_blocks(SpikeStream(pack(planes, layout), layout, 20000.0), range(0, 12, WINDOW))
    down, across = max(1, height // BLOCK_PX), max(1, width // BLOCK_PX)
    block = np.add.outer(np.arange(height) * 0, np.arange(width) * 0)
    for row in range(down):
        for column in range(across):
            rows = slice(row * height // down, (row + 1) * height // down)
            block[rows, column * width // across : (column + 1) * width // across] = row * across + column
    wanted = [np.bincount(block.ravel(), planes[s : s + WINDOW].sum(axis=0).ravel()) for s in (0, 4, 8)]
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("windows", [1, 4, 16])
@pytest.mark.parametrize("pixels", [1, 511, 512, 1300])
def test_changes_of_counts_are_those_of_the_twin(windows, pixels):
    rng = np.random.default_rng(pixels)
    counts = rng.poisson(rng.uniform(0, 300, pixels), (windows, pixels)).astype(np.uint32)
    counts[:, 0] = np.iinfo(np.uint32).max
    gains = rng.uniform(0.5, 1.5, windows)
    seen = np.zeros(pixels, np.uint8)
    seen[-1] = 1  # as it was found before
    _changed_windows(counts, windows, pixels, gains, 3.0, 0.05, seen)
    wanted = changed_windows_reference(counts.reshape(windows, 1, pixels), gains, 3.0, 0.05)[0]
    wanted[-1] = True
    np.testing.assert_array_equal(seen, wanted)


def test_a_still_wall_under_flicker_does_not_move_and_keeps_its_mean_light():
    stream = recorded(mains())
    light = estimate_light([stream])
    moving = moving_pixels(stream, light)
    assert moving.mean() < 0.02
    assert moving_pixels(stream, Light.steady(PLANES)).mean() > 0.9
    steady = recorded(np.ones(PLANES))
    gap = background(stream, moving, light).image - background(steady, moving, Light.steady(PLANES)).image
    assert np.abs(gap).mean() < 0.005


@pytest.mark.parametrize("planes", [1, 7])
def test_a_clip_too_short_to_tell_is_steady(planes):
    assert not estimate_light([recorded(np.ones(planes))]).flickers


def test_darkness_is_steady():
    layout = PlaneLayout(16, 16)
    dark = SpikeStream(pack(np.zeros((64, 16, 16), np.uint8), layout), layout, 20000.0)
    assert not estimate_light([dark]).flickers


def test_what_flickers_less_than_the_threshold_is_left_out():
    assert not Light(np.array([1 - FLICKER / 2, 1 + FLICKER / 2], dtype=np.float32)).flickers


def streams_with(dark, cameras=3):
    """Cameras under steady light that see nothing in the planes [first, last) of `dark`, by number."""
    gains = np.ones((cameras, PLANES))
    for camera, window in dark.items():
        gains[camera, slice(*window)] = 0
    return [recorded(own, camera) for camera, own in enumerate(gains)]


@pytest.mark.parametrize("dark", [{1: (100, 300)}, {0: (0, 200), 1: (0, 200)}, {2: (0, 399)}, {0: (0, 400)}])
def test_a_camera_that_is_lost_is_not_light_that_went_out(dark):
    assert not estimate_light(streams_with(dark)).flickers


@pytest.mark.parametrize(("first", "last"), [(100, 200), (0, 100), (300, 400), (40, 360)])
def test_light_that_went_out_is_dark(first, last):
    light = estimate_light(streams_with(dict.fromkeys(range(3), (first, last))))
    assert light.gains.mean() == pytest.approx(1, abs=1e-5)
    assert light.gains.min() >= 0
    usual = PLANES / (PLANES - (last - first))
    inner = np.zeros(PLANES, bool)
    inner[first + 4 : last - 4] = True
    outer = np.ones(PLANES, bool)
    outer[max(0, first - 4) : last + 4] = False
    assert light.gains[inner].max() < DARK
    np.testing.assert_allclose(light.gains[outer], usual, rtol=0.15)
    assert light.lit([(0, PLANES), (first + 10, last - 10)]) == [(0, PLANES)]


def test_nothing_is_seen_to_move_or_to_fail_in_the_dark():
    (stream, *others) = streams_with(dict.fromkeys(range(3), (100, 200)))
    light = estimate_light([stream, *others])
    with np.errstate(all="raise"):
        assert not moving_pixels(stream, light).any()
        assert (failing_pixels(stream, light) == NEVER).all()
        moving = np.zeros((HEIGHT, WIDTH), bool)
        moving[8:16, 8:16] = True
        found = background(stream, moving, light)
        part, own = stream.part(110, 190), Light(light.gains[110:190])
        assert not moving_pixels(part, own).any()
        assert (failing_pixels(part, own) == NEVER).all()
    lit = background(stream.part(200, 400), moving, Light.steady(200))
    shares = found.image / lit.image
    assert (np.abs(shares[~moving] / 0.75 - 1) < 0.1).mean() > 0.99  # a few pixels of the sensor are not like others
    assert np.median(shares[moving]) == pytest.approx(3 / 4, rel=0.1)  # single ones are of counts of a few spikes
    assert found.trusted.all()


def test_no_camera_that_sees_anything_is_steady_light():
    assert not estimate_light(streams_with(dict.fromkeys(range(3), (0, PLANES)))).flickers
