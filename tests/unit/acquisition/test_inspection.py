"""The layout of a `.dat` is told from its bytes: real recordings, simulated ones, and bytes that are none."""

import itertools

import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.recording.inspection import LIKELY, SIZES, inspect, middle_planes
from acquisition.scenes.catalog import build_scene
from acquisition.spikes import m1k40
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from rigs.toml import catalog_rig

MANY = [*SIZES, (400, 200), (400, 300), (250, 400), (320, 240), (160, 100), (800, 125)]


def bytes_of(layout: PlaneLayout, planes: int = 200) -> np.ndarray:
    """The bytes of a simulated camera."""
    camera = catalog_rig("lab3x3").scaled(layout.width, layout.height).camera("cam11")
    light = build_scene("fan_and_ball", 0).render(camera, np.zeros(1), 2).intensity
    spikes = Sensor(layout.width, layout.height, "real", 0, 4).expose(np.repeat(light, planes, axis=0))
    return pack(spikes, layout).ravel()


@pytest.mark.parametrize(
    ("size", "order", "trailing"),
    list(itertools.product([(400, 250), (160, 100), (250, 250)], ["lsb", "msb"], [0, 16])),
)
def test_the_layout_of_a_simulated_camera(size: tuple[int, int], order, trailing: int) -> None:
    layout = PlaneLayout(*size, order, "bottom", trailing)
    data = bytes_of(layout)
    found = inspect(data, len(data), MANY)
    best = found[0]
    assert (best.layout, best.format) == (layout, "vidar416" if trailing else "vidar")
    assert (best.planes, best.left_bytes) == (200, 0)
    assert best.plausibility > LIKELY
    assert found[1].plausibility < 0.95 * best.plausibility  # 800x125 has the same planes, in longer rows


@pytest.mark.parametrize("name", ["histsflow_car.dat", "zoo_data_200_part1.dat"])
def test_the_layout_of_a_real_recording(spikedata, name: str) -> None:
    data = np.fromfile(spikedata / name, dtype=np.uint8)
    best = inspect(data, len(data), MANY)[0]
    assert (best.format, best.layout) == ("vidar", PlaneLayout(400, 250))
    assert (best.planes, best.left_bytes) == (len(data) // 12500, 0)
    assert best.plausibility > 0.7


def test_a_part_tells_of_the_whole() -> None:
    layout = PlaneLayout(400, 250)
    data = bytes_of(layout, 40)
    best = inspect(data, 1_000 * layout.plane_bytes + 7, SIZES)[0]
    assert (best.layout, best.planes, best.left_bytes) == (layout, 1000, 7)


def test_an_m1k40_stream_is_known_by_its_trailers() -> None:
    rng = np.random.default_rng(0)
    segments = rng.integers(0, 256, (10, m1k40.SEGMENTS, m1k40.SEGMENT_BYTES), dtype=np.uint8)
    channel, step = np.divmod(np.arange(m1k40.SEGMENTS), 500)
    word = np.where(channel < 2, 500 - step, step + 1) << 4 | channel << 14
    segments[:, :, 62], segments[:, :, 63] = word & 255, word >> 8
    data = segments.ravel()
    found = [one for one in inspect(data, len(data), SIZES) if one.format == "m1k40"]
    assert [(one.layout, one.planes, one.left_bytes) for one in found] == [(m1k40.LAYOUT, 10, 0)]
    assert middle_planes(data, "m1k40", m1k40.LAYOUT).shape == (10, 125_000)


def test_noise_and_darkness_fit_nothing_well() -> None:
    noise = np.random.default_rng(0).integers(0, 256, 2_500_000, dtype=np.uint8)
    assert inspect(noise, len(noise), SIZES)[0].plausibility < 0.05
    assert {one.plausibility for one in inspect(np.zeros(2_500_000, np.uint8), 2_500_000, SIZES)} == {0.0}


def test_fewer_bytes_than_a_plane_have_no_layout() -> None:
    data = np.zeros(7000, np.uint8)
    assert inspect(data, len(data), SIZES) == []
    assert inspect(data[:0], 5_000_000, SIZES) == []
    assert middle_planes(data, "vidar", PlaneLayout(400, 250)).shape == (0, 12_500)
    with pytest.raises(BadRecordingError, match="M1K40"):
        middle_planes(data, "m1k40", m1k40.LAYOUT)
