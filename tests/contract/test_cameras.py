"""Holds every camera back end to its contract with the driver above it."""

import contextlib
import dataclasses
import platform
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import libusb_package
import numpy as np
import pytest
import usb.core
from maintenance import usbip
from maintenance.device_clock import DeviceClock, Pace
from maintenance.strained_camera import StrainedModel, replug
from maintenance.trigger_line import TriggerWire
from maintenance.usb_models import CameraOnUsb

from acquisition.devices.mock import MockBackend
from acquisition.devices.profile import Profile, profiles
from acquisition.devices.protocol import Block, BlockStatus
from acquisition.devices.registers import LinkCounters, Request, Sensitivity, State, Status
from acquisition.devices.usb import CameraSetupError, SoftwareTrigger, UsbCamera
from acquisition.devices.usb_link import serial_of
from acquisition.errors import DeviceError
from acquisition.recording.reader import Recording
from acquisition.recording.verify import verify
from acquisition.recording.writer import RecordingWriter
from acquisition.session import capture as capture_module
from acquisition.session.session import Control, record_session
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

LAYOUT = PlaneLayout(9, 5)
RATE = 20_000.0
USBFS_MB = Path("/sys/module/usbcore/parameters/usbfs_memory_mb")
CAMERA = Camera("cam12", 9, 5, 8.0, 8.0, 4.5, 2.5, Transform.identity(), serial="A1")
PLANES = np.random.default_rng(0).integers(0, 256, (200, LAYOUT.plane_bytes), dtype=np.uint8)


class Stored:
    def __init__(self, planes: np.ndarray = PLANES, layout: PlaneLayout = LAYOUT):
        self.layout = layout
        self.left = planes

    def next_planes(self, count: int) -> np.ndarray:
        found, self.left = self.left[:count], self.left[count:]
        return found


class MockBench:
    """Cameras of a profile on the mock bus, and the hand that spoils them."""

    def __init__(self, profile: Profile):
        self.profile, self.models, self.backend = profile, [], MockBackend([])
        self.plug(self.camera("A1", Stored()))

    def camera(self, serial: str, source, **how) -> StrainedModel:
        return StrainedModel(serial, source, RATE, profile=self.profile, **how)

    @property
    def model(self) -> StrainedModel:
        return self.models[0]

    def plug(self, *models: StrainedModel) -> None:
        self.models += models
        self.backend = MockBackend(self.models)

    def fire(self) -> None:
        TriggerWire(self.models).fire()

    def unplug(self, serial: str = "A1") -> None:
        self.backend.unplug(serial)

    def replug(self, serial: str = "A1") -> None:
        replug(self.backend, serial)

    def limit_usbfs(self, megabytes: int) -> None:
        self.backend = MockBackend(self.models, megabytes << 20)

    def tree(self) -> list[str]:
        return [f"mock: {model.serial}" for model in self.models]

    def close(self) -> None:
        pass


class UsbIpBench(MockBench):
    """The same cameras on this kernel's own USB stack."""

    def __init__(self, profile: Profile):
        self.profile = profile
        self.models, self.devices, self.limit = [], {}, USBFS_MB.read_text()
        self.backend = libusb_package.get_libusb1_backend()
        self.limit_usbfs(256)
        self.plug(self.camera("A1", Stored()))

    def plug(self, *models: StrainedModel) -> None:
        self.models += models
        self.devices |= {model.serial: usbip.UsbIpDevice(CameraOnUsb(model)) for model in models}
        for model in models:
            wait_until(lambda serial=model.serial: serial in self.connected())

    def connected(self) -> set[str]:
        found = usb.core.find(find_all=True, backend=self.backend, idVendor=self.profile.vendor_id)
        return {serial_of(device) for device in found}

    def known(self) -> set[str]:
        """Serials of the devices that the kernel has: it may drop one later than its port answers for the next."""
        serials = set()
        for path in Path("/sys/bus/usb/devices").glob("*/serial"):
            with contextlib.suppress(OSError):  # it was dropped just now
                serials.add(path.read_text().strip())
        return serials

    def unplug(self, serial: str = "A1") -> None:
        self.devices.pop(serial).unplug()
        wait_until(lambda: serial not in self.known())

    def replug(self, serial: str = "A1") -> None:
        self.unplug(serial)
        [model] = [model for model in self.models if model.serial == serial]
        model.power_up()
        self.devices[serial] = usbip.UsbIpDevice(CameraOnUsb(model))
        wait_until(lambda: serial in self.connected())

    def limit_usbfs(self, megabytes: int) -> None:
        USBFS_MB.write_text(str(megabytes))

    def tree(self) -> list[str]:
        devices = sorted(path.parent for path in Path("/sys/bus/usb/devices").glob("*/product"))
        facts = ("speed", "idVendor", "idProduct", "product", "serial")
        return [
            "usb: " + " ".join((d / fact).read_text().strip() for fact in facts if (d / fact).exists()) for d in devices
        ]

    def close(self) -> None:
        USBFS_MB.write_text(self.limit)
        for device in self.devices.values():
            device.unplug()
        wait_until(lambda: self.known().isdisjoint(self.devices))


def release(model: StrainedModel) -> None:
    """Have the camera go on after it hung."""
    model.stream.hangs_after = None
    model.run.wake()


def wait_until(holds, tries: int = 1000) -> None:
    for _ in range(tries):
        if holds():
            return
        time.sleep(0.01)
    raise AssertionError("what was waited for did not happen")


BENCHES = [MockBench, *([UsbIpBench] if usbip.is_available() else [])]


@pytest.fixture(
    params=[(kind, profile) for kind in BENCHES for profile in profiles().values()],
    ids=lambda param: f"{param[0].__name__}-{param[1].name}",
)
def bench(request):
    kind, profile = request.param
    found = kind(profile)
    yield found
    found.close()


@pytest.fixture
def camera(bench):
    opened = UsbCamera.open(CAMERA, RATE, bench.backend)
    yield opened
    opened.close()


def read_blocks(camera: UsbCamera, first_s: float = 10.0) -> list[Block]:
    """All that come: a slow machine may take seconds to the first, and half a second's silence is the end."""
    first = camera.read_block(first_s)
    return [first, *iter(lambda: camera.read_block(0.5), None)] if first else []


def read_all(camera: UsbCamera) -> np.ndarray:
    return np.concatenate([block.packed for block in read_blocks(camera)])


def test_all_planes_arrive_bit_for_bit(bench, camera):
    assert camera.layout == LAYOUT
    camera.ensure_ready()
    assert camera.registers.read(Status).state is State.ARMED
    bench.fire()
    np.testing.assert_array_equal(read_all(camera), PLANES)
    assert camera.parser.damages == 0
    assert camera.registers.read(Status).emitted_planes == len(PLANES)


def test_a_rig_without_a_line_starts_by_command(camera):
    camera.ensure_ready()
    SoftwareTrigger([camera]).fire()
    assert camera.read_block(1).first_plane == 0


def test_an_armed_camera_sends_nothing_before_the_trigger(camera):
    camera.ensure_ready()
    assert camera.read_block(0.01) is None


def test_a_stopped_camera_can_be_armed_again(bench, camera):
    camera.ensure_ready()
    bench.fire()
    camera.read_block(1)
    camera.ensure_stopped()
    assert camera.registers.read(Status).state is State.IDLE
    bench.model.stream.source.left = PLANES
    camera.ensure_ready()
    bench.fire()
    assert camera.read_block(1).first_plane == 0


def test_what_came_before_the_time_was_over_is_a_short_read(bench, camera):
    bench.model.stream.hangs_after = 576 + 512  # a block, and half of the next: no short packet ends it
    camera.ensure_ready()
    bench.fire()
    assert camera.read_block(0.2).first_plane == 0
    assert camera.read_block(0.2) is None
    assert len(camera.parser._buffer) == 512
    release(bench.model)
    np.testing.assert_array_equal(read_all(camera), PLANES[80:])
    assert camera.parser.damages == 0


@pytest.mark.parametrize("sent", [0, 512, 576 + 512])
def test_a_stall_is_cleared_and_costs_nothing(bench, camera, sent):
    bench.model.stream.hangs_after = sent
    camera.ensure_ready()
    bench.fire()
    bench.model.stream.halted = True
    release(bench.model)
    first = camera.read_block(0.2)
    assert first is None or sent > 576
    np.testing.assert_array_equal(np.concatenate([*([first.packed] if first else []), read_all(camera)]), PLANES)
    assert camera.parser.damages == 0


def test_a_damaged_block_is_dropped_and_counted(bench, camera):
    bench.model.stream.flipped.append(100)
    camera.ensure_ready()
    bench.fire()
    np.testing.assert_array_equal(read_all(camera), PLANES[80:])
    assert camera.parser.damages == 1


def test_damage_without_an_end_is_no_block_and_ends_a_read(bench, camera, monkeypatch):
    stream, sent = bench.model.stream, []
    block = bytearray(stream.next_block())
    block[100] ^= 16

    def damaged() -> bytes:
        sent.append(len(block))
        return bytes(block) if len(sent) < 100_000 else b""

    monkeypatch.setattr(stream, "next_block", damaged)
    camera.ensure_ready()
    bench.fire()
    assert camera.read_block(0.05) is None
    assert len(sent) < 100_000
    assert camera.parser.skipped_bytes > 0


def test_an_unplugged_camera_is_named_at_once_and_ever_after(bench, camera):
    camera.ensure_ready()
    bench.unplug()
    for call in (
        lambda: camera.read_block(600),
        lambda: camera.read_block(600),
        camera.ensure_ready,
        camera.start_acquiring,
    ):
        with pytest.raises(DeviceError, match=r"cam12 \(serial A1\): it is not connected any more"):
            call()
    camera.ensure_stopped()


def test_a_camera_that_came_back_is_another_device(bench, camera):
    camera.ensure_ready()
    bench.fire()
    bench.replug()
    with pytest.raises(DeviceError, match="not connected any more"):
        read_all(camera)
    bench.model.stream.source.left = PLANES
    again = UsbCamera.open(CAMERA, RATE, bench.backend)
    again.ensure_ready()
    bench.fire()
    np.testing.assert_array_equal(read_all(again), PLANES)
    again.close()


def test_one_of_nine_that_is_unplugged_costs_the_others_nothing(bench):
    planes = np.random.default_rng(1).integers(0, 256, (4000, LAYOUT.plane_bytes), dtype=np.uint8)
    bench.plug(*(bench.camera(f"N{i}", Stored(planes)) for i in range(9)))
    cameras = [
        UsbCamera.open(dataclasses.replace(CAMERA, id=f"cam{i}", serial=f"N{i}"), RATE, bench.backend) for i in range(9)
    ]
    bench.models[5].stream.hangs_after = 576 * 20 + 512
    with ThreadPoolExecutor(9) as pool:
        for camera in cameras:
            camera.ensure_ready()
        tasks = [pool.submit(read_all, camera) for camera in cameras]
        bench.fire()
        bench.unplug("N4")
        for i, task in enumerate(tasks):
            if i == 4:
                # A transfer that was under way as the plug was pulled may end with an error of the wire first.
                gone = "it is not connected any more|the transfer failed on the wire"
                with pytest.raises(DeviceError, match=rf"cam4 \(serial N4\): ({gone})"):
                    task.result()
            else:
                np.testing.assert_array_equal(task.result(), planes)
    for camera in cameras:
        camera.close()


def test_a_full_kernel_is_one_line_and_no_hang(bench, camera):
    bench.limit_usbfs(3)
    camera.close()
    camera = UsbCamera.open(CAMERA, RATE, bench.backend)
    with pytest.raises(DeviceError, match=r"cam12 .*memory for USB transfers full .* write 256 to \S*usbfs_memory_mb$"):
        camera.ensure_ready()
    camera.close()
    bench.limit_usbfs(16)
    camera = UsbCamera.open(CAMERA, RATE, bench.backend)
    camera.ensure_ready()
    bench.fire()
    np.testing.assert_array_equal(read_all(camera), PLANES)
    camera.close()


def test_what_a_slow_reader_loses_is_counted_to_the_plane(bench):
    planes = np.random.default_rng(2).integers(0, 256, (2000, LAYOUT.plane_bytes), dtype=np.uint8)
    now_s = [0.0]
    bench.plug(bench.camera("P1", Stored(planes), pace=Pace(160, lambda: now_s[0])))
    camera = UsbCamera.open(dataclasses.replace(CAMERA, serial="P1"), RATE, bench.backend)
    camera.ensure_ready()
    bench.fire()
    blocks = []
    for due in (80, 160, 900, 980, 1700, 5000):
        now_s[0] = (due + 0.5) / RATE
        blocks += read_blocks(camera, first_s=0.5)
    lost, next_plane = 0, 0
    for block in blocks:
        lost += block.first_plane - next_plane
        next_plane = block.first_plane + len(block.packed)
        assert block.dropped_planes == lost
        np.testing.assert_array_equal(block.packed, planes[block.first_plane : next_plane])
        assert bool(block.status & BlockStatus.OVERRUN) == bool(block.status & BlockStatus.DISCARDED)
    status = camera.registers.read(Status)
    assert sum(len(block.packed) for block in blocks) + status.dropped_planes == status.emitted_planes == 2000
    assert lost > 0
    assert any(block.status & BlockStatus.OVERRUN for block in blocks)
    camera.close()


def test_a_repeated_block_is_no_damage(bench, camera, monkeypatch):
    send = bench.model.stream.next_block
    monkeypatch.setattr(bench.model.stream, "next_block", lambda: 2 * send())
    camera.ensure_ready()
    bench.fire()
    assert [block.first_plane for block in read_blocks(camera)] == [0, 0, 80, 80, 160, 160]  # a session takes one
    assert camera.parser.damages == 0


def test_every_block_tells_a_pulse_and_its_time(bench):
    clock = DeviceClock(offset_s=0.002, drift_ppm=50, missed=frozenset({4}))
    bench.plug(bench.camera("T1", Stored(np.zeros((4000, 6), np.uint8)), clock=clock))
    camera = UsbCamera.open(dataclasses.replace(CAMERA, serial="T1"), RATE, bench.backend)
    camera.ensure_ready()
    bench.fire()  # and a pulse each millisecond, which is 20 planes
    pairs = [(block.sync_pulses, block.pulse_time_s) for block in read_blocks(camera)]
    for k, (count, time_s) in enumerate(pairs):
        pulse = max(1, 4 * k)  # the clock is fast, so the pulse on the block's first plane comes after it
        pulse -= pulse == 4
        assert count == pulse - (pulse > 4)
        assert time_s == pytest.approx(0.002 + (pulse - 1) * 1e-3 * (1 + 50e-6), abs=1e-9)
    camera.close()


def test_how_fast_it_is(bench, capsys):
    layout = PlaneLayout(400, 250)
    planes = np.broadcast_to(np.arange(layout.plane_bytes).astype(np.uint8), (16_000, layout.plane_bytes))
    bench.plug(bench.camera("F1", Stored(planes, layout)))
    fast = dataclasses.replace(CAMERA, serial="F1", width=400, height=250)
    camera = UsbCamera.open(fast, RATE, bench.backend)
    camera.ensure_ready()
    bench.fire()
    start_s, taken = time.monotonic(), 0
    while taken < len(planes):
        taken += len(camera.read_block(10).packed)
    rate = taken * layout.plane_bytes / (time.monotonic() - start_s)
    tree = bench.tree()
    camera.close()
    with capsys.disabled():
        lines = [f"kernel {platform.release()}", *tree, f"{rate / 1e6:.0f} MB/s through one camera's driver"]
        sys.stdout.write("\n" + "".join(f"{type(bench).__name__}: {line}\n" for line in lines))


@pytest.mark.parametrize(
    ("change", "rate", "message"),
    [
        ({"serial": "B7"}, RATE, r"cam12: found no camera with serial B7 \(connected: A1\)"),
        ({"serial": ""}, RATE, "cam12: found no serial in the rig"),
        ({"width": 10}, RATE, "cam12: found a sensor of 9x5, expected 10x5"),
        ({}, 40_000.0, "cam12: found 20000 Hz, expected 40000 Hz"),
    ],
)
def test_a_camera_that_does_not_fit_the_rig_is_refused(bench, change, rate, message):
    with pytest.raises(CameraSetupError, match=message) as caught:
        UsbCamera.open(dataclasses.replace(CAMERA, **change), rate, bench.backend)
    assert caught.value.exit_code == 2
    UsbCamera.open(CAMERA, RATE, bench.backend).close()  # and is not held


def test_an_answer_that_is_no_register_names_the_camera(bench, camera):
    read = bench.model.read
    answers = {Request.STATUS: b"short"}
    bench.model.messages._read = bench.model.read = lambda request: answers.get(request) or read(request)
    with pytest.raises(DeviceError, match=r"^cam12: found 5 B in the status register, expected 32"):
        camera.registers.read(Status)


def test_a_camera_in_use_says_so(bench, camera):
    with pytest.raises(DeviceError, match="another program holds it"):
        UsbCamera.open(CAMERA, RATE, bench.backend)


def test_a_device_that_may_not_be_opened_does_not_hide_the_others(bench, monkeypatch):
    def refuse(handle):
        raise usb.core.USBError("Access denied (insufficient permissions)", -3, 13)

    monkeypatch.setattr(bench.backend, "open_device", refuse)
    with pytest.raises(CameraSetupError, match="connected: unreadable"):
        UsbCamera.open(CAMERA, RATE, bench.backend)


def test_threshold_and_exposure_are_set_while_idle_only(bench, camera):
    assert camera.registers.read(Sensitivity) == Sensitivity(1000, 1000)
    camera.registers.set_sensitivity(Sensitivity(2000, 500))
    assert bench.model.sensitivity.gain == 0.25
    with pytest.raises(CameraSetupError, match="cam12: found the threshold 4001, expected 250 to 4000"):
        camera.registers.set_sensitivity(Sensitivity(4001))
    camera.ensure_ready()
    with pytest.raises(DeviceError, match="cam12"):
        camera.registers.set_sensitivity(Sensitivity())
    assert camera.registers.read(Sensitivity) == Sensitivity(2000, 500)


def test_the_clock_is_latched_against_the_host_s(bench, camera):
    first = camera.registers.latch()
    assert first.run_s is None
    camera.ensure_ready()
    bench.fire()
    time.sleep(0.05)
    second = camera.registers.latch()
    apart = first.uncertainty_s + second.uncertainty_s + 1e-6
    assert second.oscillator_s - first.oscillator_s == pytest.approx(second.host_s - first.host_s, abs=apart)
    assert 0.05 <= second.run_s < second.oscillator_s


def test_what_the_link_counts_is_read(bench, camera):
    assert camera.registers.read(LinkCounters) == LinkCounters()
    bench.model.run.link = LinkCounters(3, 1, 0)
    assert camera.registers.read(LinkCounters) == LinkCounters(3, 1, 0)


def test_a_camera_that_was_reset_by_the_host_is_opened_again(bench, camera):
    camera.ensure_ready()
    bench.fire()
    assert camera.read_block(1).first_plane == 0
    camera.reset()
    wait_until(lambda: reopens(camera))
    bench.model.stream.source.left = PLANES
    camera.ensure_ready()
    bench.fire()
    np.testing.assert_array_equal(read_all(camera), PLANES)


def reopens(camera: UsbCamera) -> bool:
    try:
        camera.reopen()
    except DeviceError:
        return False
    return True


def test_a_camera_that_was_plugged_in_anew_is_opened_again_and_keeps_time(bench):
    """By the pulses of the shared line: it starts at the first one after it was armed."""
    bench.plug(bench.camera("R1", Counted(), pace=Pace(1 << 30)))
    model = bench.models[-1]
    camera = UsbCamera.open(dataclasses.replace(CAMERA, serial="R1"), RATE, bench.backend)
    camera.ensure_ready()
    bench.fire()
    while not (block := camera.read_block(1)):
        pass
    began_s = model.run.started_s
    assert block.first_plane == 0
    bench.replug("R1")
    assert model.run.state is State.IDLE
    wait_until(lambda: reopens(camera))
    camera.ensure_ready(joins=True)
    while not (block := camera.read_block(1)):
        pass
    assert (block.first_plane, block.device_time_ns) == (0, 0)
    pulses = (model.run.started_s - began_s) / 1e-3
    assert pulses == pytest.approx(round(pulses), abs=1e-6)
    camera.close()


class Counted:
    """Planes that say which one they are, from 1, for ever."""

    layout = LAYOUT

    def __init__(self):
        self.given = 0

    def next_planes(self, count: int) -> np.ndarray:
        numbers = np.arange(self.given + 1, self.given + count + 1, dtype="<u8")
        self.given += count
        return numbers.view(np.uint8).reshape(count, 8)[:, : LAYOUT.plane_bytes]


def numbers_in(packed: np.ndarray) -> np.ndarray:
    wide = np.zeros((len(packed), 8), np.uint8)
    wide[:, : LAYOUT.plane_bytes] = packed
    return wide.view("<u8")[:, 0]


PULSES_S = 0.1  # half of it is more than a clock is latched to: 23 ms where the whole processor is emulated


@pytest.fixture
def run(bench, tmp_path):
    """Records cameras K1 and K2, which live in real time, until K2 was lost, came back and sent a while."""
    bench.plug(*(bench.camera(serial, Counted(), pace=Pace(1 << 30)) for serial in ("K1", "K2")))
    models = bench.models[-2:]
    rig = Rig("two", RATE, tuple(dataclasses.replace(CAMERA, id=f"cam0{n}", serial=f"K{n + 1}") for n in range(2)))

    def start(trigger, lose, rejoin_s: float, *, returns: bool = True):
        control, began = Control(), []

        def play() -> None:
            wait_until(lambda: models[1].run.emitted_planes > 2 * PULSES_S * RATE)
            began.append(models[1].run.started_s)
            lose()
            if returns:
                wait_until(lambda: models[1].run.state is State.RUNNING and models[1].run.started_s != began[0])
                wait_until(lambda: models[1].run.emitted_planes > 2 * PULSES_S * RATE)
                began.append(models[1].run.started_s)
            else:
                time.sleep(0.1 + 2 * rejoin_s)
            control.stop.set()

        cameras = [UsbCamera.open(camera, RATE, bench.backend) for camera in rig.cameras]
        line = SoftwareTrigger(cameras) if trigger == "software" else TriggerWire(models, period_s=PULSES_S)
        try:
            with RecordingWriter(tmp_path / "rec", rig, 0) as recording, ThreadPoolExecutor(1) as pool:
                task = pool.submit(play)
                record_session(cameras, line, None, recording, control=control, rejoin_s=rejoin_s)
                task.result()
                recording.commit(recording.entries(), line.kind)
        finally:
            for camera in cameras:
                camera.close()
        assert verify(tmp_path / "rec") == []
        return Recording.open(tmp_path / "rec"), began

    start.models = models
    return start


def test_a_camera_that_came_back_rejoins_its_run(run, bench):
    recording, began = run("line", lambda: bench.replug("K2"), 20.0)
    first, lost = (recording.manifest.camera(camera_id) for camera_id in ("cam00", "cam01"))
    assert recording.manifest.status == "incomplete"
    assert "placed by a pulse" in recording.manifest.reason
    assert first.gaps == ()
    assert first.planes == lost.planes
    np.testing.assert_array_equal(numbers_in(recording.stream("cam00").packed), np.arange(1, first.planes + 1))
    place = round((began[1] - began[0]) * RATE)
    numbers = numbers_in(recording.stream("cam01").packed)
    [gap] = lost.gaps
    assert (gap.first_plane + gap.planes, gap.layer) == (place, "link")
    np.testing.assert_array_equal(numbers[: gap.first_plane], np.arange(1, gap.first_plane + 1))
    assert not numbers[gap.first_plane : place].any()
    assert (np.diff(numbers[place:].astype(int)) == 1).all()
    assert numbers[place] > gap.first_plane
    assert lost.device["returns"] == [{"run_s": pytest.approx(place / RATE), "uncertainty_s": 0.0}]
    assert lost.device["serial"] == "K2"


def test_a_camera_that_hangs_is_reset_and_rejoins(run, bench, monkeypatch):
    """Without a line its place is known to the time a request takes."""
    if not isinstance(bench.backend, MockBackend):
        pytest.skip("USB/IP does not tell a device of a reset of its port, which would end what it hangs in")
    monkeypatch.setattr(capture_module, "READ_TIMEOUT_S", 0.02)
    recording, began = run("software", lambda: setattr(run.models[1].stream, "hangs_after", 0), 20.0)
    lost = recording.manifest.camera("cam01")
    place = (began[1] - began[0]) * RATE
    [back] = lost.device["returns"]
    assert 0 < back["uncertainty_s"] < 0.1
    assert back["run_s"] * RATE == pytest.approx(place, abs=back["uncertainty_s"] * RATE + 1)
    assert lost.gaps[-1].first_plane + lost.gaps[-1].planes == round(back["run_s"] * RATE)
    assert "placed to" in recording.manifest.reason


@pytest.mark.parametrize("rejoin_s", [0.0, 0.2])
def test_a_camera_that_stays_away_is_given_up(run, bench, rejoin_s):
    recording, _ = run("line", lambda: bench.unplug("K2"), rejoin_s, returns=False)
    assert "it is not connected any more" in recording.manifest.reason
    assert recording.manifest.camera("cam01").device["returns"] == []
    assert recording.manifest.camera("cam00").gaps == ()
