"""The USB descriptors of simulated devices, as fields for a pyusb backend."""

import struct

from acquisition.devices.profile import Profile

Fields = dict[str, int]
MAX_PACKET_BYTES = 1024  # the packet of a SuperSpeed bulk pipe
LANGUAGE_ID = 0x0409
DEVICE, CONFIGURATION, STRING = 1, 2, 3
BULK, INTERRUPT = 2, 3
_ENDPOINT_BYTES = 7 + 6  # an endpoint's descriptor and the SuperSpeed companion behind it


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


def interfaces(profile: Profile) -> list[tuple[Fields, list[Fields]]]:
    """Return each interface with its endpoints; those before the camera's own are a bridge's, which nobody talks to."""
    pipes = [endpoint for endpoint in (profile.command_endpoint, profile.reply_endpoint) if endpoint]
    found = [_interface(0, [_endpoint(0x01, BULK), _endpoint(0x81, INTERRUPT)])] if profile.interface else []
    own = [_endpoint(address, BULK) for address in (*pipes, profile.stream_endpoint)]
    return [*found, _interface(profile.interface, own)]


def configuration(profile: Profile) -> Fields:
    """Return the only configuration."""
    found = interfaces(profile)
    return {
        "bLength": 9,
        "bDescriptorType": CONFIGURATION,
        "wTotalLength": 9 + sum(9 + len(endpoints) * _ENDPOINT_BYTES for _, endpoints in found),
        "bNumInterfaces": len(found),
        "bConfigurationValue": 1,
        "iConfiguration": 0,
        "bmAttributes": 0x80,
        "bMaxPower": 112,
    }


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
