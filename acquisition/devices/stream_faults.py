"""The ways in which a simulated camera's stream goes wrong."""

from __future__ import annotations

from acquisition.devices.registers import LinkCounters


class StreamFaults:
    """Faults of one camera's stream: a stalled pipe, a camera that hangs, damaged bits, a noisy link."""

    def __init__(self) -> None:
        self.halted = False  # the pipe is stalled until the host clears it
        self.link_per_block = LinkCounters()  # what each block adds to the LINK register
        self._held_after: int | None = None
        self._to_flip: list[int] = []

    @property
    def hangs(self) -> bool:
        """Return whether not a byte more may be sent."""
        return self._held_after == 0

    def hold(self, after_bytes: int | None) -> None:
        """Have the camera send `after_bytes` more and then hang, in the middle of whatever it is; None: go on."""
        self._held_after = after_bytes

    def flip_bit(self, byte: int) -> None:
        """Damage a bit of byte `byte` of the next block on its way."""
        self._to_flip.append(byte)

    def power_up(self) -> None:
        """End what ends with a reset."""
        self.halted, self._held_after = False, None

    def cut(self, data: memoryview) -> memoryview:
        """Return as much of `data` as is sent before the camera hangs."""
        if self._held_after is None:
            return data
        data = data[: self._held_after]
        self._held_after -= len(data)
        return data

    def damage(self, block: bytes) -> bytes:
        """Return the block with the bits flipped that were asked for."""
        if not self._to_flip:
            return block
        damaged = bytearray(block)
        while self._to_flip:
            damaged[self._to_flip.pop()] ^= 16
        return bytes(damaged)
