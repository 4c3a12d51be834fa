"""One camera on its way to its file: what it offers is written or counted as lost, and it is never held up."""

from __future__ import annotations

import dataclasses
import math
import threading
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from acquisition.devices.protocol import Block
from acquisition.errors import DeviceError, DiskError
from acquisition.recording.manifest import Gap, Layer, Trigger
from acquisition.recording.stream_writer import StreamWriter
from acquisition.session.contact import AskedCamera, Contact, Recovery
from acquisition.spikes.layout import PlaneLayout

READ_TIMEOUT_S = 1.0
SILENT_READS = 5  # so many reads without a byte are a camera that has stopped sending
REPEATED_BLOCKS = 64  # a block so far back was sent twice; one from further back is a camera that began anew
LONGEST_GAP_S = 60.0  # more planes lost at once are a counter that cannot be believed
_SPARE_S = 0.25  # held beside the pre-trigger's span: the cameras are not read at the same instant


class SessionCamera(Protocol):
    """What a session needs of a camera; `acquisition.devices.usb.UsbCamera` is one."""

    id: str
    layout: PlaneLayout

    def arm(self) -> None:
        """Get ready for the trigger, and confirm it."""
        ...

    def read_block(self, timeout_s: float) -> Block | None:
        """The next whole block, or None."""
        ...

    def ensure_stopped(self) -> None:
        """Stop sending, whatever it was doing."""
        ...


@dataclass(frozen=True)
class CaptureRules:
    """What holds for every camera of a run.

    `waits`: the cameras wait for the host (simulated ones), so a full ring holds them up instead of losing planes.
    `pre_planes`: keep so many planes until the run is saved; None records from the first plane.
    `recovery`: a camera that fails is looked for, and recorded on; None leaves it.
    """

    tick_rate_hz: float
    trigger: Trigger
    waits: bool = False
    pre_planes: int | None = None
    recovery: Recovery | None = None


@dataclass(frozen=True, eq=False)
class _Held:
    """Planes [n, B] not yet given to the ring, or only their number and the layer that lost them.

    `lost` planes were missing before them, of which the device says it dropped `dropped`.
    """

    first_plane: int
    planes: int
    packed: NDArray[np.uint8]
    lost: int
    dropped: int
    layer: Layer | None = None


class Capture:
    """One camera and its file: `run` in a thread of its own, `begin_at` and `end_at` from the one that watches.

    Planes are counted as the camera counts them: `position` is the next one expected of it, [first, end) are recorded.
    """

    def __init__(self, camera: SessionCamera, writer: StreamWriter, rules: CaptureRules):
        self.camera = camera
        self.writer = writer
        self.position = 0
        self.repeated_blocks = 0
        self.failure: DeviceError | None = None
        self.stamps: list[tuple[int, float]] = []  # pulses counted since the trigger, and when the last of them came
        self.stamped_until_s = 0.0  # a pulse before it, on the camera's clock, would be among them
        self.contact = Contact(camera) if isinstance(camera, AskedCamera) else None
        self.returned: list[str] = []  # where it was away and came back
        self._began_again = 0  # where the camera's plane 0 lies since then
        self._rules = rules
        self._first: int | None = None
        self._end: float = math.inf
        self._dropped = 0
        self._held: deque[_Held] = deque()
        self._held_planes = 0
        spare = round(_SPARE_S * rules.tick_rate_hz)
        self._may_hold = 0 if rules.pre_planes is None else rules.pre_planes + spare

    @property
    def lost(self) -> int:
        """Planes lost so far."""
        return sum(gap.planes for gap in self.writer.gaps)

    def begin_at(self, plane: int) -> None:
        """Record from `plane` on, which may be one that is held."""
        self._first = plane

    def end_at(self, plane: int) -> None:
        """Record up to but without `plane`, or less where an earlier end is set."""
        self._end = min(self._end, plane)

    def run(self, stop: threading.Event) -> None:
        """Read and write until all planes are there or `stop` is set; a camera's failure ends its own run only."""
        while not self.failure:
            try:
                self._read(stop)
                break
            except DeviceError as error:
                if not self._found_again(stop):
                    self.failure = error
        while self._first is not None and self._held:
            self._give(self._held[0], wait=True)
            self._let_go(self._held.popleft())
        self.writer.close_keeping()

    def _read(self, stop: threading.Event) -> None:
        """Take blocks until all planes are there or `stop` is set; raises DeviceError."""
        silent_reads = 0
        while not stop.is_set() and self.position < self._end:
            block = self.camera.read_block(READ_TIMEOUT_S)
            silent_reads = 0 if block else silent_reads + 1
            if silent_reads == SILENT_READS:
                found = f"found no data for {SILENT_READS} reads after {self.position} planes"
                raise DeviceError(f"{found}", "blocks", "check its cable and trigger", where=self.camera.id)
            if block:
                self._receive(self._placed(block))
                self._pass_on()
                if self.contact:
                    self.contact.count_block()

    def _found_again(self, stop: threading.Event) -> bool:
        """Wait for a camera that was lost; where it came back, its planes go on where they belong."""
        contact, recovery, rate_hz = self.contact, self._rules.recovery, self._rules.tick_rate_hz
        if not (contact and recovery and recovery.seconds > 0):
            return False

        def is_over() -> bool:
            run_s = contact.run_s(recovery.clock())
            return run_s is not None and run_s * rate_hz >= self._end

        found = contact.find_again(recovery, stop, is_over)
        if found is None or round(found.run_s * rate_hz) < self.position:
            return False
        self._began_again, self._dropped = round(found.run_s * rate_hz), 0
        where = f"{self.camera.id} was away from plane {self.position - (self._first or 0)} on and came back"
        sure = f"placed to {found.uncertainty_s * rate_hz:.1f} planes" if found.uncertainty_s else "placed by a pulse"
        self.returned.append(f"{where} at plane {self._began_again - (self._first or 0)}, {sure}")
        return True

    def _placed(self, block: Block) -> Block:
        again = self._began_again
        return dataclasses.replace(block, first_plane=block.first_plane + again) if again else block

    def _receive(self, block: Block) -> None:
        if block.layout != self.writer.layout:
            found = f"found planes of {block.layout}, expected {self.writer.layout}"
            raise DeviceError(f"{found}", do="reconnect it", where=self.camera.id)
        planes, lost = len(block.packed), block.first_plane - self.position
        if -REPEATED_BLOCKS * planes <= lost < 0:
            self.repeated_blocks += 1
            return
        if lost < 0 or lost > LONGEST_GAP_S * self._rules.tick_rate_hz:
            found = f"found plane {block.first_plane}, expected {self.position}"
            raise DeviceError(
                f"{found}", do="its counter began anew or cannot be right, reconnect it", where=self.camera.id
            )
        if self.position == 0 and self._rules.trigger == "line":
            self.writer.skew_s = block.device_time_ns * 1e-9 - block.first_plane / self._rules.tick_rate_hz
        if not self.returned:
            self.stamped_until_s = block.device_time_ns * 1e-9
        if block.pulse_time_s is not None and not self.returned:
            self.stamps.append((block.sync_pulses - 1, block.pulse_time_s))
        dropped = max(0, block.dropped_planes - self._dropped)
        self._dropped = block.dropped_planes
        self._held.append(_Held(block.first_plane, planes, block.packed, lost, dropped))
        self._held_planes += planes
        self.position = block.first_plane + planes

    def _pass_on(self) -> None:
        """Give the ring what it takes; what it does not take is held as far as a pre-trigger allows, or lost."""
        if self._first is None:
            while self._held and self._held_planes - self._held[0].planes > self._may_hold:
                self._let_go(self._held.popleft())
            return
        while self._held and self._give(self._held[0], wait=self._rules.waits):
            self._let_go(self._held.popleft())
        if self._held_planes > self._may_hold:
            newest = self._held.pop()
            self._let_go(newest)
            none = newest.packed[:0]
            self._held.append(dataclasses.replace(newest, packed=none, layer=self.writer.refusing))
            if len(self._held) == 1:
                self._give(self._held.popleft(), wait=False)

    def _let_go(self, held: _Held) -> None:
        self._held_planes -= 0 if held.layer else held.planes

    def _give(self, held: _Held, *, wait: bool) -> bool:
        """Write what lies in [first, end), gaps before it included; False where the ring has no room for the planes."""
        first = self._first or 0
        begin, end = first + self.writer.planes, min(self._end, held.first_plane + held.planes)
        missing = int(min(held.first_plane, end)) - begin
        if missing > 0:
            on_the_way = min(missing, held.lost)
            at = self.writer.planes
            forgotten = [Gap(at, missing - on_the_way, "ring")] if missing > on_the_way else []
            self.writer.append_lost(forgotten + gaps_of(at + missing - on_the_way, on_the_way, held.dropped))
            begin += missing
        count = int(end) - begin
        if count <= 0:
            return True
        if held.layer:
            self.writer.append_lost([Gap(begin - first, count, held.layer)])
            return True
        skipped = begin - held.first_plane
        packed = held.packed[skipped : skipped + count]
        if not wait:
            return self.writer.offer(packed)
        try:
            self.writer.append(packed)
        except DiskError:
            self.writer.append_lost([Gap(begin - first, count, "disk")])
        return True


def gaps_of(first: int, lost: int, dropped_by_device: int) -> list[Gap]:
    """The device says how many of the lost planes it dropped itself; the others were lost on the link."""
    device = min(lost, max(0, dropped_by_device))
    gaps = []
    if device:
        gaps.append(Gap(first, device, "device"))
    if lost > device:
        gaps.append(Gap(first + device, lost - device, "link"))
    return gaps
