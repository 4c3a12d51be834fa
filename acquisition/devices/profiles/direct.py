"""A camera with a USB interface of its own, which answers vendor requests."""

from acquisition.devices.profile import VENDOR_ID, Profile

DIRECT = Profile("direct", VENDOR_ID, 0x0001, interface=0, stream_endpoint=0x81)
