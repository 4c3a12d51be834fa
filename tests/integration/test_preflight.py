"""The pre-flight passes a rig in good state and names what is bad in any other, changing nothing."""

import contextlib
import dataclasses
import itertools
import json

import numpy as np
import pytest
from maintenance.trigger_line import TriggerWire

from acquisition.devices import profile as profile_module
from acquisition.devices.device_model import DeviceModel
from acquisition.devices.mock import MockBackend
from acquisition.devices.open import OpenCameras
from acquisition.devices.profiles.direct import DIRECT
from acquisition.devices.profiles.ft60x import FT60X
from acquisition.devices.usb import SoftwareTrigger, UsbCamera
from acquisition.errors import DiskError
from acquisition.recording import direct as direct_module
from acquisition.session import disk_speed as disk_speed_module
from acquisition.session import preflight as preflight_module
from acquisition.session.disk_speed import DiskSpeed, write_speed
from acquisition.session.preflight import Check, Surroundings, preflight
from acquisition.spikes.layout import PlaneLayout
from rigs.rig import Rig
from rigs.toml import catalog_rig, dump_rig

RIG = catalog_rig("lab3x3")
LAYOUT = PlaneLayout(400, 250)


class Dark:
    """Eight planes without a spike."""

    layout = LAYOUT

    def __init__(self):
        self.left = 8

    def next_planes(self, count: int) -> np.ndarray:
        found, self.left = min(count, self.left), max(0, self.left - count)
        return np.zeros((found, LAYOUT.plane_bytes), dtype=np.uint8)


class Odd:
    """A camera that answers as another would, but for what is given by name."""

    def __init__(self, camera: UsbCamera, **answers):
        self._camera, self._answers = camera, answers

    def __getattr__(self, name: str):
        return self._answers.get(name) or getattr(self._camera, name)


class Bench:
    """A 3x3 rig on the mock bus and in a made-up /sys; its parts can be spoilt."""

    def __init__(self, folder):
        self.models = [DeviceModel(c.serial, Dark(), RIG.tick_rate_hz) for c in RIG.cameras]
        self.backend = MockBackend(self.models)
        self.folder = folder
        self.sysfs = folder / "sys"
        self.odd = {}  # camera id: what makes an Odd of it
        self.line = True
        for number, camera in enumerate(RIG.cameras, start=1):
            self.plug(camera.serial, bus=number)
        self.usbfs_memory_mb(256)

    def plug(self, serial: str, bus: int, speed: int = 5000) -> None:
        """Put a device on a bus of SuperSpeed."""
        for old in self.sysfs.glob("bus/usb/devices/*/serial"):
            if old.read_text().strip() == serial:
                old.unlink()
        for name, number, rate in ((f"usb{bus}", f"0000:00:{bus}", 5000), (f"{bus}-{serial}", serial, speed)):
            folder = self.sysfs / "bus/usb/devices" / name
            folder.mkdir(parents=True, exist_ok=True)
            for file, value in (("serial", number), ("busnum", bus), ("speed", rate)):
                (folder / file).write_text(f"{value}\n")
        (self.sysfs / f"bus/usb/devices/{bus}-0:1.0").mkdir(exist_ok=True)  # an interface

    def usbfs_memory_mb(self, limit: int) -> None:
        path = self.sysfs / "module/usbcore/parameters/usbfs_memory_mb"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{limit}\n")

    @contextlib.contextmanager
    def open_rig(self, rig: Rig):
        with contextlib.ExitStack() as stack:
            cameras = []
            for camera in rig.cameras:
                opened = UsbCamera.open(camera, rig.tick_rate_hz, self.backend)
                stack.callback(opened.close)
                cameras.append(self.odd.get(camera.id, lambda found: found)(opened))
            yield OpenCameras(tuple(cameras), TriggerWire(self.models) if self.line else SoftwareTrigger(cameras))

    def checks(self, rig: Rig = RIG, **around) -> dict[str, Check]:
        before = sorted(self.folder.rglob("*"))
        surroundings = Surroundings(self.open_rig, self.folder, self.sysfs, disk_seconds=0.05)
        found = preflight(rig, dataclasses.replace(surroundings, **around))
        assert sorted(self.folder.rglob("*")) == before
        assert {model.run.state.name for model in self.models} == {"IDLE"}
        return {check.name: check for check in found}


@pytest.fixture
def fast_disk(monkeypatch):
    monkeypatch.setattr(preflight_module, "write_speed", lambda *_: DiskSpeed(3000.0, True))
    monkeypatch.setattr(preflight_module, "free_bytes", lambda _: 100_000_000_000)


@pytest.fixture
def bench(tmp_path, fast_disk):
    return Bench(tmp_path)


def failed(checks: dict[str, Check]) -> list[str]:
    return [check.name for check in checks.values() if check.passed is False]


def test_a_rig_in_good_state_passes(bench):
    checks = bench.checks()
    assert failed(checks) == []
    assert all(check.passed for check in checks.values())
    assert checks["camera cam12"].found == "400x250 at 20000 Hz, firmware 1"
    assert checks["firmware"].found == "version 1"
    assert checks["link of cam00"].found == "5000 Mb/s at 1-S4D-00, in practice 375 MB/s"
    assert checks["USB bus 9"].found == "250 MB/s of cam22"
    assert checks["USB memory"].found == "256 MB"
    assert checks["room"].found == "44.4 s of recording"


def test_a_missing_camera_is_named(bench):
    bench.backend.unplug("S4D-12")
    check = bench.checks()["camera cam12"]
    assert check.passed is False
    assert check.found.startswith("found no camera with serial S4D-12 (connected: S4D-00, S4D-01")
    assert check.change == "check its cable and power"


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda rig: rig.scaled(200, 125), "found a sensor of 400x250"),
        (lambda rig: dataclasses.replace(rig, tick_rate_hz=1000.0), "found 20000 Hz"),
    ],
)
def test_a_rig_that_is_not_this_one_fails_for_every_camera(bench, change, found):
    checks = bench.checks(change(RIG))
    assert failed(checks) == [f"camera {camera_id}" for camera_id in RIG.ids]
    assert checks["camera cam00"].found == found
    assert checks["camera cam00"].change == "mend the rig"
    assert checks["clock latch"].passed is None


def test_firmware_that_differs_is_named(bench):
    for camera, model in zip(RIG.cameras, bench.models, strict=True):
        model.firmware_version = 7 if camera.id == "cam11" else 1
    checks = bench.checks()
    assert failed(checks) == ["firmware"]
    assert checks["firmware"].found.endswith("; 7 in cam11")


def test_two_cameras_on_one_bus_are_refused_at_full_rate_only(bench):
    bench.plug("S4D-01", bus=1)
    checks = bench.checks()
    assert failed(checks) == ["USB bus 1"]
    assert checks["USB bus 1"].found == "500 MB/s of cam00, cam01"
    assert "move all but one of cam00, cam01" in checks["USB bus 1"].change


def test_a_slow_link_is_refused(bench):
    bench.plug("S4D-20", bus=7, speed=480)
    checks = bench.checks()
    assert failed(checks) == ["link of cam20"]
    assert checks["link of cam20"].found == "480 Mb/s at 7-S4D-20, in practice 36 MB/s"


def test_the_usb_memory_says_the_value_needed(bench):
    bench.usbfs_memory_mb(16)
    check = bench.checks()["USB memory"]
    assert (check.passed, check.found, check.expected) == (False, "16 MB", "at least 88 MB for 9 cameras")
    assert check.change == "write 256 to /sys/module/usbcore/parameters/usbfs_memory_mb"
    bench.usbfs_memory_mb(0)
    assert bench.checks()["USB memory"].found == "any number of MB"


def test_the_usb_memory_follows_the_queue_of_each_camera_s_profile(bench, monkeypatch):
    deep = dataclasses.replace(FT60X, name="deep", product_id=0x1234, in_flight=64)  # 16 MB
    known = {profile.name: profile for profile in (DIRECT, FT60X, deep)}
    monkeypatch.setattr(profile_module, "members", lambda *_: known)
    for number, profile in enumerate((deep, FT60X)):
        bench.models[number] = DeviceModel(bench.models[number].serial, Dark(), RIG.tick_rate_hz, profile=profile)
    bench.backend = MockBackend(bench.models)
    assert bench.checks()["USB memory"].expected == f"at least {16 + 4 + 7 * 8 + 16} MB for 9 cameras"
    bench.backend.unplug(bench.models[1].serial)  # which profile it has is not known: the largest queue is assumed
    assert bench.checks()["USB memory"].expected == f"at least {16 + 16 + 7 * 8 + 16} MB for 9 cameras"


def test_a_check_carries_its_facts(bench):
    bench.backend.unplug("S4D-12")
    checks = bench.checks()
    assert checks["camera cam11"].facts == {"cam11": {"connected": True, "serial": "S4D-11", "firmware": 1}}
    assert checks["camera cam12"].facts == {"cam12": {"connected": False, "fault": checks["camera cam12"].found}}


def test_a_machine_without_usb_information_is_not_judged_by_it(bench, tmp_path):
    checks = bench.checks(sysfs=tmp_path / "nothing")
    assert {name for name, check in checks.items() if check.passed is None} == {"USB topology", "USB memory"}
    assert failed(checks) == []


def altered(camera: UsbCamera, **change):
    """The camera with its blocks changed."""

    def read_block(timeout_s: float):
        block = camera.read_block(timeout_s)
        return block and dataclasses.replace(block, **change)

    return Odd(camera, read_block=read_block)


@pytest.mark.parametrize(
    ("spoil", "found"),
    [
        (lambda camera: altered(camera, device_time_ns=80_000), "at most 80.0 us, of cam12"),
        (lambda camera: altered(camera, sync_pulses=0), "cam12 counted 0 pulses"),
        (lambda camera: Odd(camera, read_block=lambda _: None), "no plane of cam12 after the trigger"),
    ],
)
def test_a_clock_that_does_not_latch_is_named(bench, spoil, found):
    bench.odd["cam12"] = spoil
    checks = bench.checks()
    assert failed(checks) == ["clock latch"]
    assert found in checks["clock latch"].found


def test_without_a_sync_line_nothing_is_claimed_of_the_clocks(bench):
    bench.line = False
    assert bench.checks()["clock latch"].passed is None


@pytest.mark.parametrize(
    ("speed", "free", "name", "found"),
    [
        (DiskSpeed(800.0, True), 10**12, "disk speed", "800 MB/s written directly"),
        (DiskSpeed(2400.0, False), 10**12, "disk speed", "2400 MB/s written through the page cache"),
        (DiskSpeed(3000.0, True), 9_000_000_000, "room", "4.0 s of recording"),
    ],
)
def test_a_slow_or_full_disk_is_refused(bench, monkeypatch, speed, free, name, found):
    monkeypatch.setattr(preflight_module, "write_speed", lambda *_: speed)
    monkeypatch.setattr(preflight_module, "free_bytes", lambda _: free)
    checks = bench.checks()
    assert failed(checks) == [name]
    assert checks[name].found.startswith(found)


def test_a_disk_that_cannot_be_written_is_refused(bench, monkeypatch):
    def refuse(*_):
        raise DiskError("/data: cannot be written (Read-only file system), expected a disk")

    monkeypatch.setattr(preflight_module, "write_speed", refuse)
    assert "Read-only" in bench.checks()["disk speed"].found


def refuse_direct(*_):
    raise OSError(22, "Invalid argument")


@pytest.mark.parametrize("direct", [True, False])
def test_the_disk_test_writes_for_as_long_as_told_and_leaves_nothing(tmp_path, monkeypatch, direct):
    monkeypatch.setattr(disk_speed_module, "_MOST_BYTES", 32 << 20)
    if not direct:
        monkeypatch.setattr(direct_module.fcntl, "fcntl", refuse_direct)
    seconds = itertools.count(0, 0.01)
    found = write_speed(tmp_path, 1.0, clock=lambda: next(seconds))
    assert found.mb_s > 0
    assert direct or not found.direct
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(disk_speed_module.shutil, "disk_usage", lambda _: type("Usage", (), {"free": 1000}))
    with pytest.raises(DiskError, match="no room for a disk test"):
        write_speed(tmp_path, 1.0)


def test_a_disk_test_where_nothing_can_be_written_says_so(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DiskError, match=r"file: cannot be written \(Not a directory\)"):
        write_speed(tmp_path / "file", 0.1)
    with pytest.raises(DiskError, match="gone: cannot be written"):
        write_speed(tmp_path / "gone", 0.1)


def test_the_command_says_what_to_change(spike4dgs, fast_disk, tmp_path, monkeypatch):
    (tmp_path / "small.toml").write_text(dump_rig(RIG.scaled(40, 25)))
    args = ("preflight", "--rig", tmp_path / "small.toml", "--devices", "mock:fan_and_ball", "--out", tmp_path)
    code, out, _ = spike4dgs(*args)
    assert code == 0
    assert out.endswith("lab3x3: ready\n")
    monkeypatch.setattr(preflight_module, "free_bytes", lambda _: 1_000_000)
    code, out, _ = spike4dgs(*args)
    assert code == 1
    assert "FAIL room: 0.0 s of recording (expected: 10 s)\n     -> free some space" in out
    code, out, _ = spike4dgs(*args, "--json")
    document = json.loads(out)
    assert (code, document["ready"]) == (1, False)
    assert [check["name"] for check in document["checks"] if check["passed"] is False] == ["room"]
    assert list(document["checks"][0]) == ["name", "passed", "found", "expected", "change"]


def test_the_command_without_cameras_fails_and_without_a_folder_is_refused(spike4dgs, fast_disk, tmp_path):
    code, out, _ = spike4dgs("preflight", "--rig", "lab3x3", "--out", tmp_path)
    assert code == 1
    assert out.count("FAIL camera") == 9
    code, out, err = spike4dgs("preflight", "--rig", "lab3x3", "--out", tmp_path / "gone")
    assert (code, out) == (2, "")
    assert "found no folder" in err[-1]


@pytest.mark.parametrize(
    ("fault", "line"),
    [
        ("missing", "FAIL camera cam12: found no camera with serial S4D-12"),
        ("firmware", "FAIL firmware: 1 in cam00"),
        ("deaf", "FAIL clock latch: no plane of cam12 after the trigger"),
        ("late", "FAIL clock latch: at most 1000.0 us, of cam12"),
        ("frozen", "FAIL clock rate: cam12 went 0.000000 s in "),
        ("noisy", "FAIL link errors: cam12: 3 errors, 1 recoveries"),
    ],
)
def test_each_bad_state_can_be_shown_on_the_mock_rig(spike4dgs, fast_disk, tmp_path, monkeypatch, fault, line):
    monkeypatch.setattr(preflight_module, "_LATCH_TIMEOUT_S", 0.3)
    uri = f"mock:flat?samples=1&fault={fault}:cam12"
    (tmp_path / "small.toml").write_text(dump_rig(RIG.scaled(40, 25)))
    code, out, _ = spike4dgs("preflight", "--rig", tmp_path / "small.toml", "--devices", uri, "--out", tmp_path)
    assert code == 1
    assert line in out
    assert out.count("FAIL") == 1


def test_a_fault_that_is_none_is_refused(spike4dgs, tmp_path):
    code, _, err = spike4dgs("preflight", "--rig", "lab3x3", "--devices", "mock:flat?fault=broken:cam12")
    assert code == 2
    assert "found the fault 'broken:cam12', expected one of missing, firmware, deaf, late, frozen, noisy" in err[-1]
