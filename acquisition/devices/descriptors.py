"""The USB descriptors of simulated devices, as fields for a pyusb backend."""

import struct

from acquisition.devices.profile import Profile

Fields = dict[str, int]
MAX_PACKET_BYTES = 1024  # the packet of a SuperSpeed bulk pipe
LANGUAGE_ID = 0x0409
DEVICE, CONFIGURATION, STRING = 1, 2, 3
CONFIGURATION_FIELDS: Fields = {
    "bLength": 9,
    "bDescriptorType": CONFIGURATION,
    "wTotalLength": 9,
    "bNumInterfaces": 1,
    "bConfigurationValue": 1,
    "iConfiguration": 0,
    "bmAttributes": 0x80,
    "bMaxPower": 112,
}


def encode_string(number: int, strings: tuple[str, ...]) -> bytes:
    """Return string descriptor `number`; 0 lists the languages."""
    body = struct.pack("<H", LANGUAGE_ID) if number == 0 else strings[number].encode("utf-16-le")
    return bytes((len(body) + 2, STRING)) + body


def device(profile: Profile) -> Fields:
    """Return the device descriptor of a camera of this profile."""
    return {
        "bLength": 18,
        "bDescriptorType": DEVICE,
        "bcdUSB": 0x0300,
        "bDeviceClass": 0xFF,
        "bDeviceSubClass": 0,
        "bDeviceProtocol": 0,
        "bMaxPacketSize0": 9,
        "idVendor": profile.vendor_id,
        "idProduct": profile.product_id,
        "bcdDevice": 0x0100,
        "iManufacturer": 1,
        "iProduct": 2,
        "iSerialNumber": 3,
        "bNumConfigurations": 1,
    }
