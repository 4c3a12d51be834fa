"""Pixel calibration finds the fixed pattern that the simulated sensor has, and images gain by it."""

import dataclasses

import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.scenes.calibration import FLAT_LEVEL
from acquisition.scenes.catalog import build_scene
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.pixels import PixelCalibration, estimate_pixels, read_pixels, write_pixels
from rigs.toml import catalog_rig

WIDTH, HEIGHT = 200, 125
LAYOUT = PlaneLayout(WIDTH, HEIGHT)
SEED, CAMERA = 8, 4


def exposed(light: np.ndarray | float, planes: int) -> SpikeStream:
    """Record a still image [H, W] with camera 4 of seed 5."""
    sensor = Sensor(WIDTH, HEIGHT, "real", SEED, CAMERA, threads=0)
    image = np.broadcast_to(np.asarray(light, dtype=np.float32), (HEIGHT, WIDTH))
    parts = [pack(sensor.expose(np.repeat(image[None], 100, axis=0)), LAYOUT) for _ in range(planes // 100)]
    return SpikeStream(np.concatenate(parts), LAYOUT, 20_000.0)


@pytest.fixture(scope="module")
def calibration() -> PixelCalibration:
    return estimate_pixels(exposed(FLAT_LEVEL, 4000), exposed(0.0, 4000))


def test_the_injected_pattern_is_recovered(calibration):
    sensor = Sensor(WIDTH, HEIGHT, "real", SEED, CAMERA)
    threshold = sensor._full / 2**40
    gain, dark = ((array / threshold).reshape(HEIGHT, WIDTH) for array in (sensor._gain, sensor._dark))
    np.testing.assert_array_equal(calibration.dead, gain == 0)
    np.testing.assert_array_equal(calibration.hot, dark > 0.1)
    assert calibration.dead.sum() > 0
    assert calibration.hot.sum() > 0
    good = ~calibration.defect
    assert calibration.gain[good].mean() == pytest.approx(1, abs=1e-6)
    error = calibration.gain - gain / gain[good].mean()
    assert error[good].std() < 5e-4  # measured 2.3e-4, of a spread of 1e-2
    assert np.abs(error[good]).max() < 2e-3  # measured 7e-4
    np.testing.assert_allclose(calibration.offset[calibration.hot], dark[calibration.hot], atol=1e-3)
    assert (calibration.offset - dark)[good].std() < 2e-4  # measured 1.0e-4


def decibels(image: np.ndarray, truth: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((image - truth) ** 2)) + 20 * np.log10(truth.max()))


def test_a_still_picture_gains_decibels(calibration):
    camera = catalog_rig("lab3x3").scaled(WIDTH, HEIGHT).camera("cam11")
    truth = build_scene("fan_and_ball", 1).render(camera, np.zeros(1), 2).intensity[0]
    image = exposed(truth, 2000).counts(0, 2000) / np.float32(2000)
    before, after = decibels(image, truth), decibels(calibration.corrected(image), truth)
    mended = decibels(np.where(calibration.defect, truth, image), truth)
    assert after > mended + 10  # measured 39.6, 48.6 without the defects, 63.4 dB
    assert after > before + 15


def test_an_even_field_becomes_even(calibration):
    image = exposed(0.3, 2000).counts(0, 2000) / np.float32(2000)
    assert calibration.corrected(image).std() < 0.2 * image[~calibration.defect].std()


def test_a_calibration_survives_the_disk(calibration, tmp_path):
    write_pixels(tmp_path / "a.npz", calibration)
    found = read_pixels(tmp_path / "a.npz")
    for field in dataclasses.fields(PixelCalibration):
        array = getattr(found, field.name)
        np.testing.assert_array_equal(array, getattr(calibration, field.name))
        assert array.dtype == getattr(calibration, field.name).dtype


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04", b"nonsense" * 9, None])
def test_what_is_no_calibration_is_refused_by_name(tmp_path, data):
    if data is not None:
        (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(BadRecordingError, match=r"a\.npz"):
        read_pixels(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", gain=np.ones((2, 2)), offset=np.ones((2, 3)), hot=np.ones(2), dead=np.ones(2))
    with pytest.raises(BadRecordingError, match=r"a\.npz: found no pixel calibration .*one size"):
        read_pixels(tmp_path / "a.npz")


def even(level: float, planes: int, layout: PlaneLayout = LAYOUT) -> SpikeStream:
    """Every pixel fires on the same `level` of planes."""
    fired = (np.arange(planes) * level) % 1 < level
    stored = np.repeat(fired[:, None, None], layout.height, axis=1).repeat(layout.width, axis=2)
    return SpikeStream(pack(stored.astype(np.uint8), layout), layout, 20_000.0)


@pytest.mark.parametrize(
    ("flat", "dark", "message"),
    [
        (even(0.1, 1000), even(0.0, 1000), "found 10[0-9] spikes a pixel"),
        (even(0.1, 9000), even(0.5, 100), "found 0 spikes a pixel"),
        (even(1.0, 1000), even(0.0, 1000), r"found 1\.00 spikes per tick"),
        (even(0.5, 1000), even(0.0, 10, PlaneLayout(9, 5)), "a flat of 200x125 and a dark of 9x5"),
    ],
)
def test_useless_recordings_are_refused(flat, dark, message):
    with pytest.raises(BadRecordingError, match=message):
        estimate_pixels(flat, dark)


def test_a_flat_that_saturates_somewhere_is_refused():
    light = np.full((HEIGHT, WIDTH), 0.6)
    light[: HEIGHT // 8] = 1.3
    with pytest.raises(BadRecordingError, match=r"found 1[12]\.\d% of the pixels firing in nearly every tick"):
        estimate_pixels(exposed(light, 1000), exposed(0.0, 1000))


def test_a_defect_without_good_neighbours_takes_the_nearest_good_pixel():
    ones = np.ones((4, 4), np.float32)
    defect = np.ones((4, 4), bool)
    defect[0] = False
    calibration = PixelCalibration(ones, 0 * ones, defect, np.zeros_like(defect))
    image = np.arange(16, dtype=np.float32).reshape(4, 4)
    found = calibration.corrected(image)
    assert found[0].tolist() == [0, 1, 2, 3]
    assert found[1, 1] == 1
    assert found[3, 3] == 3
    with pytest.raises(BadRecordingError, match="expected"):
        calibration.corrected(image[1:])
