"""Where on USB a kind of camera has what the driver needs: one driver, one profile for each way to build a camera."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Profile:
    """A kind of USB device. Blocks come from `stream_endpoint` of `interface`, `in_flight` transfers queued.

    Requests are vendor control requests, or, where `command_endpoint` is not 0, messages to it answered on
    `reply_endpoint`: both belong to `interface` too.
    """

    name: str
    vendor_id: int
    product_id: int
    interface: int
    stream_endpoint: int
    command_endpoint: int = 0
    reply_endpoint: int = 0
    transfer_bytes: int = 1 << 20
    in_flight: int = 8

    @property
    def queued_mb(self) -> float:
        """MB (2^20 bytes) of the kernel's memory that the transfers of one camera take."""
        return self.transfer_bytes * self.in_flight / (1 << 20)


VENDOR_ID = 0x1209  # pid.codes, an identifier open to projects like this one
DIRECT = Profile("direct", VENDOR_ID, 0x0001, interface=0, stream_endpoint=0x81)
# An FT600 or FT601 passes no vendor requests to what is behind its FIFO: its first channel carries them, its second
# the stream. The size and number of transfers are those of the maker's own library when it streams.
FT60X = Profile(
    "ft60x", 0x0403, 0x601F, 1, 0x83, command_endpoint=0x02, reply_endpoint=0x82, transfer_bytes=262_144, in_flight=16
)
PROFILES = (DIRECT, FT60X)


def profile_of(vendor_id: int, product_id: int) -> Profile | None:
    """The profile of a device by its identifiers; None for one that is no camera."""
    for profile in PROFILES:
        if (profile.vendor_id, profile.product_id) == (vendor_id, product_id):
            return profile
    return None
