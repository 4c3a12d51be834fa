"""A stream read with the wrong bit order says so; one read rightly does not."""

import dataclasses
import math

import numpy as np
import pytest

from acquisition.scenes.catalog import build_scene
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from acquisition.spikes.suspicion import boundary_step, suspected_bit_order
from rigs.toml import catalog_rig


def other(stream: SpikeStream) -> SpikeStream:
    """The same bytes, read in the other bit order."""
    order = "msb" if stream.layout.bit_order == "lsb" else "lsb"
    return SpikeStream(stream.packed, dataclasses.replace(stream.layout, bit_order=order), 20_000.0)


def test_the_real_car(spikedata):
    car = SpikeStream.open(spikedata / "histsflow_car.dat", PlaneLayout(400, 250), 20_000.0)
    assert suspected_bit_order(car) is None
    found = suspected_bit_order(other(car)) or ""
    assert "0.0769 spikes per tick read msb first and by 0.0159 read lsb first" in found
    assert found.endswith("import it with --bit-order lsb")


def test_other_real_and_synthetic_recordings(spikedata):
    zoo = SpikeStream.open(spikedata / "zoo_data_200_part1.dat", PlaneLayout(400, 250), 20_000.0)
    with np.load(spikedata / "zoo_uhsr.npz") as archive:
        layout = PlaneLayout(250, 250)
        dim = SpikeStream(pack(archive["spk"], layout), layout, 20_000.0)
    for stream in (zoo, dim):
        assert suspected_bit_order(stream) is None
    assert suspected_bit_order(other(zoo))


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("size", [(400, 250), (100, 64), (91, 57)])  # 91: rows begin inside bytes
@pytest.mark.parametrize("bit_order", ["lsb", "msb"])
def test_simulated_scenes(seed, size, bit_order):
    camera = catalog_rig("lab3x3").scaled(*size).camera("cam11")
    light = build_scene("fan_and_ball", seed).render(camera, np.zeros(1), 2).intensity
    layout = PlaneLayout(*size, bit_order, trailing_columns=3)
    planes = Sensor(*size, "real", seed, 4).expose(np.repeat(light, 40, axis=0))
    stream = SpikeStream(pack(planes, layout), layout, 20_000.0)
    assert suspected_bit_order(stream) is None
    assert suspected_bit_order(other(stream))


@pytest.mark.parametrize("level", [0.0, 0.01, 0.3, 1.0])
def test_an_even_or_a_dark_field_tells_nothing(level):
    layout = PlaneLayout(200, 125)
    planes = (np.random.default_rng(0).random((40, 125, 200)) < level).astype(np.uint8)
    stream = SpikeStream(pack(planes, layout), layout, 20_000.0)
    assert suspected_bit_order(stream) is None
    assert suspected_bit_order(other(stream)) is None


def test_too_few_pixels_tell_nothing():
    layout = PlaneLayout(16, 2)
    planes = np.zeros((1, 2, 16), dtype=np.uint8)
    assert math.isnan(boundary_step(pack(planes, layout), layout))
    assert suspected_bit_order(SpikeStream(pack(planes, layout), layout, 20_000.0)) is None
