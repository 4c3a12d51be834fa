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


@pytest.mark.parametrize(("kind", "request_code"), [(READ, 0x7F), (COMMAND, 0x7F), (0x80, 0x0C)])
def test_an_unknown_control_request_stalls_once(device, kind, request_code):
    with pytest.raises(usb.core.USBError) as caught:
        device.ctrl_transfer(kind, request_code, 0x0100, 0, 8 if kind & 0x80 else None)
    assert caught.value.errno == errno.EPIPE
    assert len(device.ctrl_transfer(READ, Request.STATUS, 0, 0, 32)) == 32


def test_an_unplugged_device_is_gone_for_ever(device, backend):
    pipe = backend.open_stream(device)
    backend.unplug("A1")
    for call in (
        lambda: device.ctrl_transfer(READ, Request.STATUS, 0, 0, 32),
        pipe.submit,
        pipe.clear_halt,
        lambda: device.reset(),
    ):
        with pytest.raises(usb.core.USBError) as caught:
            call()
        assert (caught.value.errno, caught.value.backend_error_code) == (errno.ENODEV, -4)
    assert [d.serial_number for d in usb.core.find(find_all=True, backend=backend)] == ["B2"]


def test_one_pulse_starts_every_armed_camera(models):
    models[0].write(Request.ARM)
    TriggerWire(models).fire()
    assert [m.run.state.name for m in models] == ["RUNNING", "IDLE"]
