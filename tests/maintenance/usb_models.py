"""Simulated cameras and trigger boxes as a kernel's USB stack sees them: their descriptors, and requests in bytes."""

from __future__ import annotations

import struct
import time

from acquisition.devices import descriptors
from acquisition.devices.box_model import BoxModel
from acquisition.devices.control_channel import StallError
from acquisition.devices.descriptors import CONFIGURATION, DEVICE, MAX_PACKET_BYTES, STRING, Fields
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.profile import VENDOR_ID, Profile
from acquisition.devices.profiles.direct import DIRECT
from acquisition.devices.trigger_box import (
    BOX_PRODUCT_ID,
    COMMAND_BYTES,
    COMMAND_REPORT,
    STATUS_BYTES,
    STATUS_REPORT,
)

BOS = 15
BULK, INTERRUPT = 2, 3
_ENDPOINT_BYTES = 7 + 6  # an endpoint's descriptor and the SuperSpeed companion behind it
_COMPANIONS = {
    BULK: bytes((6, 0x30, 15, 0, 0, 0)),  # bursts of 16 packets
    INTERRUPT: bytes((6, 0x30, 0, 0, 0, 4)),  # 1,024 B an interval
}
_SUPER_SPEED_BOS = (
    struct.pack("<BBHB", 5, BOS, 22, 2)
    + struct.pack("<BBBI", 7, 16, 2, 0)  # USB 2.0 extension, no power saving
    + struct.pack("<BBBBHBBH", 10, 16, 3, 0, 0x0E, 3, 0, 0)  # full speed and up; all functions at SuperSpeed
)
_STRINGS = ("", "spike4dgs", "simulated trigger box")
_GET_DESCRIPTOR, _GET_REPORT, _SET_REPORT, _SET_IDLE, _CLEAR_FEATURE = 0x06, 0x01, 0x09, 0x0A, 0x01
_IN, _TO_ENDPOINT, _FROM_INTERFACE, _CLASS_IN, _CLASS_OUT = 0x80, 0x02, 0x81, 0xA1, 0x21
_HID_REPORT, _FEATURE = 0x22, 3
_REPORTS = (
    bytes.fromhex("0600ff 0901 a101 1500 26ff00 7508")  # a vendor's own collection of bytes
    + b"".join(
        bytes((0x85, number, 0x95, size - 1, 0x09, number, 0xB1, 2))  # a feature of so many bytes
        for number, size in ((STATUS_REPORT, STATUS_BYTES), (COMMAND_REPORT, COMMAND_BYTES))
    )
    + b"\xc0"
)
_BOX_DEVICE = {
    **descriptors.device(DIRECT),
    "bcdUSB": 0x0200,
    "bDeviceClass": 0,
    "bMaxPacketSize0": 64,
    "idVendor": VENDOR_ID,
    "idProduct": BOX_PRODUCT_ID,
}
_BOX_CONFIGURATION = b"".join(
    (
        struct.pack("<BBHBBBBB", 9, CONFIGURATION, 9 + 9 + 9 + 7, 1, 1, 0, 0x80, 50),
        bytes((9, 4, 0, 0, 1, 3, 0, 0, 0)),
        struct.pack("<BBHBBBH", 9, 0x21, 0x0111, 0, 1, _HID_REPORT, len(_REPORTS)),
        struct.pack("<BBBBHB", 7, 5, 0x81, 3, 8, 8),  # every HID device has an interrupt pipe; this one is silent
    )
)


def encode_fields(fields: Fields) -> bytes:
    """Return a descriptor's bytes: fields named `w`, `id` and `bcd` have two, the others one."""
    wide = ("w", "id", "bcd")
    return b"".join(value.to_bytes(2 if name.startswith(wide) else 1, "little") for name, value in fields.items())


def encode_configuration(profile: Profile) -> bytes:
    """Return a camera's configuration with its interfaces and endpoints, as one descriptor."""
    parts = [encode_fields(configuration(profile))]
    for fields, endpoints in interfaces(profile):
        parts.append(encode_fields(fields))
        parts += [encode_fields(each) + _COMPANIONS[each["bmAttributes"]] for each in endpoints]
    return b"".join(parts)


def interfaces(profile: Profile) -> list[tuple[Fields, list[Fields]]]:
    """Return each interface with its endpoints; those before the camera's own are a bridge's, which nobody talks to."""
    pipes = [endpoint for endpoint in (profile.command_endpoint, profile.reply_endpoint) if endpoint]
    found = [_interface(0, [_endpoint(0x01, BULK), _endpoint(0x81, INTERRUPT)])] if profile.interface else []
    own = [_endpoint(address, BULK) for address in (*pipes, profile.stream_endpoint)]
    return [*found, _interface(profile.interface, own)]


def configuration(profile: Profile) -> Fields:
    """Return the only configuration."""
    found = interfaces(profile)
    size = 9 + sum(9 + len(endpoints) * _ENDPOINT_BYTES for _, endpoints in found)
    return {**descriptors.CONFIGURATION_FIELDS, "wTotalLength": size, "bNumInterfaces": len(found)}


def _interface(number: int, endpoints: list[Fields]) -> tuple[Fields, list[Fields]]:
    fields = {
        "bLength": 9,
        "bDescriptorType": 4,
        "bInterfaceNumber": number,
        "bAlternateSetting": 0,
        "bNumEndpoints": len(endpoints),
        "bInterfaceClass": 0xFF,
        "bInterfaceSubClass": 0,
        "bInterfaceProtocol": 0,
        "iInterface": 0,
    }
    return fields, endpoints


def _endpoint(address: int, transfers: int) -> Fields:
    return {
        "bLength": 7,
        "bDescriptorType": 5,
        "bEndpointAddress": address,
        "bmAttributes": transfers,
        "wMaxPacketSize": MAX_PACKET_BYTES,
        "bInterval": 9 if transfers == INTERRUPT else 0,
    }


class CameraOnUsb:
    """A simulated camera below a kernel's USB stack."""

    def __init__(self, model: DeviceModel):
        self.model, self.stream_endpoint = model, model.profile.stream_endpoint
        self.stream, self.wake = model.stream.send, model.run.wake
        self.take, self.give = model.messages.take, model.messages.give

    def control(self, kind: int, request: int, value: int, index: int, data: bytes = b"") -> bytes:
        """Answer a control request; raises StallError for one the camera does not know."""
        if (kind, request, value, index) == (_TO_ENDPOINT, _CLEAR_FEATURE, 0, self.stream_endpoint):
            self.model.stream.halted = False
            return b""
        profile, known = self.model.profile, (DEVICE, CONFIGURATION, BOS)
        if kind == _IN and request == _GET_DESCRIPTOR and value >> 8 in known:
            encoded = encode_fields(descriptors.device(profile)), encode_configuration(profile), _SUPER_SPEED_BOS
            return dict(zip(known, encoded, strict=True))[value >> 8]
        return self.model.control(kind, request, value, data)


class BoxOnUsb:
    """A simulated trigger box below a kernel's HID stack."""

    stream_endpoint = 0x81

    def __init__(self, model: BoxModel):
        self.model = model

    def control(self, kind: int, request: int, value: int, index: int, data: bytes = b"") -> bytes:
        """Answer a control request; raises StallError for one the box does not know."""
        high, low = value >> 8, value & 0xFF
        if kind == _IN and request == _GET_DESCRIPTOR:
            return self._descriptor(high, low)
        if (kind, request, high) == (_FROM_INTERFACE, _GET_DESCRIPTOR, _HID_REPORT):
            return _REPORTS
        if (kind, request) == (_CLASS_OUT, _SET_IDLE):
            return b""
        if (kind, request, high, low) == (_CLASS_IN, _GET_REPORT, _FEATURE, STATUS_REPORT):
            return self.model.status().encode()
        if (kind, request, high, low) == (_CLASS_OUT, _SET_REPORT, _FEATURE, COMMAND_REPORT):
            self.model.command(data)
            return b""
        raise StallError

    def stream(self, size: int, timeout_s: float) -> memoryview:
        """Say nothing."""
        time.sleep(timeout_s)
        return memoryview(b"")

    def take(self, endpoint: int, data: bytes) -> None:
        """Raise StallError: there is no pipe to write to."""
        raise StallError

    def give(self, endpoint: int) -> bytes:
        """Raise StallError: there is no other pipe to read from."""
        raise StallError

    def wake(self) -> None:
        """Do nothing: nobody waits for long."""

    def _descriptor(self, kind: int, number: int) -> bytes:
        strings = (*_STRINGS, self.model.serial)
        if kind == STRING and number < len(strings):
            return descriptors.encode_string(number, strings)
        encoded = {DEVICE: encode_fields(_BOX_DEVICE), CONFIGURATION: _BOX_CONFIGURATION}
        if kind not in encoded:
            raise StallError
        return encoded[kind]
