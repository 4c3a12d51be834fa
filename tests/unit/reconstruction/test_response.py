"""Pixels that answer light unlike one another, and pixels that fail on the way, leave images and counts alone."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from references.changes import failing_pixels_reference

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from acquisition.spikes.traits import Traits
from reconstruction.images.background import background, moving_pixels
from reconstruction.images.catalogue import method
from reconstruction.images.composite import CompositeSource
from reconstruction.images.failures import failing_pixels
from reconstruction.images.flicker import Light
from reconstruction.images.mending import mended
from reconstruction.images.pixels import PixelCalibration
from reconstruction.images.response import NEVER, Response

WIDTH, HEIGHT, PLANES = 90, 61, 400
LAYOUT = PlaneLayout(WIDTH, HEIGHT)
STEADY = Light.steady(PLANES)
STRONG = Traits(pixel_spread=0.1, warmer_k=50)


def light_with_mover() -> np.ndarray:
    """A rough picture, [T, H, W], before which a rough bar goes to and fro, four pixels wide."""
    rng = np.random.default_rng(5)
    still = rng.uniform(0.05, 0.7, (HEIGHT, WIDTH)).astype(np.float32)
    bar = rng.uniform(0.05, 0.7, (HEIGHT, 8)).astype(np.float32)
    light = np.repeat(still[None], PLANES, axis=0)
    for t in range(PLANES):
        left = round(20 + 15 * np.sin(t / 40))
        light[t, 10:50, left : left + 8] = bar[10:50]
    return light


LIGHT = light_with_mover()


def recorded(traits: Traits, light: np.ndarray = LIGHT) -> tuple[SpikeStream, Sensor]:
    sensor = Sensor(light.shape[2], light.shape[1], "real", 5, 0, traits=traits)
    start = Sensor(light.shape[2], light.shape[1], "real", 5, 0, traits=traits)
    return SpikeStream(pack(sensor.expose(light), PlaneLayout(light.shape[2], light.shape[1])), LAYOUT, 2e4), start


def known(sensor: Sensor) -> Response:
    gain, dark = sensor.response
    bad = (gain < 0.2) | (dark > 0.15)
    return Response.calibrated(PixelCalibration(np.where(bad, 1, gain), dark, bad, np.zeros_like(bad)))


def source(stream: SpikeStream, response: Response | None) -> CompositeSource:
    moving = moving_pixels(stream, STEADY)
    still = background(stream, moving, STEADY, response)
    return CompositeSource(stream, still, moving, method("interpolated"), STEADY, response=response)


def test_maps_bring_background_images_and_counts_back():
    stream, sensor = recorded(STRONG)
    plain, cured = source(stream, None), source(stream, known(sensor))
    still = ~plain.moving
    assert still.mean() > 0.3
    errors = [np.abs(s.background.image - LIGHT[0])[still].mean() for s in (plain, cured)]
    assert errors[0] > 0.04  # offsets and gains
    assert errors[1] < 0.003
    # what moves, in short images and in counts
    window, moving = (200, 209), plain.moving & ~cured.useless(PLANES)
    truth = LIGHT[slice(*window)].mean(axis=0)
    errors = [np.abs(s.at(204) - truth)[moving].mean() for s in (plain, cured)]
    assert errors[1] < 0.4 * errors[0]
    errors = [np.abs(s.counts(200, 264) - LIGHT[200:264].sum(axis=0))[moving].mean() for s in (plain, cured)]
    assert errors[1] < 0.5 < errors[0] / 4


def test_a_response_and_its_inverse_agree():
    rng = np.random.default_rng(0)
    gain, offset = rng.uniform(0.5, 2, (7, 9)).astype(np.float32), rng.uniform(0, 0.1, (7, 9)).astype(np.float32)
    response = Response(gain, offset, np.full((7, 9), NEVER, np.int32))
    light = rng.uniform(0, 1, (7, 9)).astype(np.float32)
    np.testing.assert_allclose(response.light(response.seen(light)), light, atol=1e-6)
    assert (response.light(np.zeros((7, 9), np.float32)) == 0).all()
    even = Response.even((7, 9))
    assert even.light(light) is light
    np.testing.assert_allclose(response.times(2.0).light(light), response.light(light * 0.5 + offset / 2), atol=1e-6)


@pytest.mark.parametrize("gain", [0.0, 1e-30, 0.05, 1e30])
def test_maps_with_impossible_gains_leave_those_pixels_out(gain):
    maps = PixelCalibration(np.ones((5, 6), np.float32), np.zeros((5, 6), np.float32), *np.zeros((2, 5, 6), bool))
    broken = maps.gain.copy()
    broken[2, 3] = gain
    object.__setattr__(maps, "gain", broken)  # as a damaged file has it
    response = Response.calibrated(maps)
    assert response.useless(1)[2, 3]
    assert response.useless(1).sum() == 1
    light = response.mended(np.full((5, 6), 0.4, np.float32), 1)
    np.testing.assert_allclose(light, 0.4)


def test_pixels_that_fail_are_found_and_no_others():
    traits = Traits(failing=0.05)
    stream, sensor = recorded(traits)
    fails = failing_pixels(stream, STEADY)
    true = np.full(sensor.shape, NEVER)
    true.flat[sensor.failures.pixels] = sensor.failures.ticks
    found = fails != NEVER
    assert (found & (true >= PLANES)).sum() <= 2  # of 5,490
    soon = true < PLANES - 100
    before = np.array([LIGHT[: max(1, t), y, x].mean() for y, x, t in zip(*np.nonzero(soon), true[soon], strict=True)])
    planes = stream.planes(0, PLANES)
    after = np.array([planes[t:, y, x].mean() for y, x, t in zip(*np.nonzero(soon), true[soon], strict=True)])
    grave = soon.copy()
    grave[soon] = np.abs(after - before) > 0.2
    assert grave.sum() > 40
    assert (found & grave).sum() > 0.8 * grave.sum()  # measured 0.89
    late = (fails - true)[found & (true < PLANES)]
    assert late.max() <= 5  # found to fail when they do, or a little before
    plain, _ = recorded(Traits())
    assert (failing_pixels(plain, STEADY) != NEVER).sum() <= 2


@pytest.mark.parametrize("flicker", [0.0, 0.3])
def test_failing_pixels_are_those_of_the_twin(flicker):
    rng, spans, length = np.random.default_rng(5), 16, PLANES // 16
    gains = 1 + flicker * np.sin(np.arange(PLANES))
    rates = rng.uniform(0.05, 0.5, (24, 40))
    light = rates * gains[:, None, None]
    for y, x in rng.integers(0, (24, 40), (150, 2)):  # lone failures, and some that go silent
        light[rng.integers(PLANES) :, y, x] = rng.choice([0.0, 0.9, rng.uniform(0, 1)])
    light[160:, 6:14, 8:20] = 0.6  # all of them at once: no failures
    light[:, 16:20] = rng.uniform(0.05, 0.9, (PLANES // 10, 4, 40)).repeat(10, axis=0)  # restless all along
    stream = SpikeStream(pack(rng.random(light.shape) < light, PlaneLayout(40, 24)), PlaneLayout(40, 24), 20000.0)
    steady = Light((gains / gains.mean()).astype(np.float32))
    counts = stream.window_counts([(i * length, (i + 1) * length) for i in range(spans)])
    over = np.array([steady.over(i * length, (i + 1) * length) for i in range(spans)], np.float32)
    found = failing_pixels(stream, steady)
    assert (found != NEVER).sum() > 3
    np.testing.assert_array_equal(found, failing_pixels_reference(counts, over, length))


def test_what_failed_is_read_no_more_and_what_came_before_still_is():
    stream, sensor = recorded(Traits(failing=0.1))
    true = np.full(sensor.shape, NEVER, np.int32)
    true.flat[sensor.failures.pixels] = np.minimum(sensor.failures.ticks, NEVER)
    response = Response.even(true.shape).failing(true)
    plain, cured = source(stream, None), source(stream, response)
    failed = (true < PLANES) & (true > 60) & ~plain.moving
    assert failed.sum() > 50
    errors = [np.abs(s.background.image - LIGHT[0])[failed].mean() for s in (plain, cured)]
    assert errors[0] > 0.1
    assert errors[1] < 0.015
    moving = plain.moving & (true < 300) & (true > 20)
    gaps = [np.abs(s.at(350) - LIGHT[346:355].mean(axis=0))[moving] for s in (plain, cured)]
    assert gaps[1].mean() < 0.9 * gaps[0].mean()  # rough neighbours stand in for it
    assert (cured.useless(301) & ~cured.useless(100) & moving).any()
    early = plain.moving & (true > 40)
    np.testing.assert_array_equal(cured.at(10)[early], plain.at(10)[early])


@pytest.mark.parametrize("planes", [1, 15, 31, 32, 40])
def test_short_recordings_have_no_failures_to_tell(planes):
    stream, _ = recorded(Traits(), LIGHT[:planes])
    assert (failing_pixels(stream, Light.steady(planes)) == NEVER).mean() > 0.99


@given(seed=st.integers(0, 1000), share=st.sampled_from([0.0, 0.02, 0.5, 0.98, 1.0]))
@settings(max_examples=40, deadline=None)
def test_mended_pixels_lie_between_good_ones_and_good_ones_stay(seed, share):
    rng = np.random.default_rng(seed)
    image, bad = rng.random((13, 9), dtype=np.float32), rng.random((13, 9)) < share
    broken = np.where(bad, np.float32(np.nan), image)
    found = mended(broken, bad)
    np.testing.assert_array_equal(found[~bad], image[~bad])
    if not bad.all():
        assert found.min() >= image[~bad].min()
        assert found.max() <= image[~bad].max()


def test_one_good_pixel_stands_for_all():
    bad = np.ones((6, 5), bool)
    bad[2, 1] = False
    image = np.arange(30, dtype=np.float32).reshape(6, 5)
    assert (mended(image, bad) == image[2, 1]).all()
    np.testing.assert_array_equal(mended(image, np.ones((6, 5), bool)), image)
    response = Response.calibrated(
        PixelCalibration(np.ones((6, 5), np.float32), np.zeros((6, 5), np.float32), bad, np.zeros_like(bad))
    )
    assert (response.mended(image, 1) == image[2, 1]).all()
    assert (replace(response, fails=np.zeros((6, 5), np.int32)).mended(image, 1) == image).all()
