"""One camera on its way to its file: what it offers is written or counted as lost, and it is never held up."""

import contextlib
import dataclasses
import json
import threading
import time
from dataclasses import dataclass

from acquisition.devices.protocol import Block
from acquisition.devices.usb import UsbCamera
from acquisition.errors import DeviceError
from acquisition.recording.stream_writer import StreamWriter
from acquisition.session.backlog import Backlog, Held
from acquisition.session.contact import CLOCK_SPREAD, Contact
from acquisition.session.timing import StampLog, TimingError

READ_TIMEOUT_S = 1.0
SILENT_READS = 5  # reads without a block after which a camera has stopped sending
REPEATED_BLOCKS = 64  # most blocks that a repeated one lies back; one from further back is a camera that began anew
LONGEST_GAP_S = 60.0  # seconds of planes lost at once; for more, the counter cannot be believed
SPARE_S = 0.25  # seconds held beside the pre-trigger's span: the cameras are not read at the same instant


@dataclass(frozen=True)
class CaptureRules:
    """Rules that hold for every camera of a run.

    `waits`: the cameras wait for the host (simulated ones), so a full ring holds them up instead of losing planes.
    `planes`: record so many of every camera; None until stopped.
    `pre_planes`: keep so many planes until the run is saved; None records from the first plane.
    `rejoin_s`: a camera that fails is looked for so long, and recorded on; 0 leaves it.
    `period_s`: the time between the line's pulses, None where it does not pulse.
    """

    tick_rate_hz: float
    waits: bool = False
    planes: int | None = None
    pre_planes: int | None = None
    rejoin_s: float = 0.0
    period_s: float | None = None


class Capture:
    """One camera and its file: `run` in a thread of its own, `begin_at` and `end_at` from the one that watches.

    Planes are counted as the camera counts them, by its own clock: `position` is the next one expected of it. Those of
    the rig clock are `lead` planes behind them, where `follow_the_rig_clock` was called.
    """

    def __init__(self, camera: UsbCamera, writer: StreamWriter, rules: CaptureRules):
        self.camera = camera
        self.writer = writer
        self.position = 0
        self.failure: DeviceError | None = None
        self.contact = Contact(camera)
        self.returned: list[str] = []  # where it was away and came back
        self.lead = 0
        self._stamps = None if rules.period_s is None else StampLog(rules.period_s)
        self._stamped_until_s = 0.0  # a pulse before it, on the camera's clock, would be among them
        self._shown_s: float | None = None  # what its clock shows at plane 0, which makes no plane early or late
        self._began_again = 0  # where the camera's plane 0 lies since it came back
        self._rules = rules
        self._dropped = 0
        may_hold = 0 if rules.pre_planes is None else rules.pre_planes + round(SPARE_S * rules.tick_rate_hz)
        self._backlog = Backlog(writer, may_hold, waits=rules.waits)

    @property
    def reached(self) -> int:
        """Return the plane of the rig clock that comes next."""
        return self.position - self.lead

    def follow_the_rig_clock(self) -> None:
        """Find how many planes the camera's clock is ahead now, from the sync pulses; where they cannot tell, none."""
        rate_hz, now_s = self._rules.tick_rate_hz, self.position / self._rules.tick_rate_hz
        if self._stamps is None:
            return
        with contextlib.suppress(TimingError):
            ahead_s = self._stamps.estimate(now_s, 0.0).skew_s - (self._shown_s or 0.0)
            believable = abs(ahead_s) <= CLOCK_SPREAD * now_s + self._stamps.period_s
            self.lead = round(ahead_s * rate_hz) if believable else 0

    def begin_at(self, plane: int) -> None:
        """Record from `plane` of the rig clock on, which may be one that is held."""
        self._backlog.first = plane + self.lead

    def end_at(self, plane: int) -> None:
        """Record up to but without `plane` of the rig clock, or less where an earlier end is set."""
        self._backlog.end = min(self._backlog.end, plane + self.lead)

    def run(self, stop: threading.Event) -> None:
        """Read and write until all planes are there or `stop` is set; a camera's failure ends its own run only."""
        while not self.failure:
            try:
                self._read(stop)
                break
            except DeviceError as error:
                if not self._found_again(stop):
                    self.failure = error
        self._backlog.finish()
        self.writer.close_keeping()

    def tell_clock(self) -> None:
        """Estimate the camera's clock from its sync pulses, for the manifest; where they cannot tell, do nothing.

        Planes come late by what they were begun later, less what the clock has gained from plane 0 to the middle of the
        recording. Those of a camera that was away lie where the host put them: nothing measured it.
        """
        rate_hz = self._rules.tick_rate_hz
        if self._stamps is None:
            return
        begin_s, duration_s = ((self._backlog.first or 0) - self.lead) / rate_hz, self.writer.planes / rate_hz
        try:
            estimate = self._stamps.estimate(begin_s, duration_s, self._stamped_until_s)
        except TimingError:
            return
        self.writer.clock = json.loads(json.dumps(dataclasses.asdict(estimate)))
        if not self.returned:
            self.writer.skew_s = self.lead / rate_hz + (self._shown_s or 0.0) - estimate.skew_s

    def _read(self, stop: threading.Event) -> None:
        """Take blocks until all planes are there or `stop` is set; raises DeviceError."""
        silent_reads, damaged_bytes = 0, self.camera.parser.skipped_bytes
        while not stop.is_set() and self.position < self._backlog.end:
            block = self.camera.read_block(READ_TIMEOUT_S)
            silent_reads += 1
            if block is None and silent_reads == SILENT_READS:
                raise self._silence(self.camera.parser.skipped_bytes - damaged_bytes)
            if block:
                silent_reads, damaged_bytes = 0, self.camera.parser.skipped_bytes
                self._receive(dataclasses.replace(block, first_plane=block.first_plane + self._began_again))
                self.contact.count_block()

    def _silence(self, damaged_bytes: int) -> DeviceError:
        """Return the error of a camera that sends no blocks, but perhaps damaged ones."""
        what, check = "no data", "check its cable and trigger"
        if damaged_bytes:
            what, check = f"{damaged_bytes} damaged bytes alone", "change its cable or port, or update its firmware"
        found = f"found {what} for {SILENT_READS} reads after {self.position} planes"
        return DeviceError(found, "blocks", check, where=self.camera.id)

    def _found_again(self, stop: threading.Event) -> bool:
        """Wait for a camera that was lost; where it came back, its planes go on where they belong."""
        rules, rate_hz = self._rules, self._rules.tick_rate_hz
        if not rules.rejoin_s > 0:
            return False

        def is_over() -> bool:
            run_s = self.contact.run_s(time.monotonic())
            return run_s is not None and run_s * rate_hz >= self._backlog.end

        found = self.contact.find_again(rules.rejoin_s, rules.period_s, stop, is_over)
        if found is None or round(found.run_s * rate_hz) < self.position:
            return False
        self._began_again, self._dropped = round(found.run_s * rate_hz), 0
        first = self._backlog.first or 0
        where = f"{self.camera.id} was away from plane {max(0, self.position - first)} on and came back"
        sure = f"placed to {found.uncertainty_s * rate_hz:.1f} planes" if found.uncertainty_s else "placed by a pulse"
        self.returned.append(f"{where} at plane {self._began_again - first}, {sure}")
        return True

    def _receive(self, block: Block) -> None:
        """Take a block in its place; raises DeviceError for one that cannot be believed."""
        where = self.camera.id
        if block.layout != self.writer.layout:
            raise DeviceError(f"found planes of {block.layout}", str(self.writer.layout), "reconnect it", where=where)
        planes, lost = len(block.packed), block.first_plane - self.position
        if -REPEATED_BLOCKS * planes <= lost < 0:
            return
        if lost < 0 or lost > LONGEST_GAP_S * self._rules.tick_rate_hz:
            do = "its counter began anew or cannot be right, reconnect it"
            raise DeviceError(f"found plane {block.first_plane}", str(self.position), do, where=where)
        if self._stamps is not None and not self.returned:
            self._stamped_until_s = block.device_time_ns * 1e-9
            if self._shown_s is None:
                self._shown_s = self._stamped_until_s - block.first_plane / self._rules.tick_rate_hz
            if block.pulse_time_s is not None:
                recorded = self._backlog.first is not None
                self._stamps.add(block.sync_pulses - 1, block.pulse_time_s, recorded=recorded)
        dropped = max(0, block.dropped_planes - self._dropped)
        self._dropped = block.dropped_planes
        self.position = block.first_plane + planes
        self._backlog.add(Held(block.first_plane, planes, block.packed, lost, dropped))
