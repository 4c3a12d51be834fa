from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.images.background import background, moving_pixels
from reconstruction.images.catalogue import method
from reconstruction.images.composite import CompositeSource, GivenSource
from reconstruction.images.flicker import Light
from reconstruction.images.methods.tfi import tfi
from reconstruction.images.methods.tfp import tfp


def stream_of(planes):
    layout = PlaneLayout(planes.shape[2], planes.shape[1])
    return SpikeStream(pack(planes, layout), layout, 20000.0)


def periodic(period, planes=200, phase=0, height=5, width=7):
    spikes = np.zeros((planes, height, width), np.uint8)
    spikes[phase::period] = 1
    return spikes


@given(st.integers(1, 60), st.integers(0, 59))
def test_tfi_of_a_periodic_pixel_is_one_over_its_period(period, phase):
    estimate = tfi(stream_of(periodic(period, phase=phase % period)), 100)
    assert estimate.valid.all()
    assert np.array_equal(estimate.intensity, np.full((5, 7), np.float32(1 / period)))


@given(st.integers(1, 33))
def test_tfp_of_constant_light_is_its_rate_within_a_spike(period):
    image = tfp(stream_of(periodic(period)), 100).intensity
    assert np.abs(image - 1 / period).max() <= 1 / 33 + 1e-6


def test_tfi_of_a_silent_pixel_is_a_finite_bound_and_not_valid():
    estimate = tfi(stream_of(np.zeros((10, 3, 3), np.uint8)), 4)
    assert not estimate.valid.any()
    assert np.array_equal(estimate.intensity, np.full((3, 3), np.float32(1 / 11)))


def test_a_saturated_pixel_is_one_spike_per_tick():
    stream = stream_of(np.ones((40, 2, 3), np.uint8))
    assert (tfi(stream, 20).intensity == 1).all()
    assert (tfp(stream, 20).intensity == 1).all()


def test_unknown_methods_are_refused_with_the_known_ones():
    with pytest.raises(BadRunError, match="tfi, tfp"):
        method("crystal")


def steady(planes):
    return Light.steady(len(planes))


def test_constant_light_is_still_and_a_passing_block_moves():
    spikes = periodic(3, planes=240, height=40, width=40)
    spikes[60:90, 10:20, 10:20] = 1  # bright for 30 planes
    moving = moving_pixels(stream_of(spikes), steady(spikes))
    assert moving[10:20, 10:20].all()
    assert not moving[25:].any()
    assert not moving[:, 25:].any()


def test_slow_change_moves_though_no_short_window_shows_it():
    rng = np.random.default_rng(0)
    rate = np.linspace(0.30, 0.36, 400)[:, None, None]
    charge = np.cumsum(np.broadcast_to(rate, (400, 20, 20)), axis=0) + rng.random((20, 20))
    spikes = np.diff(np.floor(charge), axis=0, prepend=np.floor(charge[:1]))
    assert moving_pixels(stream_of(spikes), steady(spikes)).mean() > 0.9


@pytest.mark.parametrize("light", [0, 1])
def test_no_light_and_full_light_are_still(light):
    assert not moving_pixels(stream_of(np.full((64, 9, 9), light, np.uint8)), Light.steady(64)).any()


def test_a_clip_too_short_to_tell_is_still():
    assert not moving_pixels(stream_of(periodic(2, planes=3)), Light.steady(3)).any()


def blinking(planes=400):
    """Half rate everywhere; a 10 x 10 block is bright for a fifth of the clip."""
    spikes = periodic(2, planes=planes, height=24, width=24)
    spikes[planes // 5 : 2 * planes // 5, 7:17, 7:17] = 1
    return stream_of(spikes)


def source_of(stream):
    light = steady(stream)
    moving = moving_pixels(stream, light)
    return CompositeSource(stream, background(stream, moving, light), moving, tfp, light)


def test_composite_takes_the_clip_where_still_and_the_instant_where_moving():
    source = source_of(blinking())
    bright, later = source.at(120), source.at(300)
    assert (bright[8:16, 8:16] == 1).all()
    assert np.abs(later[8:16, 8:16] - 0.5).max() <= 1 / 33
    assert (bright[:3] == 0.5).all()


@pytest.mark.parametrize(("plane", "part"), [(0, (0, 5)), (2, (0, 7)), (4, (0, 9)), (30, (26, 9)), (399, (395, 5))])
def test_the_exposure_of_an_image_ends_with_the_clip(plane, part):
    assert source_of(blinking()).exposed(plane, 9) == part


@pytest.mark.parametrize(("planes", "part"), [(1, (0, 1)), (32, (-15.5, 32)), (99, (-49, 99))])
def test_the_exposure_of_a_given_image_does_not(planes, part):
    source = GivenSource.of(source_of(blinking()), {0: np.zeros((24, 24), np.float32)}, planes)
    assert source.exposed(0, planes) == part


def test_short_images_are_kept_as_long_as_there_is_room():
    source = source_of(blinking())
    each_bytes = 4 * int(source.moving.sum())
    small = replace(source, room_bytes=2 * each_bytes, kept={})
    for plane in (120, 300, 140):
        np.testing.assert_array_equal(small.at(plane), source.at(plane))
    assert (list(source.kept), list(small.kept)) == ([120, 300, 140], [300, 140])


def test_the_background_is_what_is_seen_most_of_the_time():
    found = source_of(blinking()).background
    assert np.abs(found.image - 0.5).max() < 0.03
    assert found.trusted.all()


def test_movers_are_marked_while_they_are_there():
    source = source_of(blinking())
    assert source.movers(source.at(120), 120)[8:16, 8:16].all()
    assert not source.movers(source.at(300), 300).any()
    assert not source.movers(source.at(120), 120)[:2].any()


@pytest.mark.parametrize("value", [0, 1])
def test_a_stuck_pixel_takes_its_neighbours_light(value):
    spikes = periodic(3, planes=240, height=9, width=9)
    spikes[:, 4, 4] = value
    stream = stream_of(spikes)
    found = background(stream, np.zeros((9, 9), bool), steady(stream))
    assert found.stuck[4, 4]
    assert found.stuck.sum() == 1
    assert found.image[4, 4] == pytest.approx(1 / 3)


@pytest.mark.parametrize("value", [0, 1])
def test_darkness_and_saturation_over_an_area_are_not_stuck(value):
    stream = stream_of(np.full((40, 6, 6), value, np.uint8))
    assert not background(stream, np.zeros((6, 6), bool), steady(stream)).stuck.any()
