"""The trigger box, over HID: it starts every armed camera by one pulse of the shared line, and goes on pulsing.

Its two feature reports are in PROTOCOL.md.
"""

from __future__ import annotations

import contextlib
import enum
import struct
from typing import NamedTuple

import hidraw

from acquisition.devices.profile import VENDOR_ID
from acquisition.errors import DeviceError
from acquisition.recording.manifest import Trigger

BOX_PRODUCT_ID = 0x0002
STATUS_REPORT, COMMAND_REPORT = 1, 2
DEFAULT_PERIOD_S = 1e-3
_MAGIC = b"S4TB"
_STATUS = struct.Struct("<B4sHHIQ")
COMMAND = struct.Struct("<BBI")  # report 2: its number, the command, its value
STATUS_BYTES, COMMAND_BYTES = _STATUS.size, COMMAND.size
BOX_VERSION = 1


class BoxState(enum.IntEnum):
    """A trigger box's state."""

    IDLE = 0
    ARMED = 1
    PULSING = 2


class BoxCommand(enum.IntEnum):
    """The first byte of report 2; PERIOD takes microseconds."""

    ARM = 1
    FIRE = 2
    STOP = 3
    PERIOD = 4


class BoxStatus(NamedTuple):
    """Report 1."""

    state: BoxState
    period_us: int
    pulses: int

    def encode(self) -> bytes:
        """Return the report's bytes."""
        return _STATUS.pack(STATUS_REPORT, _MAGIC, BOX_VERSION, self.state, self.period_us, self.pulses)

    @classmethod
    def decode(cls, data: bytes) -> BoxStatus:
        """Return the report with these bytes; raises DeviceError for bytes that are not this report."""
        if len(data) != STATUS_BYTES:
            raise DeviceError(f"found a status of {len(data)} B", str(STATUS_BYTES), where="trigger box")
        _, magic, version, state, period_us, pulses = _STATUS.unpack(data)
        if magic != _MAGIC or version != BOX_VERSION or state not in list(BoxState):
            found = f"found the status {magic!r}, version {version}, state {state}"
            expected = f"{_MAGIC!r}, version {BOX_VERSION}"
            raise DeviceError(found, expected, "update one of them", where="trigger box")
        return cls(BoxState(state), period_us, pulses)


class TriggerBox:
    """A connected trigger box, hidapi's `device`; the line it drives pulses every `period_s` from the trigger on.

    A program that was killed leaves its box pulsing, which would start cameras as they are armed: opening it ends that.
    """

    kind: Trigger = "box"

    def __init__(self, device: hidraw.device, period_s: float = DEFAULT_PERIOD_S):
        self._device = device
        self._period_us = round(period_s * 1e6)
        self.period_s: float | None = self._period_us * 1e-6
        if self.status().state is BoxState.PULSING:
            self._command(BoxCommand.STOP)

    def status(self) -> BoxStatus:
        """Ask the box what it does, and how many pulses it has sent since it was armed."""
        try:
            return BoxStatus.decode(bytes(self._device.get_feature_report(STATUS_REPORT, STATUS_BYTES)))
        except OSError as error:
            raise _gone() from error

    def fire(self) -> None:
        """Send the trigger, and the pulses after it; raises DeviceError where no pulse was sent."""
        self._command(BoxCommand.STOP)
        self._command(BoxCommand.PERIOD, self._period_us)
        self._command(BoxCommand.ARM)
        self._command(BoxCommand.FIRE)
        found = self.status()
        if found.state is not BoxState.PULSING or not found.pulses or found.period_us != self._period_us:
            expected = f"pulses every {self._period_us} us"
            raise DeviceError(f"found {found} after firing", expected, "reconnect it", where="trigger box")

    def close(self) -> None:
        """End the pulses and give the box back; one that is gone has ended them."""
        with contextlib.suppress(DeviceError):
            self._command(BoxCommand.STOP)
        self._device.close()

    def _command(self, command: BoxCommand, value: int = 0) -> None:
        try:
            sent = self._device.send_feature_report(COMMAND.pack(COMMAND_REPORT, command, value))
        except OSError as error:
            raise _gone() from error
        if sent != COMMAND_BYTES:
            raise _gone()


def find_box() -> TriggerBox | None:
    """Return the connected trigger box, or None; raises DeviceError for several, or one that may not be opened."""
    found = hidraw.enumerate(VENDOR_ID, BOX_PRODUCT_ID)
    if not found:
        return None
    if len(found) > 1:
        serials = ", ".join(sorted(each["serial_number"] for each in found))
        raise DeviceError(f"found {len(found)} trigger boxes ({serials})", "one", "unplug the others")
    device = hidraw.device()
    try:
        device.open_path(found[0]["path"])
    except OSError as error:
        where = f"trigger box at {found[0]['path'].decode()}"
        raise DeviceError("access was denied", do="install docker/70-spike4dgs.rules", where=where) from error
    try:
        return TriggerBox(device)
    except DeviceError:
        device.close()
        raise


def _gone() -> DeviceError:
    return DeviceError("it is not connected any more, or does not answer", do="check its cable", where="trigger box")
