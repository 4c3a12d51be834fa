"""The stream of a simulated camera: the blocks it makes of its planes, and the bytes it sends of them."""

from dataclasses import dataclass, field, replace

from acquisition.devices.control_channel import StallError
from acquisition.devices.device_run import DeviceRun
from acquisition.devices.protocol import Block, BlockStatus, encode_block
from acquisition.devices.registers import Geometry, LinkCounters, State
from acquisition.spikes.source import PlaneSource

_BLOCK_PLANES, _BLOCK_BYTES = 80, 1_000_000
_POLL_S = 0.002


@dataclass
class StreamFaults:
    """Faults of one camera's stream.

    While `halted`, the pipe is stalled. After `hangs_after` bytes more the camera sends nothing, in the middle of
    whatever it is. Of each byte in `flipped` of the next block a bit is damaged. Each block adds `link_per_block` to
    the LINK register.
    """

    halted: bool = False
    hangs_after: int | None = None
    flipped: list[int] = field(default_factory=list)
    link_per_block: LinkCounters = field(default_factory=LinkCounters)


class DeviceStream:
    """Makes blocks of the planes of `source`, which is asked only as fast as the host reads, unless `run` is paced."""

    def __init__(self, run: DeviceRun, source: PlaneSource, faults: StreamFaults):
        self.source = source
        self.geometry = Geometry(source.layout, max(1, min(_BLOCK_PLANES, _BLOCK_BYTES // source.layout.plane_bytes)))
        self._run, self._faults = run, faults
        self._outgoing = memoryview(b"")

    def forget(self) -> None:
        """Drop what was not sent."""
        self._outgoing = memoryview(b"")

    def send(self, size: int, timeout_s: float) -> memoryview:
        """Return at most `size` bytes, up to the end of a block; none where there are none within `timeout_s`.

        Raises StallError while the pipe is halted.
        """
        run, faults = self._run, self._faults
        run.join_pulses()
        if not faults.halted and self._is_silent():
            with run.changed:
                run.changed.wait(timeout_s)
        if faults.halted:
            raise StallError
        if self._is_silent():
            return memoryview(b"")
        if not self._outgoing:
            block = self.next_block()
            with run.changed:
                if not block:
                    run.changed.wait(min(timeout_s, _POLL_S) if run.pace else timeout_s)
                if run.state is State.RUNNING:
                    self._outgoing = memoryview(block)
        if faults.hangs_after is not None:
            size = min(size, faults.hangs_after)
            faults.hangs_after -= min(size, len(self._outgoing))
        taken = self._outgoing[:size]
        self._outgoing = self._outgoing[len(taken) :]
        return taken

    def next_block(self) -> bytes:
        """Return the next block as it travels, empty where its planes have not come or there are no more."""
        run, count, lost = self._run, self.geometry.planes_per_block, 0
        if run.pace:
            due = run.due_planes(run.pace)
            late = due - run.pace.memory_planes
            lost = len(self.source.next_planes(late)) if late > 0 else 0
            run.dropped_planes += lost
            run.emitted_planes += lost
            run.link = replace(run.link, overruns=run.link.overruns + (lost > 0))
            if due - lost < count:
                return b""
        packed = self.source.next_planes(count)
        if not len(packed):
            return b""
        run.count_pulses()
        status = BlockStatus.OVERRUN | BlockStatus.DISCARDED if lost else BlockStatus(0)
        status |= BlockStatus(0) if run.sync_pulses else BlockStatus.TRIGGER_MISSED
        found = run.emitted_blocks, run.emitted_planes, run.device_time_ns(), self.geometry.layout, packed
        block = Block(*found, run.sync_pulses, run.dropped_planes, status, run.pulse_age_ns())
        run.emitted_blocks += 1
        run.emitted_planes += len(packed)
        run.link = run.link.plus(self._faults.link_per_block)
        return self._damaged(encode_block(block))

    def _is_silent(self) -> bool:
        return self._faults.hangs_after == 0 or self._run.state is not State.RUNNING

    def _damaged(self, block: bytes) -> bytes:
        if not self._faults.flipped:
            return block
        damaged = bytearray(block)
        while self._faults.flipped:
            damaged[self._faults.flipped.pop()] ^= 16
        return bytes(damaged)
