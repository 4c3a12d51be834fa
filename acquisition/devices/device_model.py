"""One simulated camera below the driver, composed of its run, its registers, its stream and its faults."""

from acquisition.devices import descriptors
from acquisition.devices.control_channel import MessageEnd, StallError
from acquisition.devices.device_run import DeviceRun
from acquisition.devices.device_stream import DeviceStream
from acquisition.devices.profile import Profile
from acquisition.devices.profiles.direct import DIRECT
from acquisition.devices.registers import (
    PROTOCOL_VERSION,
    Identity,
    Request,
    Sensitivity,
    State,
    TickRate,
)
from acquisition.errors import DeviceError
from acquisition.scenes.source import SceneSource, Source

STRINGS = ("", "spike4dgs", "simulated spike camera")
_IN, _KIND, _VENDOR = 0x80, 0x60, 0x40
_GET_DESCRIPTOR = 0x06


class DeviceModel:
    """A camera whose light comes from `source`; armed, it waits for `trigger` (the shared line) or for START."""

    def __init__(self, serial: str, source: Source, tick_rate_hz: float, profile: Profile = DIRECT):
        self.serial, self.profile = serial, profile
        self.run = DeviceRun(tick_rate_hz)
        self.stream = DeviceStream(self.run, source)
        self.messages = MessageEnd(profile, self.read, self.write)
        self.sensitivity, self.firmware_version = Sensitivity(), 1

    def power_up(self) -> None:
        """Begin anew, as after a reset or with the cable pulled: idle, all counters at zero; the light goes on."""
        with self.run.changed:
            self.stream.halted = False
            self.run.power_up()
            self.stream.forget()

    def read(self, request: int) -> bytes:
        """Return the bytes of a register; raises StallError for an unknown one."""
        run, identity = self.run, Identity(PROTOCOL_VERSION, self.firmware_version)
        rate = TickRate(run.tick_rate_hz)
        known = identity, self.stream.geometry, rate, run.status(), self.sensitivity, run.clock_register(), run.link
        for register in known:
            if request == register.REQUEST:
                return register.encode()
        raise StallError

    def write(self, request: int, data: bytes = b"") -> None:
        """Do what is asked; raises StallError for an unknown request, or one that does not fit the camera's state."""
        if request == Request.SET_SENSITIVITY:
            self._set_sensitivity(data)
            return
        with self.run.changed:
            self.run.obey(request)
            if request != Request.START:
                self.stream.forget()

    def trigger(self, period_s: float = 0.0) -> None:
        """Take the first pulse of a line that pulses each `period_s` from then on; 0: only once."""
        self.run.sync_period_s = period_s
        self.run.trigger()

    def control(self, kind: int, request: int, value: int, data: bytes = b"") -> bytes:
        """Answer a request by the fields of its setup packet; raises StallError for one it does not know."""
        if kind & _KIND == _VENDOR and not self.profile.command_endpoint:
            if kind & _IN:
                return self.read(request)
            self.write(request, data)
            return b""
        strings, number = (*STRINGS, self.serial), value & 0xFF
        if (kind, request, value >> 8) == (_IN, _GET_DESCRIPTOR, descriptors.STRING) and number < len(strings):
            return descriptors.encode_string(number, strings)
        raise StallError

    def _set_sensitivity(self, data: bytes) -> None:
        try:
            wanted = Sensitivity.decode(data)
        except DeviceError as error:
            raise StallError from error
        if self.run.state is not State.IDLE:
            raise StallError
        self.sensitivity = wanted
        if isinstance(self.stream.source, SceneSource):
            self.stream.source.sensitivity = wanted.gain
