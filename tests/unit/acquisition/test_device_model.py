import threading

import numpy as np
import pytest

from acquisition.devices.control_channel import StallError
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.protocol import BlockParser
from acquisition.devices.registers import Geometry, Request, State, Status, TickRate
from acquisition.spikes.layout import PlaneLayout


class RandomSource:
    def __init__(self, layout: PlaneLayout, planes: int, seed: int = 0):
        self.layout = layout
        self.all = np.random.default_rng(seed).integers(0, 256, (planes, layout.plane_bytes), dtype=np.uint8)
        self.asked = 0

    def next_planes(self, count: int) -> np.ndarray:
        found = self.all[self.asked : self.asked + count]
        self.asked += count
        return found


def model_of(planes: int = 200) -> DeviceModel:
    return DeviceModel("A1", RandomSource(PlaneLayout(9, 5), planes), 20_000)


def drain(model: DeviceModel, size: int) -> list:
    parser = BlockParser()
    while data := model.stream.send(size, 0.001):
        parser.feed(data)
    return list(iter(parser.next, None))


def test_registers_describe_the_camera():
    model = model_of()
    assert Geometry.decode(model.read(Request.GEOMETRY)) == Geometry(PlaneLayout(9, 5), 80)
    assert TickRate.decode(model.read(Request.TICK_RATE)).hz == 20_000
    assert Status.decode(model.read(Request.STATUS)).state is State.IDLE


def test_a_block_of_full_size_is_a_megabyte():
    assert DeviceModel("A1", RandomSource(PlaneLayout(400, 250), 1), 2e4).stream.geometry.planes_per_block == 80
    assert DeviceModel("A1", RandomSource(PlaneLayout(1000, 1000), 1), 2e4).stream.geometry.planes_per_block == 8


@pytest.mark.parametrize("size", [1 << 20, 512, 97])
def test_the_stream_is_the_source_bit_for_bit(size):
    model = model_of()
    model.write(Request.ARM)
    model.trigger()
    blocks = drain(model, size)
    assert [b.first_plane for b in blocks] == [0, 80, 160]
    assert [b.device_time_ns for b in blocks] == [0, 4_000_000, 8_000_000]
    assert {b.sync_pulses for b in blocks} == {1}
    np.testing.assert_array_equal(np.concatenate([b.packed for b in blocks]), model.stream.source.all)


def test_nothing_is_sent_before_the_trigger_and_after_stop():
    model = model_of()
    model.trigger()  # not armed: counted, not obeyed
    model.write(Request.ARM)
    assert not model.stream.send(1000, 0.001)
    model.write(Request.START)
    assert model.stream.send(10, 0.001)
    model.write(Request.STOP)
    assert not model.stream.send(1000, 0.001)
    assert model.stream.source.asked == 80  # paced by the reader: one block


def test_the_trigger_ends_a_read_that_waits():
    model = model_of()
    model.write(Request.ARM)
    found = []
    reader = threading.Thread(target=lambda: found.append(len(model.stream.send(10, 60))))
    reader.start()
    model.trigger()
    reader.join()
    assert found == [10]


def test_what_the_device_does_not_know_stalls():
    model = model_of()
    with pytest.raises(StallError):
        model.read(0x7F)
    with pytest.raises(StallError):
        model.write(0x7F)
    with pytest.raises(StallError):
        model.write(Request.START)  # not armed
    with pytest.raises(StallError):
        model.control(0x80, 0x06, 0x0309)  # string 9
