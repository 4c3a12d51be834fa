"""The stream of a simulated camera: the blocks it makes of its planes, and the bytes it sends of them."""

from acquisition.devices.control_channel import StallError
from acquisition.devices.device_run import DeviceRun
from acquisition.devices.protocol import Block, BlockStatus, encode_block
from acquisition.devices.registers import Geometry, LinkCounters, State
from acquisition.recording.manifest import block_planes_of
from acquisition.scenes.source import Source


class DeviceStream:
    """Makes blocks of the planes of `source`, which is asked only as fast as the host reads.

    While `halted`, the pipe is stalled. Each block adds `link_per_block` to the LINK register.
    """

    def __init__(self, run: DeviceRun, source: Source):
        self.source, self.geometry = source, Geometry(source.layout, block_planes_of(source.layout))
        self.halted, self.link_per_block = False, LinkCounters()
        self._run = run
        self._outgoing = memoryview(b"")

    def forget(self) -> None:
        """Drop what was not sent."""
        self._outgoing = memoryview(b"")

    def send(self, size: int, timeout_s: float) -> memoryview:
        """Return at most `size` bytes, up to the end of a block; none where there are none within `timeout_s`.

        Raises StallError while the pipe is halted.
        """
        run = self._run
        if not self.halted and run.state is not State.RUNNING:
            with run.changed:
                run.changed.wait(timeout_s)
        if self.halted:
            raise StallError
        if run.state is not State.RUNNING:
            return memoryview(b"")
        if not self._outgoing:
            block = self.next_block()
            with run.changed:
                if not block:
                    run.changed.wait(timeout_s)
                if run.state is State.RUNNING:
                    self._outgoing = memoryview(block)
        taken = self._outgoing[:size]
        self._outgoing = self._outgoing[len(taken) :]
        return taken

    def next_block(self) -> bytes:
        """Return the next block as it travels, empty where there are no more planes."""
        run, packed = self._run, self.source.next_planes(self.geometry.planes_per_block)
        if not len(packed):
            return b""
        run.count_pulses()
        status = BlockStatus(0) if run.sync_pulses else BlockStatus.TRIGGER_MISSED
        found = run.emitted_blocks, run.emitted_planes, run.device_time_ns(), self.geometry.layout, packed
        block = Block(*found, run.sync_pulses, run.dropped_planes, status, run.pulse_age_ns())
        run.emitted_blocks += 1
        run.emitted_planes += len(packed)
        run.link = run.link.plus(self.link_per_block)
        return encode_block(block)
