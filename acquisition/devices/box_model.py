"""A simulated trigger box below its driver: its descriptors, its reports, and the line to the cameras."""

from __future__ import annotations

import errno
import struct
import time
from collections.abc import Callable, Sequence

from acquisition.devices import descriptors
from acquisition.devices.control_channel import StallError
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.profile import VENDOR_ID
from acquisition.devices.profiles.direct import DIRECT
from acquisition.devices.trigger_box import (
    BOX_PRODUCT_ID,
    COMMAND_BYTES,
    COMMAND_REPORT,
    DEFAULT_PERIOD_S,
    STATUS_BYTES,
    STATUS_REPORT,
    BoxCommand,
    BoxState,
    BoxStatus,
    decode_command,
)

_STRINGS = ("", "spike4dgs", "simulated trigger box")
_GET_DESCRIPTOR, _GET_REPORT, _SET_REPORT, _SET_IDLE = 0x06, 0x01, 0x09, 0x0A
_FROM_INTERFACE, _CLASS_IN, _CLASS_OUT = 0x81, 0xA1, 0x21
_HID_REPORT, _FEATURE = 0x22, 3
_REPORTS = (
    bytes.fromhex("0600ff 0901 a101 1500 26ff00 7508")  # a vendor's own collection of bytes
    + b"".join(
        bytes((0x85, number, 0x95, size - 1, 0x09, number, 0xB1, 2))  # a feature of so many bytes
        for number, size in ((STATUS_REPORT, STATUS_BYTES), (COMMAND_REPORT, COMMAND_BYTES))
    )
    + b"\xc0"
)
_DEVICE = {
    **descriptors.device(DIRECT),
    "bcdUSB": 0x0200,
    "bDeviceClass": 0,
    "bMaxPacketSize0": 64,
    "idVendor": VENDOR_ID,
    "idProduct": BOX_PRODUCT_ID,
}
_CONFIGURATION = b"".join(
    (
        struct.pack("<BBHBBBBB", 9, descriptors.CONFIGURATION, 9 + 9 + 9 + 7, 1, 1, 0, 0x80, 50),
        bytes((9, 4, 0, 0, 1, 3, 0, 0, 0)),
        struct.pack("<BBHBBBH", 9, 0x21, 0x0111, 0, 1, _HID_REPORT, len(_REPORTS)),
        struct.pack("<BBBBHB", 7, 5, 0x81, 3, 8, 8),  # every HID device has an interrupt pipe; this one is silent
    )
)


class BoxModel:
    """A box whose line goes to `cameras`; `clock` counts seconds. Pulses are microseconds apart, as set."""

    def __init__(
        self,
        serial: str,
        cameras: Sequence[DeviceModel],
        clock: Callable[[], float] = time.monotonic,
    ):
        self.serial = serial
        self.stream_endpoint = 0x81
        self._cameras = tuple(cameras)
        self._clock = clock
        self._state = BoxState.IDLE
        self._period_us = round(DEFAULT_PERIOD_S * 1e6)
        self._fired_s = 0.0
        self._sent = 0

    def status(self) -> BoxStatus:
        """What report 1 says."""
        return BoxStatus(self._state, self._period_us, self._pulses())

    def command(self, command: int, value: int) -> None:
        """Obey report 2; raises StallError for FIRE when not armed, a period of 0, or an unknown command."""
        if command == BoxCommand.ARM:
            self._state, self._sent = BoxState.ARMED, 0
        elif command == BoxCommand.FIRE and self._state is BoxState.ARMED:
            self._state, self._fired_s = BoxState.PULSING, self._clock()
            for camera in self._cameras:
                camera.sync_period_s = self._period_us * 1e-6
                camera.trigger()
        elif command == BoxCommand.STOP:
            self._sent, self._state = self._pulses(), BoxState.IDLE
        elif command == BoxCommand.PERIOD and value and self._state is not BoxState.PULSING:
            self._period_us = value
        else:
            raise StallError

    def control(self, kind: int, request: int, value: int, index: int, data: bytes = b"") -> bytes:
        """Answer a request by the fields of its setup packet; raises StallError for one it does not know."""
        high, low = value >> 8, value & 0xFF
        if kind == 0x80 and request == _GET_DESCRIPTOR:
            return self._descriptor(high, low)
        if (kind, request, high) == (_FROM_INTERFACE, _GET_DESCRIPTOR, _HID_REPORT):
            return _REPORTS
        if (kind, request) == (_CLASS_OUT, _SET_IDLE):
            return b""
        if (kind, request, high, low) == (_CLASS_IN, _GET_REPORT, _FEATURE, STATUS_REPORT):
            return self.status().encode()
        if (kind, request, high, low) == (_CLASS_OUT, _SET_REPORT, _FEATURE, COMMAND_REPORT):
            if len(data) != COMMAND_BYTES:
                raise StallError
            self.command(*decode_command(data))
            return b""
        raise StallError

    def stream(self, size: int, timeout_s: float) -> memoryview:
        """It has nothing to say on its own."""
        time.sleep(timeout_s)
        return memoryview(b"")

    def take(self, endpoint: int, data: bytes) -> None:
        """It has no pipe to write to; raises StallError."""
        raise StallError

    def give(self, endpoint: int) -> bytes:
        """It has no other pipe to read from; raises StallError."""
        raise StallError

    def wake(self) -> None:
        """Nobody waits for long."""

    def _pulses(self) -> int:
        if self._state is not BoxState.PULSING:
            return self._sent
        return 1 + int((self._clock() - self._fired_s) * 1e6 / self._period_us)

    def _descriptor(self, kind: int, number: int) -> bytes:
        strings = (*_STRINGS, self.serial)
        if kind == descriptors.STRING and number < len(strings):
            return descriptors.encode_string(number, strings)
        encoded = {descriptors.DEVICE: descriptors.encode_fields(_DEVICE), descriptors.CONFIGURATION: _CONFIGURATION}
        if kind not in encoded:
            raise StallError
        return encoded[kind]


class MockHid:
    """hidapi's device over a simulated box: refused and unplugged are OSError, as there."""

    def __init__(self, model: BoxModel):
        self._model = model
        self._plugged = True

    def unplug(self) -> None:
        """Pull the cable."""
        self._plugged = False

    def send_feature_report(self, buff: bytes) -> int:
        """Bytes sent, -1 where the device refuses or is gone."""
        try:
            self._require()
            self._model.control(_CLASS_OUT, _SET_REPORT, _FEATURE << 8 | buff[0], 0, bytes(buff))
        except (StallError, OSError):
            return -1
        return len(buff)

    def get_feature_report(self, report_num: int, max_length: int) -> list[int]:
        """The report, its number first."""
        self._require()
        try:
            return list(self._model.control(_CLASS_IN, _GET_REPORT, _FEATURE << 8 | report_num, 0))[:max_length]
        except StallError as error:
            raise OSError(errno.EPIPE, "read error") from error

    def close(self) -> None:
        """Give the device back."""

    def _require(self) -> None:
        if not self._plugged:
            raise OSError(errno.ENODEV, "read error")
