"""What every camera back end promises to the driver above it."""

import dataclasses

import numpy as np
import pytest
import usb.core

from acquisition.devices.device_model import DeviceModel
from acquisition.devices.mock import MockBackend, MockTriggerLine
from acquisition.devices.registers import State
from acquisition.devices.usb import CameraSetupError, SoftwareTrigger, UsbCamera
from acquisition.errors import DeviceError
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.transform import Transform

LAYOUT = PlaneLayout(9, 5)
RATE = 20_000.0
CAMERA = Camera("cam12", 9, 5, 8.0, 8.0, 4.5, 2.5, Transform.identity(), serial="A1")
PLANES = np.random.default_rng(0).integers(0, 256, (200, LAYOUT.plane_bytes), dtype=np.uint8)


class Stored:
    layout = LAYOUT

    def __init__(self):
        self.left = PLANES

    def next_planes(self, count: int) -> np.ndarray:
        found, self.left = self.left[:count], self.left[count:]
        return found


class MockBench:
    """One camera on the mock bus, and the hand that spoils it."""

    def __init__(self):
        self.model = DeviceModel("A1", Stored(), RATE)
        self.backend = MockBackend([self.model])

    def fire(self) -> None:
        MockTriggerLine([self.model]).fire()

    def unplug(self) -> None:
        self.backend.unplug("A1")

    def halt(self) -> None:
        self.backend.halt("A1")

    def flip(self, byte: int) -> None:
        """Flip a bit of the next block on its way."""
        self.model.flip_bit(byte)


@pytest.fixture(params=[MockBench])
def bench(request):
    return request.param()


@pytest.fixture
def camera(bench):
    opened = UsbCamera.open(CAMERA, RATE, bench.backend)
    yield opened
    opened.close()


def read_all(camera: UsbCamera) -> np.ndarray:
    return np.concatenate([b.packed for b in iter(lambda: camera.read_block(0.01), None)])


def test_all_planes_arrive_bit_for_bit(bench, camera):
    assert camera.layout == LAYOUT
    camera.arm()
    assert camera.status().state is State.ARMED
    bench.fire()
    np.testing.assert_array_equal(read_all(camera), PLANES)
    assert camera.damages == 0
    assert camera.status().emitted_planes == len(PLANES)


def test_a_rig_without_a_line_starts_by_command(camera):
    camera.arm()
    SoftwareTrigger([camera]).fire()
    assert camera.read_block(0.01).first_plane == 0


def test_an_armed_camera_sends_nothing_before_the_trigger(camera):
    camera.arm()
    assert camera.read_block(0.01) is None


def test_a_stopped_camera_can_be_armed_again(bench, camera):
    camera.arm()
    bench.fire()
    camera.read_block(0.01)
    camera.ensure_stopped()
    assert camera.status().state is State.IDLE
    camera.arm()
    bench.fire()
    assert camera.read_block(0.01).first_plane == 0


def test_a_stall_is_cleared_and_costs_nothing(bench, camera):
    camera.arm()
    bench.fire()
    bench.halt()
    assert camera.read_block(0.01) is None
    np.testing.assert_array_equal(read_all(camera), PLANES)


def test_a_damaged_block_is_dropped_and_counted(bench, camera):
    camera.arm()
    bench.fire()
    bench.flip(100)
    np.testing.assert_array_equal(read_all(camera), PLANES[80:])
    assert camera.damages == 1


def test_an_unplugged_camera_is_named(bench, camera):
    camera.arm()
    bench.fire()
    bench.unplug()
    for call in (lambda: camera.read_block(1), camera.arm, camera.start, camera.status):
        with pytest.raises(DeviceError, match=r"cam12 \(serial A1\): it is not connected any more"):
            call()
    camera.ensure_stopped()


@pytest.mark.parametrize(
    ("change", "rate", "message"),
    [
        ({"serial": "B7"}, RATE, r"cam12: found no camera with serial B7 \(connected: A1\)"),
        ({"serial": ""}, RATE, "cam12: found no serial in the rig"),
        ({"width": 10}, RATE, "cam12: found a sensor of 9x5, expected 10x5"),
        ({}, 40_000.0, "cam12: found 20000 Hz, expected 40000 Hz"),
    ],
)
def test_a_camera_that_does_not_fit_the_rig_is_refused(bench, change, rate, message):
    with pytest.raises(CameraSetupError, match=message) as caught:
        UsbCamera.open(dataclasses.replace(CAMERA, **change), rate, bench.backend)
    assert caught.value.exit_code == 2
    UsbCamera.open(CAMERA, RATE, bench.backend).close()  # and is not held


def test_a_camera_in_use_says_so(bench, camera):
    with pytest.raises(DeviceError, match="another program holds it"):
        UsbCamera.open(CAMERA, RATE, bench.backend)


def test_a_device_that_may_not_be_opened_does_not_hide_the_others(bench, monkeypatch):
    def refuse(handle):
        raise usb.core.USBError("Access denied (insufficient permissions)", -3, 13)

    monkeypatch.setattr(bench.backend, "open_device", refuse)
    with pytest.raises(CameraSetupError, match="connected: unreadable"):
        UsbCamera.open(CAMERA, RATE, bench.backend)
