"""Looks at everything that would spoil a recording, and says what was found, what was expected and what to change."""

import math
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field
from pathlib import Path

from acquisition.devices import sysfs
from acquisition.devices.open import OpenCameras
from acquisition.devices.profile import Profile, profiles
from acquisition.devices.protocol import Block
from acquisition.devices.registers import Identity, LinkCounters
from acquisition.devices.usb import ClockLatch
from acquisition.errors import DeviceError, DiskError
from acquisition.progress import Progress, silent
from acquisition.recording.writer import free_bytes
from acquisition.session.contact import CLOCK_SPREAD
from acquisition.session.disk_speed import write_speed
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig

SPARE_MB = 16  # USB memory left to all other devices
DISK_RESERVE = 1.1  # least speed of the disk, as a multiple of the rig's rate
LEAST_SECONDS = 10.0  # seconds of recording that must fit
LATCH_PLANES = 8  # planes that simulated cameras show
_LATCH_TIMEOUT_S = 1.0

Facts = Mapping[str, Mapping[str, object]]  # by camera id: what was measured, by its name


@dataclass(frozen=True)
class Check:
    """One thing looked at. `passed` is None where it does not apply; `change` says what to do where it failed.

    `facts` are what was measured of single cameras.
    """

    name: str
    passed: bool | None
    found: str
    expected: str
    change: str = ""
    facts: Facts = field(default_factory=dict)

    def to_json(self) -> dict[str, object]:
        """Return the check as a JSON object of the same names, without its facts."""
        return {name: value for name, value in asdict(self).items() if name != "facts"}


def camera_facts(rig: Rig, checks: Sequence[Check]) -> list[dict[str, object]]:
    """Return what all checks measured of each camera, in the rig's order."""
    found: dict[str, dict[str, object]] = {camera_id: {"id": camera_id} for camera_id in rig.ids}
    for check in checks:
        for camera_id, facts in check.facts.items():
            found[camera_id].update(facts)
    return list(found.values())


@dataclass(frozen=True)
class Surroundings:
    """The things that the checks look at: a rig's cameras, the folder recordings will go to, and the machine.

    `sysfs` is None where cameras are not on this machine's USB.
    """

    open_rig: Callable[[Rig], AbstractContextManager[OpenCameras]]
    folder: Path
    sysfs: Path | None = sysfs.SYSFS
    disk_seconds: float = 5.0
    clock: Callable[[], float] = time.monotonic


def preflight(rig: Rig, around: Surroundings, progress: Progress = silent) -> list[Check]:
    """Make every check of `rig`, in order.

    Cameras are armed and started for a few planes, and stopped; nothing is kept.
    """
    cameras: list[Check] = []
    queued_mb: list[float] = []
    for number, camera in enumerate(rig.cameras):
        progress(0.4 * number / len(rig.cameras), f"camera {camera.id}")
        check, profile = _camera(rig, camera, around)
        cameras.append(check)
        queued_mb.append(profile.queued_mb if profile else max(each.queued_mb for each in profiles().values()))
    progress(0.4, "USB")
    checks = [*cameras, _firmware(cameras), *_topology(rig, around.sysfs), _usbfs(queued_mb, around.sysfs)]
    progress(0.5, "clock latch")
    checks += _run(rig, around, all(check.passed for check in cameras))
    progress(0.6, "disk")
    checks += _disk(rig, around)
    progress(1.0, f"{sum(check.passed is False for check in checks)} of {len(checks)} checks failed")
    return checks


def _camera_mb_s(rig: Rig, camera: Camera) -> float:
    return PlaneLayout(camera.width, camera.height).plane_bytes * rig.tick_rate_hz / 1e6


def _camera(rig: Rig, camera: Camera, around: Surroundings) -> tuple[Check, Profile | None]:
    """Open one camera, and return how that went and what kind of camera it is."""
    name = f"camera {camera.id}"
    expected = f"{camera.width}x{camera.height} at {rig.tick_rate_hz:g} Hz"
    try:
        with around.open_rig(rig.only([camera.id])) as opened:
            [found] = opened.cameras
            version = found.registers.read(Identity).firmware_version
    except DeviceError as error:
        facts = {camera.id: {"connected": False, "fault": error.found}}
        return Check(name, False, error.found, expected, error.do or "reconnect it", facts), None
    facts = {camera.id: {"connected": True, "serial": camera.serial, "firmware": version}}
    return Check(name, True, f"{expected}, firmware {version}", expected, facts=facts), found.profile


def _firmware(cameras: Sequence[Check]) -> Check:
    versions: dict[str, list[str]] = defaultdict(list)
    for check in cameras:
        for camera_id, facts in check.facts.items():
            if "firmware" in facts:
                versions[str(facts["firmware"])].append(camera_id)
    expected = "one version in all cameras"
    if len(versions) < 2:
        found = f"version {next(iter(versions))}" if versions else "no camera"
        return Check("firmware", True if versions else None, found, expected)
    found = "; ".join(f"{version} in {', '.join(ids)}" for version, ids in sorted(versions.items()))
    return Check("firmware", False, found, expected, "load the same firmware into all of them")


def _topology(rig: Rig, root: Path | None) -> list[Check]:
    """Check the link of each camera that is found in /sys, and each bus that they share."""
    places = {} if root is None else {place.serial: place for place in sysfs.usb_places(root)}
    cameras = [camera for camera in rig.cameras if camera.serial in places]
    if root is None or not cameras:
        found = "simulated cameras" if root is None else "none of the cameras in /sys"
        return [Check("USB topology", None, found, "one camera at full rate on a host controller")]
    checks, buses = [], defaultdict(list)
    for camera in cameras:
        place, rate = places[camera.serial], _camera_mb_s(rig, camera)
        carries = sysfs.practical_mb_s(place.speed_mbit_s)
        buses[place.bus].append(camera)
        found = f"{place.speed_mbit_s:g} Mb/s at {place.port}, in practice {carries:.0f} MB/s"
        change = "plug it into a SuperSpeed port with a SuperSpeed cable, or lower the tick rate"
        facts = {camera.id: {"port": place.port, "link_mbit_s": place.speed_mbit_s}}
        checks.append(Check(f"link of {camera.id}", rate <= carries, found, f"{rate:.0f} MB/s", change, facts))
    speeds = sysfs.bus_speeds(root)
    for bus, sharing in sorted(buses.items()):
        carries = sysfs.practical_mb_s(speeds.get(bus, min(places[c.serial].speed_mbit_s for c in sharing)))
        ids, rate = ", ".join(c.id for c in sharing), sum(_camera_mb_s(rig, c) for c in sharing)
        expected = f"at most the {carries:.0f} MB/s that it carries in practice"
        change = f"move all but one of {ids} to other host controllers, or lower the tick rate"
        checks.append(Check(f"USB bus {bus}", rate <= carries, f"{rate:.0f} MB/s of {ids}", expected, change))
    return checks


def _usbfs(queued_mb: Sequence[float], root: Path | None) -> Check:
    needed = math.ceil(sum(queued_mb)) + SPARE_MB
    expected = f"at least {needed} MB for {len(queued_mb)} cameras"
    limit = None if root is None else sysfs.usbfs_memory_mb(root)
    if limit is None:
        return Check("USB memory", None, "simulated cameras" if root is None else "no limit stated", expected)
    change = f"write {max(sysfs.RECOMMENDED_USBFS_MB, needed)} to /sys/{sysfs.USBFS_MEMORY}"
    return Check("USB memory", limit == 0 or limit >= needed, f"{limit or 'any number of'} MB", expected, change)


@dataclass(frozen=True)
class _Sample:
    """A camera's clock against the host's and its link's counters, and the first block after the trigger."""

    latches: tuple[ClockLatch, ClockLatch]
    link: LinkCounters
    block: Block | None


def _run(rig: Rig, around: Surroundings, ready: bool) -> list[Check]:
    """Trigger all cameras, and check their first planes, their clocks and their links."""
    names = {
        "clock latch": "the first plane of every camera within a plane of its clock's zero, the same pulses counted",
        "clock rate": f"every camera's clock as fast as the host's, to {CLOCK_SPREAD * 1e6:g} us a second",
        "link errors": "none while the cameras ran",
    }
    if not ready:
        return [Check(name, None, "not all cameras", expected) for name, expected in names.items()]
    try:
        with around.open_rig(rig) as opened:
            samples = _samples(opened, around.clock)
    except DeviceError as error:
        return [Check(name, False, str(error), expected, "reconnect that camera") for name, expected in names.items()]
    return [
        _latch(rig, samples, names["clock latch"], has_line=opened.trigger.kind != "software"),
        _rate(samples, names["clock rate"]),
        _links(samples, names["link errors"]),
    ]


def _latch(rig: Rig, samples: Mapping[str, _Sample], expected: str, *, has_line: bool) -> Check:
    """Check that all cameras began at the trigger, by their first planes and the pulses they counted."""
    silent_ones = [camera_id for camera_id, sample in samples.items() if sample.block is None]
    change = "check the cables of the sync line and the trigger"
    if silent_ones:
        return Check("clock latch", False, f"no plane of {', '.join(silent_ones)} after the trigger", expected, change)
    if not has_line:
        return Check("clock latch", None, "no sync line: cameras are started one after another", expected)
    seen = {camera_id: sample.block for camera_id, sample in samples.items() if sample.block}
    errors_s = {c: b.device_time_ns * 1e-9 - b.first_plane / rig.tick_rate_hz for c, b in seen.items()}
    worst = max(errors_s, key=lambda camera_id: abs(errors_s[camera_id]))
    counts = {camera_id: block.sync_pulses for camera_id, block in seen.items()}
    odd = [camera_id for camera_id, count in counts.items() if count < 1 or count != max(counts.values())]
    found = f"at most {abs(errors_s[worst]) * 1e6:.1f} us, of {worst}"
    if odd:
        found += f"; {', '.join(f'{camera_id} counted {counts[camera_id]} pulses' for camera_id in odd)}"
    facts = {c: {"skew_us": errors_s[c] * 1e6, "sync_pulses": counts[c]} for c in seen}
    return Check("clock latch", not odd and abs(errors_s[worst]) < 1 / rig.tick_rate_hz, found, expected, change, facts)


def _rate(samples: Mapping[str, _Sample], expected: str) -> Check:
    """Check each clock, latched twice against the host's: the difference must be within the time the requests took."""
    wrong, worst_s = [], 0.0
    for camera_id, sample in samples.items():
        first, last = sample.latches
        host_s = last.host_s - first.host_s
        error_s = last.oscillator_s - first.oscillator_s - host_s
        worst_s = max(worst_s, abs(error_s))
        if abs(error_s) > first.uncertainty_s + last.uncertainty_s + CLOCK_SPREAD * host_s:
            wrong.append(f"{camera_id} went {host_s + error_s:.6f} s in {host_s:.6f} s")
    found = "; ".join(wrong) or f"at most {worst_s * 1e6:.1f} us apart"
    return Check("clock rate", not wrong, found, expected, "update the camera's firmware, or have it repaired")


def _links(samples: Mapping[str, _Sample], expected: str) -> Check:
    links = {camera_id: sample.link for camera_id, sample in samples.items()}
    bad = {c: link for c, link in links.items() if link.errors or link.recoveries}
    found = "; ".join(f"{c}: {link.errors} errors, {link.recoveries} recoveries" for c, link in bad.items()) or "none"
    facts = {c: {"link_errors": link.errors, "link_recoveries": link.recoveries} for c, link in links.items()}
    return Check("link errors", not bad, found, expected, "change the cable or the port of these cameras", facts)


def _samples(opened: OpenCameras, clock: Callable[[], float]) -> dict[str, _Sample]:
    """Arm, fire, and look at each camera before and after its first block; all are stopped again."""
    cameras = opened.cameras
    try:
        before = [(camera.registers.read(LinkCounters), camera.registers.latch()) for camera in cameras]
        for camera in cameras:
            camera.ensure_ready()
        opened.trigger.fire()
        end = clock() + _LATCH_TIMEOUT_S
        blocks = [camera.read_block(max(0.01, end - clock())) for camera in cameras]
        found = {}
        for camera, (link, latch), block in zip(cameras, before, blocks, strict=True):
            latches, now = (latch, camera.registers.latch()), camera.registers.read(LinkCounters)
            found[camera.id] = _Sample(latches, now.since(link), block)
        return found
    finally:
        for camera in cameras:
            camera.ensure_stopped()


def _disk(rig: Rig, around: Surroundings) -> list[Check]:
    rate = sum(_camera_mb_s(rig, camera) for camera in rig.cameras)
    needed = f"at least {rate * DISK_RESERVE:.0f} MB/s, {DISK_RESERVE:g} times the rig's rate"
    try:
        speed = write_speed(around.folder, around.disk_seconds, around.clock)
    except DiskError as error:
        written = Check("disk speed", False, str(error), needed, "record to another disk")
    else:
        how = "written directly" if speed.direct else "written through the page cache: no direct writes here"
        change = "record to a faster disk, or lower the tick rate"
        fast = speed.mb_s >= rate * DISK_RESERVE
        written = Check("disk speed", fast, f"{speed.mb_s:.0f} MB/s {how}", needed, change)
    seconds = free_bytes(around.folder) / 1e6 / rate
    change = "free some space, or record to another disk"
    fits = Check("room", seconds >= LEAST_SECONDS, f"{seconds:.1f} s of recording", f"{LEAST_SECONDS:g} s", change)
    return [written, fits]
