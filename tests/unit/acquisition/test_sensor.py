"""The integrate-and-fire sensor: exact when ideal, plausible when real, the same bytes however it is called."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.errors import BadRecordingError
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.sensor import SENSOR_KINDS, THERMAL_NOISE, THRESHOLD_SPREAD, Sensor
from acquisition.spikes.stream import SpikeStream


def constant(value: float, ticks: int, width: int = 20, height: int = 15) -> np.ndarray:
    return np.full((ticks, height, width), value, dtype=np.float32)


@pytest.mark.parametrize("kind", SENSOR_KINDS)
@given(
    width=st.integers(1, 40),
    height=st.integers(1, 9),
    ticks=st.integers(0, 30),
    seed=st.integers(0, 2**70),
    scale=st.sampled_from([1e-30, 0.5, 1.5, 1e30]),
)
@settings(max_examples=25, deadline=None)
def test_native_agrees_with_the_twin_bit_for_bit(kind, width, height, ticks, seed, scale):
    light = np.random.default_rng(1).normal(0.5, 0.5, (ticks, height, width)).astype(np.float32) * np.float32(scale)
    ours, twin = (Sensor(width, height, kind, seed, 3) for _ in range(2))
    np.testing.assert_array_equal(ours.expose(light), twin.expose_reference(light))
    np.testing.assert_array_equal(ours.expose(light), twin.expose_reference(light))


@pytest.mark.parametrize("kind", SENSOR_KINDS)
def test_neither_calls_nor_threads_change_a_byte(kind):
    light = np.random.default_rng(0).random((40, 61, 67), dtype=np.float32)
    whole = Sensor(67, 61, kind, 7, 2).expose(light)
    cut = Sensor(67, 61, kind, 7, 2, threads=3)
    np.testing.assert_array_equal(whole, np.concatenate([cut.expose(part) for part in np.split(light, [1, 9, 9, 32])]))


@pytest.mark.parametrize(("seed", "camera"), [(8, 2), (7, 3)])
def test_seeds_and_cameras_differ(seed, camera):
    light = constant(0.3, 10)
    assert (Sensor(20, 15, "ideal", 7, 2).expose(light) != Sensor(20, 15, "ideal", seed, camera).expose(light)).any()


@pytest.mark.parametrize("value", [0.3, 1 / 3, 1e-6, 0.999999])
def test_ten_million_ticks_lose_nothing(value):
    sensor, ticks = Sensor(1, 1, "ideal", 5, 0), 10_000_000
    charge = int(sensor._charge[0])
    units = int(float(np.float32(value)) * 2**40 + 0.5)
    fired = sum(int(sensor.expose(constant(value, ticks // 10, 1, 1)).sum()) for _ in range(10))
    assert fired == (charge + ticks * units) >> 40
    assert int(sensor._charge[0]) == (charge + ticks * units) & (2**40 - 1)


@given(seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_ideal_counts_are_within_one_of_the_integral(seed):
    rng = np.random.default_rng(seed)
    light = (rng.random((300, 6, 9)) * rng.choice([0.01, 0.3, 1.0])).astype(np.float32)
    counts = np.cumsum(Sensor(9, 6, "ideal", seed, 0).expose(light), axis=0, dtype=np.int64)
    assert np.abs(counts - np.cumsum(light, axis=0, dtype=np.float64)).max() < 1


def test_initial_charge_is_spread_evenly():
    first = Sensor(400, 250, "ideal", 0, 0).expose(constant(0.25, 4, 400, 250)).mean(axis=(1, 2))
    np.testing.assert_allclose(first, 0.25, atol=0.007)  # five standard deviations of 100,000 pixels


def test_bright_light_fires_in_consecutive_ticks_and_saturates_at_one():
    bright = Sensor(20, 15, "real", 0, 0).expose(constant(0.9, 50))
    assert (bright[1:] & bright[:-1]).any()
    sensor = Sensor(20, 15, "ideal", 0, 0)
    assert sensor.expose(constant(np.inf, 50)).all()
    assert not sensor.expose(constant(0, 50)).any()  # no backlog of what saturation cut off


@pytest.mark.parametrize("value", [0.0, -0.0, -3.0, -np.inf])
def test_darkness_and_negative_light_fire_nothing(value):
    assert not Sensor(20, 15, "ideal", 0, 0).expose(constant(value, 100)).any()


@pytest.mark.parametrize("kind", SENSOR_KINDS)
def test_nan_and_other_shapes_are_refused_and_change_nothing(kind):
    sensor = Sensor(20, 15, kind, 0, 0)
    broken = constant(0.3, 3)
    broken[1, 2, 3] = np.nan
    with pytest.raises(BadRecordingError, match="NaN"):
        sensor.expose(broken)
    with pytest.raises(BadRecordingError, match="shape"):
        sensor.expose(constant(0.3, 3, 21, 15))
    assert sensor.tick == 0
    np.testing.assert_array_equal(sensor.expose(constant(0.3, 9)), Sensor(20, 15, kind, 0, 0).expose(constant(0.3, 9)))


@pytest.mark.parametrize(("kind", "width", "seed"), [("perfect", 4, 0), ("real", 0, 0), ("real", 4, -1)])
def test_impossible_sensors_are_refused(kind, width, seed):
    with pytest.raises(BadRecordingError, match="expected"):
        Sensor(width, 4, kind, seed, 0)


def test_a_real_static_scene_meets_the_yardsticks():
    light = np.tile(np.linspace(0.05, 0.6, 400 * 250, dtype=np.float32).reshape(1, 250, 400), (400, 1, 1))
    planes = Sensor(400, 250, "real", 0, 4).expose(light)
    counts = planes.reshape(20, 20, 250, 400).sum(axis=1, dtype=np.float64)
    fano = counts.var(axis=0, ddof=1) / np.maximum(counts.mean(axis=0), 1e-9)
    assert np.median(fano) < 0.2
    assert fano.mean() < 0.2
    tfp = planes[100:300].mean()
    assert _interval_rate(planes, 200) == pytest.approx(tfp, rel=0.01)


def _interval_rate(planes: np.ndarray, at: int) -> float:
    """Mean over pixels of 1 / (next spike after `at` - last spike at or before it); silent pixels count as zero."""
    before = planes[at::-1].argmax(axis=0)
    after = planes[at + 1 :].argmax(axis=0) + 1
    both = planes[: at + 1].any(axis=0) & planes[at + 1 :].any(axis=0)
    # Weighted by the interval: an instant falls into long intervals more often than into short ones.
    return float(np.where(both, 1 / (before + after), 0).mean())


def test_gain_dark_current_and_defects_are_what_they_say():
    dark = Sensor(400, 250, "real", 0, 0).expose(constant(0.0, 600, 400, 250)).mean(axis=0)
    hot = dark > 0.1
    assert 1 <= hot.sum() <= 30  # ten expected
    assert dark[~hot].mean() == pytest.approx(5e-4, rel=0.1)
    lit = Sensor(400, 250, "real", 0, 0).expose(constant(0.5, 600, 400, 250)).mean(axis=0)
    dead = lit == 0
    assert 1 <= dead.sum() <= 30
    assert lit[~hot & ~dead].std() / 0.5 == pytest.approx(0.01, rel=0.05)


def test_every_reset_has_thermal_noise_and_every_pixel_its_threshold(monkeypatch):
    monkeypatch.setattr("acquisition.spikes.sensor.ELECTRONS_PER_SPIKE", 1e30)  # no shot noise
    sensor = Sensor(200, 100, "real", 1, 0)
    planes = sensor.expose(constant(0.2, 4000, 200, 100)).reshape(4000, -1)
    rate = planes.mean(axis=0, dtype=np.float64)
    responses = rate / 0.2 * sensor._full / 2**40  # of what a nominal threshold would have made of it
    well = (rate > 0.1) & (sensor._dark < 0.1)
    np.testing.assert_allclose(responses[well], (sensor._gain + sensor._dark / 0.2)[well], atol=2e-3)
    assert (sensor._full / 2**40).std() == pytest.approx(THRESHOLD_SPREAD, rel=0.05)
    limits = (sensor._limit.astype(np.float64) - sensor._full)[well] / 2**40
    assert limits.std() == pytest.approx(THERMAL_NOISE, rel=0.05)
    assert abs(limits.mean()) < 5 * THERMAL_NOISE / np.sqrt(well.sum())


def test_ideal_interval_images_have_the_mean_of_window_images_at_the_cars_light():
    light = np.tile(np.linspace(0.05, 0.682, 250 * 400, dtype=np.float32).reshape(1, 250, 400), (200, 1, 1))
    for kind in ("ideal", "real"):
        planes = Sensor(400, 250, kind, 3, 0).expose(light)
        assert planes.mean() == pytest.approx(0.366, rel=0.01)  # spikes per tick of the real recording of a car
        assert _interval_rate(planes, 100) == pytest.approx(planes.mean(), rel=0.01)
        assert 0.05 < (planes[1:] & planes[:-1]).mean() / planes.mean() < 0.5  # intervals of one tick occur


def _still_parts(planes: np.ndarray) -> np.ndarray:
    """Pixels that, with all about them, keep their light to 0.03 spikes a tick over four quarters of the planes."""
    quarters = planes.reshape(4, -1, *planes.shape[1:]).mean(axis=1)
    still = (np.ptp(quarters, axis=0) <= 0.03) & (planes.mean(axis=0) > 0.05)
    return np.logical_and.reduce([np.roll(still, (dy, dx), (0, 1)) for dy in (-2, 0, 2) for dx in (-2, 0, 2)])


def _fano(planes: np.ndarray, still: np.ndarray, window: int) -> float:
    """Variance over mean of counts in `window` planes, from neighbouring windows: slow change does not count."""
    counts = planes.reshape(-1, window, *planes.shape[1:]).sum(axis=1, dtype=np.float64)[:, still]
    return float((np.diff(counts, axis=0) ** 2).mean() / 2 / counts.mean())


def test_counts_are_as_regular_as_those_of_a_real_camera_in_the_same_light(spikedata):
    car = SpikeStream.open(spikedata / "histsflow_car.dat", PlaneLayout(400, 250), 20_000.0)
    car_planes = car.planes(0, 200)
    still = _still_parts(car_planes)
    assert still.mean() > 0.2
    light = np.tile(car_planes.mean(axis=0, dtype=np.float32)[None], (200, 1, 1))
    simulated = Sensor(400, 250, "real", 0, 4).expose(light)
    for window in (10, 20, 40):
        assert _fano(simulated, still, window) == pytest.approx(_fano(car_planes, still, window), rel=0.1)
    assert _fano(simulated, still, 20) < 0.2
