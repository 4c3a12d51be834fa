"""Traits of real sensors: each trait off by default, alone as it says, the same bytes however it is called."""

import json
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from references.readout import read_out_reference

from acquisition.devices.open import Simulation, parse_devices
from acquisition.devices.usb import CameraSetupError
from acquisition.errors import BadRecordingError
from acquisition.recording.reader import Recording
from acquisition.scenes.own import AS_NOMINAL, owned
from acquisition.session.record import simulate
from acquisition.spikes.readout import read_out
from acquisition.spikes.sensor import DARK_LEVEL, Sensor
from acquisition.spikes.traits import DOUBLING_K, HARSH, Traits
from rigs.toml import catalog_rig

SIZE = (67, 61)
STRONG = Traits(pixel_spread=0.1, line_spread=0.05, warmer_k=20, row_jitter=0.05, blooming=0.9, failing=0.2)


def even(value: float, ticks: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.full((ticks, size[1], size[0]), value, dtype=np.float32)


def sensor(kind="ideal", size=SIZE, threads=1, **traits) -> Sensor:
    return Sensor(*size, kind, 7, 2, threads=threads, traits=Traits(**traits))


def test_traits_that_are_off_change_no_byte():
    light = np.random.default_rng(0).random((40, 61, 67), dtype=np.float32) * 1.2
    digests = {kind: zlib.crc32(sensor(kind).expose(light).tobytes()) for kind in ("ideal", "real")}
    assert digests == {"ideal": 88322756, "real": 3646773109}  # of the sensors before there were traits


@given(
    n=st.integers(0, 4),
    height=st.integers(1, 9),
    width=st.integers(1, 17),
    first=st.integers(0, 2**62),
    jitter=st.sampled_from([0.0, 0.01, 0.9]),
    blooming=st.sampled_from([0.0, 0.5, 1.0]),
    scale=st.sampled_from([0.0, 1e-30, 0.7, 30.0, np.inf]),
)
@settings(max_examples=60, deadline=None)
def test_reading_out_agrees_with_its_twin_bit_for_bit(n, height, width, first, jitter, blooming, scale):
    rng = np.random.default_rng(3)
    keys = rng.integers(0, 2**64, height, dtype=np.uint64)
    light = rng.normal(0.5, 0.5, (n, height, width)).astype(np.float32)
    light = np.where(light > 0, light * np.float32(scale), light) if scale != np.inf else np.full_like(light, np.inf)
    found = read_out(light, keys, first, jitter, blooming, threads=2)
    np.testing.assert_array_equal(found, read_out_reference(light, keys, first, jitter, blooming))


@pytest.mark.parametrize("traits", [STRONG, HARSH])
def test_neither_calls_nor_threads_change_a_byte_of_a_harsh_sensor(traits):
    light = np.random.default_rng(0).random((40, 61, 67), dtype=np.float32) * 1.5
    whole, cut, twin = (Sensor(*SIZE, "real", 7, 2, threads=n, traits=traits) for n in (1, 3, 1))
    planes = whole.expose(light)
    np.testing.assert_array_equal(planes, np.concatenate([cut.expose(p) for p in np.split(light, [1, 9, 9, 32])]))
    np.testing.assert_array_equal(planes, twin.expose_reference(light))


def test_harsh_is_real_with_every_trait_and_explicit_ones_prevail():
    light = np.random.default_rng(0).random((10, 61, 67), dtype=np.float32)
    harsh = Sensor(*SIZE, "harsh", 7, 2)
    assert all(getattr(HARSH, name) > 0 for name in HARSH.__dataclass_fields__)
    np.testing.assert_array_equal(harsh.expose(light), Sensor(*SIZE, "real", 7, 2, traits=HARSH).expose(light))
    assert sensor("harsh", pixel_spread=0.2).traits.pixel_spread == 0.2


def test_gains_spread_by_pixel_row_and_column():
    size = (400, 250)
    pixels = sensor(size=size, pixel_spread=0.03).response[0]
    assert pixels.std() == pytest.approx(0.03, rel=0.02)
    assert pixels.mean(axis=0).std() == pytest.approx(0.03 / np.sqrt(250), rel=0.2)  # columns alike
    lines = sensor(size=size, line_spread=0.01).response[0]
    columns = lines.mean(axis=0) - lines.mean()
    assert columns.std() == pytest.approx(0.01, rel=0.15)
    rows = lines - columns
    assert rows.mean(axis=1).std() == pytest.approx(0.01, rel=0.15)
    assert np.ptp(rows, axis=1).max() < 1e-6  # nothing is left to the pixels
    counts = sensor(size=size, pixel_spread=0.03).expose(even(0.4, 500, size)).mean(axis=0)
    np.testing.assert_allclose(counts / 0.4, pixels, atol=0.006)


def test_dark_current_doubles_with_temperature():
    dark = [sensor("real", warmer_k=k, size=(100, 80)).response[1] for k in (0.0, DOUBLING_K, 3 * DOUBLING_K)]
    np.testing.assert_allclose(dark[1], 2 * dark[0])
    np.testing.assert_allclose(dark[2], 8 * dark[0])
    warm = sensor("real", size=(100, 80), warmer_k=40).expose(even(0, 1000, (100, 80)))
    assert np.median(warm.mean(axis=(1, 2))) == pytest.approx(32 * DARK_LEVEL, rel=0.1)


def test_a_row_that_is_read_late_gains_what_the_next_plane_loses():
    keys = np.random.default_rng(3).integers(0, 2**64, 30, dtype=np.uint64)
    lasts = read_out(even(0.5, 400, (3, 30)), keys, 5, 0.02, 0.0)[:, :, 0].astype(float) / 0.5
    assert lasts.std() == pytest.approx(0.02 * np.sqrt(2), rel=0.05)  # of both ends
    assert np.abs(lasts.sum(axis=0) - 400).max() < 0.02 * 2 * 3.5  # ends alone
    assert np.corrcoef(lasts[:, 0], lasts[:, 1])[0, 1] == pytest.approx(0, abs=0.2)  # each row by itself


def test_saturated_pixels_overflow_into_their_neighbours():
    light = even(0.2, 1, (21, 21))
    light[0, 10, 10] = 3.0
    spill = read_out(light, np.zeros(21, np.uint64), 0, 0.0, 0.8)[0] - light[0]
    assert spill[10, 11] == spill[11, 10] == spill[10, 9] == pytest.approx(0.8 * 2 / 4)
    assert spill.sum() == pytest.approx(0.8 * 2)  # none of the neighbours overflows in turn
    light[0, 10, 10] = 30.0
    far = read_out(light, np.zeros(21, np.uint64), 0, 0.0, 0.8)[0] - light[0]
    assert far[10, 12] > 0.1
    assert far[10, 20] == 0  # beyond reach
    held = np.minimum(light[0] + far, 1)
    assert held.sum() < 0.2 * 440 + 1 + 0.8 * 29


def test_pixels_fail_on_the_way_and_stay_so():
    ticks, size = 2000, (100, 100)
    failed = sensor(size=size, failing=0.02)
    planes = failed.expose(even(0.1, ticks, size)).reshape(ticks, -1).astype(float)
    turned = {p: t for p, t in zip(failed.failures.pixels, failed.failures.ticks, strict=True) if t < ticks}
    assert len(turned) == pytest.approx(0.02 * 10_000 * 2, rel=0.2)
    rates = [planes[t:, p].mean() for p, t in turned.items() if t < ticks - 200]
    assert np.mean([rate == 0 for rate in rates]) == pytest.approx(0.5, abs=0.1)
    assert all(rate > 0.19 for rate in rates if rate)
    before = [planes[:t, p].mean() for p, t in turned.items() if t > 300]
    np.testing.assert_allclose(before, 0.1, atol=0.01)
    others = np.setdiff1d(np.arange(10_000), list(turned))
    np.testing.assert_allclose(planes[:, others].mean(axis=0), 0.1, atol=0.002)


@pytest.mark.parametrize("traits", [{"pixel_spread": -0.1}, {"failing": 2}, {"warmer_k": float("nan")}])
def test_impossible_traits_are_refused(traits):
    with pytest.raises(BadRecordingError, match="expected 0 to"):
        Traits(**traits)


def test_cameras_differ_as_they_are_told_to():
    assert owned(9, 0, 0, 3) == [AS_NOMINAL] * 9
    both, gains = owned(500, 0.05, 1.0, 3), owned(500, 0.05, 0.0, 3)
    assert [own.gain for own in both] == [own.gain for own in gains]
    assert np.std([own.gain for own in both]) == pytest.approx(0.05, rel=0.1)
    lags = np.array([own.lag_ticks for own in both])
    assert np.abs(lags).max() <= 1
    assert lags.std() == pytest.approx(1 / np.sqrt(3), rel=0.1)
    with pytest.raises(CameraSetupError, match="camera_gains"):
        Simulation("flat", camera_gains=-1)


def test_a_recording_says_what_its_cameras_and_pixels_are(tmp_path):
    rig = catalog_rig("ci3x3").scaled(24, 16).only(["cam00"])
    uri = "mock:flat?seed=4&pixel_spread=0.05&camera_gains=0.1&camera_lags=2&truth_every=200&samples=1"
    simulation = parse_devices(uri)
    assert simulation == Simulation(
        "flat", 4, samples=1, truth_every=200, traits=Traits(pixel_spread=0.05), camera_gains=0.1, camera_lags=2.0
    )
    assert isinstance(simulation, Simulation)
    simulate(simulation, rig, 400, tmp_path / "rec")
    recording = Recording.open(tmp_path / "rec")
    own = json.loads((tmp_path / "rec/truth/own.json").read_text())
    for camera in rig.ids:
        gain = np.load(tmp_path / f"rec/truth/{camera}/pixel_gain.npy")
        counts = recording.stream(camera).counts(0, 400)
        np.testing.assert_allclose(counts / 400, 0.5 * gain * own[camera]["gain"] + 5e-4, atol=0.006)
        assert abs(own[camera]["lag_ticks"]) <= 2
    simulate(Simulation("flat", 4, samples=1), rig, 20, tmp_path / "plain")
    assert not (tmp_path / "plain/truth/own.json").exists()


def test_a_lagging_camera_sees_what_the_others_see_later(tmp_path):
    rig = catalog_rig("ci3x3").scaled(40, 25).only(["cam00"])
    late = Simulation("fan_and_ball", 1, "ideal", samples=1, truth_every=500, camera_lags=40.0)
    simulate(late, rig, 120, tmp_path / "late")
    simulate(Simulation("fan_and_ball", 1, "ideal", samples=1, truth_every=500), rig, 200, tmp_path / "plain")
    lag = late.owned(rig)["cam00"].lag_ticks
    streams = [Recording.open(tmp_path / name).stream("cam00") for name in ("late", "plain")]
    whole = np.stack([streams[1].counts(t, t + 20).astype(float) for t in range(0, 161)])
    moving = np.ptp(whole[::20], axis=0) > 4
    seen = np.stack([streams[0].counts(t, t + 20) for t in (40, 60, 80)])
    errors = {s: np.abs(seen - whole[[40 + s, 60 + s, 80 + s]])[:, moving].mean() for s in range(-40, 41, 4)}
    assert min(errors, key=errors.__getitem__) == pytest.approx(lag, abs=4)
