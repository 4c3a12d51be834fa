"""The USB descriptors of simulated devices: fields for the mock's pyusb backend, bytes for a real kernel."""

from __future__ import annotations

import struct

from acquisition.devices.registers import PRODUCT_ID, STREAM_ENDPOINT, VENDOR_ID

Fields = dict[str, int]
MAX_PACKET_BYTES = 1024  # of a SuperSpeed bulk pipe
LANGUAGE_ID = 0x0409
DEVICE, CONFIGURATION, STRING, BOS = 1, 2, 3, 15
COMPANION = bytes((6, 0x30, 15, 0, 0, 0))  # bursts of 16 packets

CAMERA_DEVICE: Fields = {
    "bLength": 18,
    "bDescriptorType": DEVICE,
    "bcdUSB": 0x0300,
    "bDeviceClass": 0xFF,
    "bDeviceSubClass": 0,
    "bDeviceProtocol": 0,
    "bMaxPacketSize0": 9,
    "idVendor": VENDOR_ID,
    "idProduct": PRODUCT_ID,
    "bcdDevice": 0x0100,
    "iManufacturer": 1,
    "iProduct": 2,
    "iSerialNumber": 3,
    "bNumConfigurations": 1,
}
CAMERA_CONFIGURATION: Fields = {
    "bLength": 9,
    "bDescriptorType": CONFIGURATION,
    "wTotalLength": 9 + 9 + 7 + len(COMPANION),
    "bNumInterfaces": 1,
    "bConfigurationValue": 1,
    "iConfiguration": 0,
    "bmAttributes": 0x80,
    "bMaxPower": 112,
}
CAMERA_INTERFACE: Fields = {
    "bLength": 9,
    "bDescriptorType": 4,
    "bInterfaceNumber": 0,
    "bAlternateSetting": 0,
    "bNumEndpoints": 1,
    "bInterfaceClass": 0xFF,
    "bInterfaceSubClass": 0,
    "bInterfaceProtocol": 0,
    "iInterface": 0,
}
CAMERA_ENDPOINT: Fields = {
    "bLength": 7,
    "bDescriptorType": 5,
    "bEndpointAddress": STREAM_ENDPOINT,
    "bmAttributes": 2,
    "wMaxPacketSize": MAX_PACKET_BYTES,
    "bInterval": 0,
}
SUPER_SPEED_BOS = (
    struct.pack("<BBHB", 5, BOS, 22, 2)
    + struct.pack("<BBBI", 7, 16, 2, 0)  # USB 2.0 extension, no power saving
    + struct.pack("<BBBBHBBH", 10, 16, 3, 0, 0x0E, 3, 0, 0)  # full speed and up; all functions at SuperSpeed
)


def encode_fields(fields: Fields) -> bytes:
    """A descriptor's bytes: fields named `w`, `id` and `bcd` have two, the others one."""
    wide = ("w", "id", "bcd")
    return b"".join(value.to_bytes(2 if name.startswith(wide) else 1, "little") for name, value in fields.items())


def encode_string(number: int, strings: tuple[str, ...]) -> bytes:
    """String descriptor `number`; 0 lists the languages."""
    body = struct.pack("<H", LANGUAGE_ID) if number == 0 else strings[number].encode("utf-16-le")
    return bytes((len(body) + 2, STRING)) + body


CAMERA_CONFIGURATION_BYTES = (
    b"".join(map(encode_fields, (CAMERA_CONFIGURATION, CAMERA_INTERFACE, CAMERA_ENDPOINT))) + COMPANION
)
