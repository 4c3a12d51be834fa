import errno

import numpy as np
import pytest
import usb.core
import usb.util
from maintenance.trigger_line import TriggerWire

from acquisition.devices.device_model import DeviceModel
from acquisition.devices.mock import MockBackend
from acquisition.devices.profiles.direct import DIRECT
from acquisition.devices.registers import Request
from acquisition.spikes.layout import PlaneLayout

READ = 0xC0
COMMAND = 0x40


class Ones:
    layout = PlaneLayout(8, 4)

    def next_planes(self, count: int) -> np.ndarray:
        return np.full((count, 4), 255, dtype=np.uint8)


@pytest.fixture
def models() -> list[DeviceModel]:
    return [DeviceModel(serial, Ones(), 20_000) for serial in ("A1", "B2")]


@pytest.fixture
def backend(models) -> MockBackend:
    return MockBackend(models)


@pytest.fixture
def device(backend):
    found = usb.core.find(backend=backend, idVendor=DIRECT.vendor_id, idProduct=DIRECT.product_id)
    found.set_configuration()
    yield found
    usb.util.dispose_resources(found)


def test_pyusb_finds_the_cameras_and_their_strings(backend):
    found = list(usb.core.find(find_all=True, backend=backend, idVendor=DIRECT.vendor_id))
    assert [d.serial_number for d in found] == ["A1", "B2"]
    assert found[0].product == "simulated spike camera"
    assert found[0].speed == usb.util.SPEED_SUPER


def test_pyusb_walks_the_descriptors(device):
    [interface] = device.get_active_configuration()
    [endpoint] = interface
    assert (endpoint.bEndpointAddress, endpoint.wMaxPacketSize) == (DIRECT.stream_endpoint, 1024)
    assert "CONFIGURATION 1" in str(device)


def test_an_unconfigured_device_says_so(backend):
    with pytest.raises(usb.core.USBError, match="Configuration not set"):
        usb.core.find(backend=backend).get_active_configuration()


def test_a_read_without_data_times_out(device):
    with pytest.raises(usb.core.USBTimeoutError) as caught:
        device.read(DIRECT.stream_endpoint, 1024, timeout=1)
    assert (caught.value.errno, caught.value.backend_error_code) == (errno.ETIMEDOUT, -7)


def test_a_short_read_is_no_error(device, models):
    device.ctrl_transfer(COMMAND, Request.ARM)
    TriggerWire(models).fire()
    assert len(device.read(DIRECT.stream_endpoint, 1 << 20)) == 64 + 80 * 4 + 32


def test_a_halted_pipe_stalls_until_it_is_cleared(device, models):
    device.ctrl_transfer(COMMAND, Request.ARM)
    TriggerWire(models).fire()
    models[0].faults.halted = True
    for _ in range(2):
        with pytest.raises(usb.core.USBError) as caught:
            device.read(DIRECT.stream_endpoint, 1024)
        assert (caught.value.errno, caught.value.backend_error_code) == (errno.EPIPE, -9)
    device.clear_halt(DIRECT.stream_endpoint)
    assert len(device.read(DIRECT.stream_endpoint, 64)) == 64


@pytest.mark.parametrize(("kind", "request_code"), [(READ, 0x7F), (COMMAND, 0x7F), (0x80, 0x0C)])
def test_an_unknown_control_request_stalls_once(device, kind, request_code):
    with pytest.raises(usb.core.USBError) as caught:
        device.ctrl_transfer(kind, request_code, 0x0100, 0, 8 if kind & 0x80 else None)
    assert caught.value.errno == errno.EPIPE
    assert len(device.ctrl_transfer(READ, Request.STATUS, 0, 0, 32)) == 32


def test_an_unplugged_device_is_gone_for_ever(device, backend):
    backend.unplug("A1")
    for call in (
        lambda: device.read(DIRECT.stream_endpoint, 1024),
        lambda: device.ctrl_transfer(READ, Request.STATUS, 0, 0, 32),
        lambda: device.clear_halt(DIRECT.stream_endpoint),
        lambda: device.reset(),
    ):
        with pytest.raises(usb.core.USBError) as caught:
            call()
        assert (caught.value.errno, caught.value.backend_error_code) == (errno.ENODEV, -4)
    assert [d.serial_number for d in usb.core.find(find_all=True, backend=backend)] == ["B2"]


def test_a_claimed_interface_is_busy_for_others(device, backend):
    usb.util.claim_interface(device, 0)
    other = usb.core.find(backend=backend)
    with pytest.raises(usb.core.USBError) as caught:
        usb.util.claim_interface(other, 0)
    assert caught.value.errno == errno.EBUSY
    usb.util.dispose_resources(device)
    usb.util.claim_interface(other, 0)


def test_one_pulse_starts_every_armed_camera(models):
    models[0].command(Request.ARM)
    TriggerWire(models).fire()
    assert [m.state.name for m in models] == ["RUNNING", "IDLE"]
