"""A camera of a test's own making, which says no more of itself than a session must be told."""

from types import SimpleNamespace

from acquisition.devices.registers import Identity
from acquisition.errors import DeviceError


class PlainCamera:
    """Has registers that never change, no damage and no clock; a subclass sends blocks."""

    serial = ""

    def __init__(self):
        self.parser = SimpleNamespace(skipped_bytes=0)
        self.registers = SimpleNamespace(read=lambda kind: Identity(3, 1) if kind is Identity else kind())
        self.registers.latch = self._refuse

    def _refuse(self):
        raise DeviceError("has no clock")
