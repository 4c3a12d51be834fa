"""Holds a trigger box to its contract with a session, on the mock and on a real kernel's HID stack."""

import time

import hidraw
import numpy as np
import pytest
from maintenance import usbip
from maintenance.usb_models import BoxOnUsb

from acquisition.devices.box_model import BoxModel
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.profile import VENDOR_ID
from acquisition.devices.protocol import BlockParser
from acquisition.devices.registers import Request, State
from acquisition.devices.trigger_box import (
    BOX_PRODUCT_ID,
    COMMAND,
    COMMAND_REPORT,
    BoxCommand,
    BoxState,
    BoxStatus,
    TriggerBox,
    find_box,
)
from acquisition.errors import DeviceError
from acquisition.spikes.layout import PlaneLayout


class Zeros:
    layout = PlaneLayout(8, 4)

    def next_planes(self, count: int) -> np.ndarray:
        return np.zeros((count, 4), dtype=np.uint8)


class MockBench:
    """A box whose line goes to two cameras."""

    def __init__(self):
        self.now_s = 0.0
        self.cameras = [DeviceModel(serial, Zeros(), 20_000) for serial in ("A1", "B2")]
        self.model = BoxModel("X9", self.cameras, lambda: self.now_s)
        self.plug()

    def plug(self) -> None:
        self.hid = self.model

    def open(self) -> TriggerBox:
        return TriggerBox(self.hid, period_s=0.002)

    def unplug(self) -> None:
        def gone(*_):
            raise OSError("read error")

        self.hid.send_feature_report, self.hid.get_feature_report = lambda buff: -1, gone

    def close(self) -> None:
        pass


class LateHid(hidraw.device):
    """Not closed while its device is plugged in.

    hidapi closes with the interpreter locked, and the kernel waits for the device, which is a thread of this process.
    """

    def close(self) -> None:
        pass


class UsbIpBench(MockBench):
    """The same box on this kernel's own HID stack."""

    def plug(self) -> None:
        self.device = usbip.UsbIpDevice(BoxOnUsb(self.model), usbip.HIGH_SPEED)
        self.wait_for(1)
        self.hid = LateHid()
        self.hid.open_path(hidraw.enumerate(VENDOR_ID, BOX_PRODUCT_ID)[0]["path"])

    def wait_for(self, count: int) -> None:
        for _ in range(1000):
            if len(hidraw.enumerate(VENDOR_ID, BOX_PRODUCT_ID)) == count:
                return
            time.sleep(0.01)
        raise AssertionError(f"found no {count} boxes")

    def unplug(self) -> None:
        self.device.unplug()
        self.wait_for(0)

    def close(self) -> None:
        if hidraw.enumerate(VENDOR_ID, BOX_PRODUCT_ID):
            self.unplug()
        hidraw.device.close(self.hid)


@pytest.fixture(params=[MockBench, *([UsbIpBench] if usbip.is_available() else [])])
def bench(request):
    found = request.param()
    yield found
    found.close()


def test_one_pulse_starts_every_armed_camera_and_more_follow(bench):
    box = bench.open()
    bench.cameras[0].write(Request.ARM)
    box.fire()
    assert [camera.run.state for camera in bench.cameras] == [State.RUNNING, State.IDLE]
    bench.now_s += 0.0101
    assert box.status() == BoxStatus(BoxState.PULSING, 2000, 6)
    parser = BlockParser()
    for _ in range(3):
        parser.feed(bench.cameras[0].stream.send(1 << 20, 1))
    assert [block.sync_pulses for block in iter(parser.next, None)] == [1, 3, 5]  # a block is 4 ms
    box.close()
    assert bench.model.status().state is BoxState.IDLE


def test_a_box_can_be_fired_again(bench):
    box = bench.open()
    box.fire()
    bench.now_s += 1
    box.fire()
    assert box.status().pulses == 1


def test_a_box_that_a_killed_program_left_pulsing_is_stopped_when_it_is_opened(bench):
    bench.open().fire()
    assert bench.model.status().state is BoxState.PULSING
    bench.open()
    assert bench.model.status().state is BoxState.IDLE


def test_a_command_that_does_not_fit_is_refused(bench):
    bench.open()
    for command in (COMMAND.pack(COMMAND_REPORT, kind, 0) for kind in (BoxCommand.FIRE, BoxCommand.PERIOD)):
        assert bench.hid.send_feature_report(command) == -1
    assert bench.model.status() == BoxStatus(BoxState.IDLE, 1000, 0)


def test_a_box_that_is_gone_says_so(bench):
    box = bench.open()
    bench.unplug()
    for call in (box.fire, box.status):
        with pytest.raises(DeviceError, match="trigger box: it is not connected any more"):
            call()
    box.close()


def test_a_status_that_is_not_ours_is_refused():
    status = BoxStatus(BoxState.ARMED, 7, 1 << 40)
    assert BoxStatus.decode(status.encode()) == status
    for data in (status.encode()[:-1], b"\x01NOPE" + status.encode()[5:], bytes(21)):
        with pytest.raises(DeviceError, match="trigger box: found"):
            BoxStatus.decode(data)


@pytest.mark.skipif(not usbip.is_available(), reason="no virtual host controller to plug a box into")
def test_the_box_that_is_connected_is_found():
    bench = UsbIpBench()
    box = find_box()
    assert box is not None
    assert box.status().state is BoxState.IDLE
    bench.close()
    box.close()
    assert find_box() is None


def test_without_a_box_none_is_found():
    assert find_box() is None
