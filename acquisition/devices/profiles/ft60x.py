"""A sensor behind the FIFO of an FTDI FT600 or FT601 bridge, which passes no vendor requests on.

The bridge's first channel carries requests as messages, its second the stream. The size and number of queued transfers
are those that the maker's own library uses when it streams.
"""

from acquisition.devices.profile import Profile

FT60X = Profile(
    "ft60x", 0x0403, 0x601F, 1, 0x83, command_endpoint=0x02, reply_endpoint=0x82, transfer_bytes=262_144, in_flight=16
)
