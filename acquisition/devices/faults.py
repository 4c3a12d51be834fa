"""Faults that simulated cameras can be given by their device URI, so that an operator can see what each looks like."""

from collections.abc import Callable, Mapping

from acquisition.devices.device_model import DeviceModel
from acquisition.devices.mock import MockBackend
from acquisition.devices.registers import LinkCounters
from acquisition.devices.usb_link import CameraSetupError

LATE_S = 1e-3


def _missing(model: DeviceModel, backend: MockBackend) -> None:
    backend.unplug(model.serial)


def _firmware(model: DeviceModel, backend: MockBackend) -> None:
    model.firmware_version += 1


def _deaf(model: DeviceModel, backend: MockBackend) -> None:
    model.run.hears = False


def _late(model: DeviceModel, backend: MockBackend) -> None:
    model.run.offset_s = LATE_S


def _frozen(model: DeviceModel, backend: MockBackend) -> None:
    stopped_s = model.run.now_s()
    model.run.now_s = lambda: stopped_s


def _noisy(model: DeviceModel, backend: MockBackend) -> None:
    model.stream.link_per_block = LinkCounters(errors=3, recoveries=1)


FAULTS: dict[str, Callable[[DeviceModel, MockBackend], None]] = {
    "missing": _missing,  # is not plugged in
    "firmware": _firmware,  # has another version
    "deaf": _deaf,  # does not hear the trigger
    "late": _late,  # its clock shows a millisecond at the trigger
    "frozen": _frozen,  # its oscillator stands still
    "noisy": _noisy,  # its link has errors
}


def parse_fault(text: str) -> tuple[str, str]:
    """Return the kind and the camera of `KIND:camRC`; raises CameraSetupError for all else."""
    kind, _, camera_id = text.partition(":")
    if kind not in FAULTS or not camera_id:
        raise CameraSetupError(f"found the fault {text!r}", f"one of {', '.join(FAULTS)}, and :camRC behind it")
    return kind, camera_id


def give_fault(fault: str, models: Mapping[str, DeviceModel], backend: MockBackend) -> None:
    """Give the fault `KIND:camRC` to that camera of `models`, by camera id, where it is among them."""
    kind, camera_id = parse_fault(fault)
    if camera_id in models:
        FAULTS[kind](models[camera_id], backend)
