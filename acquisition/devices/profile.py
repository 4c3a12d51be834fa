"""Describes where a kind of camera has on USB what the driver needs; `profiles/` holds one file for each kind."""

from collections.abc import Mapping
from dataclasses import dataclass

from acquisition.members import members

VENDOR_ID = 0x1209  # pid.codes, an identifier open to projects like this one


@dataclass(frozen=True)
class Profile:
    """A kind of USB device, told by its vendor and product.

    Blocks come from `stream_endpoint` of `interface`, with `in_flight` transfers of `transfer_bytes` queued. Requests
    are vendor control requests, or, where `command_endpoint` is not 0, messages to that endpoint of the same interface,
    which are answered on `reply_endpoint`.
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
        """Return the MB (2^20 bytes) of the kernel's memory that the queued transfers of one camera take."""
        return self.transfer_bytes * self.in_flight / (1 << 20)


def profiles() -> Mapping[str, Profile]:
    """Return every profile by its name."""
    return members("acquisition.devices.profiles", Profile)
