"""A trigger line without a box, for tests of simulated cameras."""

from __future__ import annotations

from collections.abc import Sequence

from acquisition.devices.device_model import DeviceModel
from acquisition.recording.manifest import Trigger


class TriggerWire:
    """One wire to every camera: a pulse starts all armed ones on the same tick, and more follow each `period_s`."""

    kind: Trigger = "line"

    def __init__(self, models: Sequence[DeviceModel], period_s: float = 1e-3):
        self._models = tuple(models)
        self.period_s: float | None = period_s

    def fire(self) -> None:
        """Send the first pulse."""
        for model in self._models:
            model.trigger(self.period_s or 0.0)
