"""The USB descriptors of simulated devices: fields for the mock's pyusb backend, bytes for a real kernel."""

from __future__ import annotations

import struct

from acquisition.devices.profile import Profile

Fields = dict[str, int]
MAX_PACKET_BYTES = 1024  # of a SuperSpeed bulk pipe
LANGUAGE_ID = 0x0409
DEVICE, CONFIGURATION, STRING, BOS = 1, 2, 3, 15
_BULK, _INTERRUPT = 2, 3
_COMPANIONS = {
    _BULK: bytes((6, 0x30, 15, 0, 0, 0)),  # bursts of 16 packets
    _INTERRUPT: bytes((6, 0x30, 0, 0, 0, 4)),  # 1,024 B an interval
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


def device(profile: Profile) -> Fields:
    """The device descriptor of a camera of this profile."""
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
    """Each interface with its endpoints; those before the camera's own are a bridge's, which nobody here talks to."""
    pipes = [endpoint for endpoint in (profile.command_endpoint, profile.reply_endpoint) if endpoint]
    found = [_interface(0, [_endpoint(0x01, _BULK), _endpoint(0x81, _INTERRUPT)])] if profile.interface else []
    own = [_endpoint(address, _BULK) for address in (*pipes, profile.stream_endpoint)]
    return [*found, _interface(profile.interface, own)]


def configuration(profile: Profile) -> Fields:
    """The only configuration."""
    return {
        "bLength": 9,
        "bDescriptorType": CONFIGURATION,
        "wTotalLength": 9 + len(_body(profile)),
        "bNumInterfaces": len(interfaces(profile)),
        "bConfigurationValue": 1,
        "iConfiguration": 0,
        "bmAttributes": 0x80,
        "bMaxPower": 112,
    }


def descriptor(profile: Profile, strings: tuple[str, ...], kind: int, number: int) -> bytes | None:
    """What a camera answers when it is asked for descriptor `number` of `kind`; None for one it has not."""
    if kind == STRING:
        return encode_string(number, strings) if number < len(strings) else None
    if kind == CONFIGURATION:
        return encode_fields(configuration(profile)) + _body(profile)
    return {DEVICE: encode_fields(device(profile)), BOS: SUPER_SPEED_BOS}.get(kind)


def _body(profile: Profile) -> bytes:
    parts = []
    for fields, endpoints in interfaces(profile):
        parts += [
            encode_fields(fields),
            *(encode_fields(each) + _COMPANIONS[each["bmAttributes"]] for each in endpoints),
        ]
    return b"".join(parts)


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
        "bInterval": 9 if transfers == _INTERRUPT else 0,
    }
