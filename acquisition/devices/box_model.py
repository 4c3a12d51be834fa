"""A simulated trigger box, in the place of hidapi's device."""

import errno
import time
from collections.abc import Callable, Sequence

from acquisition.devices.control_channel import StallError
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.trigger_box import (
    COMMAND,
    COMMAND_BYTES,
    COMMAND_REPORT,
    DEFAULT_PERIOD_S,
    STATUS_REPORT,
    BoxCommand,
    BoxState,
    BoxStatus,
)


class BoxModel:
    """A box whose line goes to `cameras`; `clock` counts seconds. Pulses come each period, a number of microseconds."""

    def __init__(self, serial: str, cameras: Sequence[DeviceModel], clock: Callable[[], float] = time.monotonic):
        self.serial = serial
        self._cameras = tuple(cameras)
        self._clock = clock
        self._state = BoxState.IDLE
        self._period_us = round(DEFAULT_PERIOD_S * 1e6)
        self._fired_s = 0.0
        self._sent = 0

    def status(self) -> BoxStatus:
        """Return report 1."""
        return BoxStatus(self._state, self._period_us, self._pulses())

    def command(self, report: bytes) -> None:
        """Obey report 2; raises StallError for another report, or a command that does not fit the state."""
        if len(report) != COMMAND_BYTES or report[0] != COMMAND_REPORT:
            raise StallError
        _, command, value = COMMAND.unpack(report)
        if command == BoxCommand.ARM:
            self._state, self._sent = BoxState.ARMED, 0
        elif command == BoxCommand.FIRE and self._state is BoxState.ARMED:
            self._state, self._fired_s = BoxState.PULSING, self._clock()
            for camera in self._cameras:
                camera.trigger(self._period_us * 1e-6)
        elif command == BoxCommand.STOP:
            self._sent, self._state = self._pulses(), BoxState.IDLE
        elif command == BoxCommand.PERIOD and value and self._state is not BoxState.PULSING:
            self._period_us = value
        else:
            raise StallError

    def send_feature_report(self, buff: bytes) -> int:
        """Return the bytes sent, -1 where the box refuses."""
        try:
            self.command(bytes(buff))
        except StallError:
            return -1
        return len(buff)

    def get_feature_report(self, report_num: int, max_length: int) -> list[int]:
        """Return the report, its number first; raises OSError where there is none."""
        if report_num != STATUS_REPORT:
            raise OSError(errno.EPIPE, "read error")
        return list(self.status().encode())[:max_length]

    def close(self) -> None:
        """Give the device back."""

    def _pulses(self) -> int:
        if self._state is not BoxState.PULSING:
            return self._sent
        return 1 + int((self._clock() - self._fired_s) * 1e6 / self._period_us)
