"""Reads from Linux's /sys where USB devices are plugged in, and what the kernel allows them."""

import contextlib
from dataclasses import dataclass
from pathlib import Path

SYSFS = Path("/sys")
USBFS_MEMORY = "module/usbcore/parameters/usbfs_memory_mb"
RECOMMENDED_USBFS_MB = 256  # for the transfers of nine cameras and other devices
PRACTICAL_SHARE = 0.6  # share of the signalling rate that carries payload: 375 MB/s of 5 Gb/s


@dataclass(frozen=True)
class UsbPlace:
    """One device on the bus: `port` as in 2-1.4, the link's signalling rate, and the serial number it gives."""

    serial: str
    bus: int
    port: str
    speed_mbit_s: float


def practical_mb_s(speed_mbit_s: float) -> float:
    """Return the MB/s of payload that a link of this signalling rate carries in practice."""
    return speed_mbit_s / 8 * PRACTICAL_SHARE


def usb_places(root: Path = SYSFS) -> list[UsbPlace]:
    """Return every device that gives a serial number; those that vanish while they are looked at are left out."""
    places = []
    for folder in sorted((root / "bus/usb/devices").glob("*")):
        with contextlib.suppress(OSError, ValueError):
            serial, bus = (folder / "serial").read_text().strip(), int((folder / "busnum").read_text())
            places.append(UsbPlace(serial, bus, folder.name, float((folder / "speed").read_text())))
    return places


def bus_speeds(root: Path = SYSFS) -> dict[int, float]:
    """Return the signalling rate in Mb/s of each bus, that of its root hub."""
    speeds = {}
    for folder in (root / "bus/usb/devices").glob("usb*"):
        with contextlib.suppress(OSError, ValueError):
            speeds[int((folder / "busnum").read_text())] = float((folder / "speed").read_text())
    return speeds


def usbfs_memory_mb(root: Path = SYSFS) -> int | None:
    """Return the kernel's limit for USB transfers of all programs, in MB; 0 is none, None where it does not say."""
    try:
        return int((root / USBFS_MEMORY).read_text())
    except (OSError, ValueError):
        return None
