"""Nine cameras to the disk, and what a camera, a person or a disk can do to that."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from maintenance.device_clock import DeviceClock
from maintenance.strained_camera import StrainedModel
from maintenance.trigger_line import TriggerWire

from acquisition.devices.device_model import DeviceModel
from acquisition.devices.mock import MockBackend
from acquisition.devices.open import Simulation, open_cameras, parse_devices
from acquisition.devices.profile import profiles
from acquisition.devices.registers import LinkCounters, Request, Sensitivity
from acquisition.devices.usb import CameraSetupError, SoftwareTrigger, UsbCamera
from acquisition.errors import BadRecordingError, DeviceError, DiskError
from acquisition.progress import silent
from acquisition.recording import writer as writer_module
from acquisition.recording.manifest import Gap
from acquisition.recording.reader import Recording
from acquisition.recording.verify import verify
from acquisition.recording.writer import RecordingWriter
from acquisition.scenes.catalog import build_scene
from acquisition.session import capture as capture_module
from acquisition.session.backlog import gaps_of
from acquisition.session.record import Take, record, simulate
from acquisition.session.session import Control, record_session
from acquisition.spikes.layout import PlaneLayout
from rigs.rig import Rig
from rigs.toml import catalog_rig

LAYOUT = PlaneLayout(33, 21)
PLANES = 250


class RandomSource:
    layout = LAYOUT

    def __init__(self, seed: int):
        self.all = np.random.default_rng(seed).integers(0, 256, (PLANES + 100, LAYOUT.plane_bytes), dtype=np.uint8)
        self.asked = 0

    def next_planes(self, count: int) -> np.ndarray:
        found = self.all[self.asked : self.asked + count]
        self.asked += count
        return found


class LossyModel(DeviceModel):
    """Loses its second block on the way."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        send = self.stream.next_block

        def next_block() -> bytes:
            if self.run.emitted_blocks == 1:
                send()
            return send()

        self.stream.next_block = next_block


class DeafModel(DeviceModel):
    """Never hears the trigger."""

    def trigger(self, period_s: float = 0.0) -> None:
        pass


class StubbornModel(DeviceModel):
    """Does not arm."""

    def write(self, request: int, data: bytes = b"") -> None:
        if request != Request.ARM:
            super().write(request, data)


class Bench:
    """A 3x3 rig on the mock bus; `odd` is the class of cam12."""

    def __init__(self, odd: type[DeviceModel] = DeviceModel):
        rig = catalog_rig("lab3x3").scaled(LAYOUT.width, LAYOUT.height)
        self.rig = dataclasses.replace(
            rig, cameras=tuple(dataclasses.replace(c, serial=f"S-{c.id}") for c in rig.cameras)
        )
        self.sources = {camera.id: RandomSource(seed) for seed, camera in enumerate(rig.cameras)}
        self.models = [
            (odd if c.id == "cam12" else DeviceModel)(c.serial, self.sources[c.id], rig.tick_rate_hz)
            for c in self.rig.cameras
        ]
        self.backend = MockBackend(self.models)
        self.trigger = TriggerWire(self.models)

    def record(self, out, trigger=None, progress=silent) -> None:
        cameras = [UsbCamera.open(c, self.rig.tick_rate_hz, self.backend) for c in self.rig.cameras]
        trigger = trigger or self.trigger
        try:
            with RecordingWriter(out, self.rig, 0) as recording:
                streams = record_session(cameras, trigger, PLANES, recording, progress)
                recording.commit([stream.entry() for stream in streams], trigger.kind)
        finally:
            for camera in cameras:
                camera.close()

    def states(self) -> set[str]:
        return {model.run.state.name for model in self.models}


def test_nine_cameras_are_on_the_disk_bit_for_bit(tmp_path):
    bench, fractions = Bench(), []
    bench.record(tmp_path / "rec", progress=lambda fraction, message: fractions.append(fraction))
    recording = Recording.open(tmp_path / "rec")
    assert recording.camera_ids == tuple(f"cam{r}{c}" for r in range(3) for c in range(3))
    assert recording.planes == PLANES
    for camera_id, source in bench.sources.items():
        assert (tmp_path / f"rec/{camera_id}.dat").read_bytes() == source.all[:PLANES].tobytes(), camera_id
        entry = recording.manifest.camera(camera_id)
        assert (entry.gaps, entry.skew_s, entry.first_tick) == ((), 0.0, 0)
    assert recording.manifest.trigger == "line"
    assert verify(tmp_path / "rec") == []
    assert bench.states() == {"IDLE"}
    assert fractions[-1] == 1.0
    assert fractions == sorted(fractions)


class DriftingModel(StrainedModel):
    """Its clock is 40 us ahead at the trigger and runs 50 ppm fast; it missed pulse 5."""

    def __init__(self, *arguments):
        super().__init__(*arguments, clock=DeviceClock(offset_s=40e-6, drift_ppm=50.0, missed=frozenset({5})))


def test_each_clock_is_told_from_the_sync_pulses(tmp_path):
    bench = Bench(DriftingModel)
    bench.trigger = TriggerWire(bench.models, period_s=0.5e-3)
    bench.record(tmp_path / "rec")
    manifest = Recording.open(tmp_path / "rec").manifest
    middle_s = PLANES / 20_000 / 2
    for camera in manifest.cameras:
        shown_s, drifted_s = (40e-6, 50e-6 * middle_s) if camera.id == "cam12" else (0.0, 0.0)
        assert camera.clock["skew_s"] == pytest.approx(shown_s + drifted_s, abs=1e-6)
        # A clock that has gone fast is early; what it showed at plane 0 moves no plane.
        assert camera.skew_s == pytest.approx(-drifted_s, abs=1e-6)
    assert manifest.camera("cam12").clock["drift_ppm"] == pytest.approx(50, abs=5)


class CutModel(StrainedModel):
    """Sees nine pulses, and then no more: its sync cable was pulled."""

    def __init__(self, *arguments):
        super().__init__(*arguments, clock=DeviceClock(missed=frozenset(range(10, 1000))))


def test_pulses_missed_behind_the_last_stamp_stand_in_the_manifest(tmp_path):
    bench = Bench(CutModel)
    bench.trigger = TriggerWire(bench.models, period_s=0.5e-3)
    bench.record(tmp_path / "rec")
    manifest = Recording.open(tmp_path / "rec").manifest
    found = manifest.camera("cam12").clock
    assert found["last_pulse"] == 8
    assert found["missed_pulses"] == list(range(9, 24))  # up to the start of the last block, at 12 ms
    assert {tuple(c.clock["missed_pulses"]) for c in manifest.cameras if c.id != "cam12"} == {()}


class NoisyModel(DeviceModel):
    """Its link has two errors in each block."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.stream.link_per_block = LinkCounters(errors=2)


def test_what_a_camera_says_of_itself_stands_in_the_manifest(tmp_path):
    bench, said = Bench(NoisyModel), []
    bench.record(tmp_path / "rec", progress=lambda fraction, message: said.append(message))
    manifest = Recording.open(tmp_path / "rec").manifest
    for camera in manifest.cameras:
        device = camera.device
        assert (device["serial"], device["firmware"]) == (f"S-{camera.id}", 1)
        assert device["sensitivity"] == {"threshold": 1000, "exposure": 1000}
        assert (device["link"]["errors"] > 0) == (camera.id == "cam12")
        assert device["first_latch"]["host_s"] <= device["last_latch"]["host_s"]
        assert device["returns"] == []
    assert any("8 of 9 cameras good, cam12 2 link errors" in message for message in said)


def test_threshold_and_exposure_change_the_spikes_and_leave_out_the_truth(tmp_path, small):
    uri = "mock:flat?sensor=ideal&samples=1&truth_every=200"
    rates = {}
    for name, sensitivity in (("nominal", None), ("dim", Sensitivity(2000, 500))):
        manifest = record(small, uri, Take(200, sensitivity=sensitivity), tmp_path / name)
        recording = Recording.open(tmp_path / name)
        rates[name] = recording.stream("cam11").counts(0, 200).mean()
        assert manifest.camera("cam11").device["sensitivity"] == dataclasses.asdict(sensitivity or Sensitivity())
        assert (recording.truth is not None) == (name == "nominal")
    assert rates["dim"] == pytest.approx(rates["nominal"] / 4, rel=0.02)
    with pytest.raises(CameraSetupError, match="cam00: found the threshold 9, expected 250 to 4000"):
        record(small, uri, Take(200, sensitivity=Sensitivity(9)), tmp_path / "wild")
    assert not (tmp_path / "wild").exists()


def test_a_pre_triggered_simulation_has_the_truth_of_what_was_recorded(tmp_path, small):
    one, control = small.only(["cam00"]), Control()

    def save_later(fraction, message):
        if message.endswith("planes seen") and int(message.split()[-3]) >= 100:
            control.save.set()

    uri = "mock:fan_and_ball?seed=3&samples=1&truth_every=30"
    record(one, uri, Take(60, 1.0, control=control), tmp_path / "rec", save_later)
    simulate(Simulation("fan_and_ball", 3, samples=1, truth_every=4000), one, 2000, tmp_path / "all")
    recording = Recording.open(tmp_path / "rec")
    everything, found = Recording.open(tmp_path / "all").stream("cam00").packed, recording.stream("cam00").packed
    [first] = [k for k in range(len(everything) - 60) if (everything[k : k + 60] == found).all()]
    assert first > 0
    scene = build_scene("fan_and_ball", 3)
    for plane in (0, 30):
        instant_s = one.clock.instant_s(first + plane)
        truth = scene.render(one.camera("cam00"), np.array([instant_s])).intensity[0]
        np.testing.assert_array_equal(np.load(recording.truth / f"cam00/{plane:06d}.npy"), truth)


def test_a_software_start_claims_no_skew(tmp_path):
    bench = Bench()
    cameras: list[UsbCamera] = []
    with RecordingWriter(tmp_path / "rec", bench.rig, 0) as recording:
        cameras += [UsbCamera.open(c, bench.rig.tick_rate_hz, bench.backend) for c in bench.rig.cameras]
        streams = record_session(cameras, SoftwareTrigger(cameras), PLANES, recording)
        manifest = recording.commit([stream.entry() for stream in streams], "software")
    for camera in cameras:
        camera.close()
    assert {c.skew_s for c in manifest.cameras} == {None}


def test_a_lost_block_is_zeros_in_its_place_and_listed(tmp_path):
    bench = Bench(odd=LossyModel)
    bench.record(tmp_path / "rec")
    recording = Recording.open(tmp_path / "rec")
    expected = bench.sources["cam12"].all[:PLANES].copy()
    expected[80:160] = 0
    np.testing.assert_array_equal(recording.stream("cam12").packed, expected)
    assert recording.manifest.camera("cam12").gaps == (Gap(80, 80, "link"),)
    assert sum(len(c.gaps) for c in recording.manifest.cameras) == 1
    assert verify(tmp_path / "rec") == []


def test_planes_the_device_dropped_are_told_from_those_the_link_lost():
    assert gaps_of(80, 50, 30) == [Gap(80, 30, "device"), Gap(110, 20, "link")]
    assert gaps_of(0, 5, 99) == [Gap(0, 5, "device")]
    assert gaps_of(7, 0, 0) == []


def test_an_unplugged_camera_costs_the_others_nothing(tmp_path):
    bench = Bench()
    source = bench.sources["cam12"]
    deliver = source.next_planes

    def pull_the_plug(count):
        if source.asked >= 160:
            bench.backend.unplug("S-cam12")
        return deliver(count)

    source.next_planes = pull_the_plug
    bench.record(tmp_path / "rec")
    recording = Recording.open(tmp_path / "rec")
    assert recording.manifest.status == "incomplete"
    assert re.fullmatch(r"cam12 \(serial S-cam12\): it is not connected any more; .*", recording.manifest.reason)
    for camera_id, source in bench.sources.items():
        planes = recording.manifest.camera(camera_id).written
        assert 0 < planes < PLANES if camera_id == "cam12" else planes == PLANES
        assert (tmp_path / f"rec/{camera_id}.dat").read_bytes() == source.all[:planes].tobytes(), camera_id
    assert verify(tmp_path / "rec") == []
    assert [m.serial for m in bench.models if m.run.state.name == "RUNNING"] == ["S-cam12"]


def test_a_camera_that_stays_silent_costs_the_others_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(capture_module, "READ_TIMEOUT_S", 0.01)
    bench = Bench(odd=DeafModel)
    bench.record(tmp_path / "rec")
    recording = Recording.open(tmp_path / "rec")
    assert recording.manifest.reason.startswith("cam12: found no data for 5 reads after 0 planes")
    assert {c.planes for c in recording.manifest.cameras if c.id != "cam12"} == {PLANES}
    assert verify(tmp_path / "rec") == []
    with pytest.raises(BadRecordingError, match="found no plane of cam12, expected at least one; mend or leave it out"):
        recording.stream("cam12")
    assert bench.states() == {"IDLE"}


def test_where_no_camera_sends_anything_nothing_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(capture_module, "READ_TIMEOUT_S", 0.01)
    bench = Bench()
    bench.trigger = TriggerWire([])
    with pytest.raises(DeviceError, match=r"cam00: found no data .* after 0 planes"):
        bench.record(tmp_path / "rec")
    assert list(tmp_path.iterdir()) == []
    assert bench.states() == {"IDLE"}


def test_a_camera_that_does_not_arm_stops_all_by_its_name(tmp_path):
    bench = Bench(odd=StubbornModel)
    with pytest.raises(DeviceError, match="cam12: found it idle after arming"):
        bench.record(tmp_path / "rec")
    assert list(tmp_path.iterdir()) == []
    assert bench.states() == {"IDLE"}
    assert all(source.asked == 0 for source in bench.sources.values())


def test_an_interrupt_leaves_nothing_and_stops_all(tmp_path):
    def interrupt(fraction: float, message: str) -> None:
        raise KeyboardInterrupt

    bench = Bench()
    with pytest.raises(KeyboardInterrupt):
        bench.record(tmp_path / "rec", progress=interrupt)
    assert list(tmp_path.iterdir()) == []
    assert bench.states() == {"IDLE"}


@pytest.fixture
def small() -> Rig:
    return catalog_rig("lab3x3").scaled(40, 25)


@pytest.mark.slow
def test_a_simulation_is_repeatable_and_has_its_truth(tmp_path, small):
    simulation = Simulation("fan_and_ball", seed=3, truth_every=30)
    simulate(simulation, small, 50, tmp_path / "a")
    record(small, "mock:fan_and_ball?seed=3&truth_every=30", 50, tmp_path / "b")
    simulate(dataclasses.replace(simulation, seed=4), small, 50, tmp_path / "c")
    recordings = [Recording.open(tmp_path / name) for name in "abc"]
    digests = [[c.sha256 for c in r.manifest.cameras] for r in recordings]
    assert digests[0] == digests[1]
    assert not set(digests[0]) & set(digests[2])
    assert len(set(digests[0])) == 9
    truth = recordings[0].truth
    assert sorted(p.name for p in (truth / "cam11").glob("0*.npy")) == ["000000.npy", "000030.npy"]
    assert (truth / "cameras.json").exists()
    light = np.load(truth / "cam11/000030.npy")
    rate = recordings[0].stream("cam11").counts(0, 50) / 50
    assert rate.mean() == pytest.approx(light.mean(), rel=0.02)  # measured 0.007: the camera sees what truth says
    for recording in recordings:
        assert verify(recording.path) == []
    assert list(tmp_path.glob("*.partial")) == []


def test_a_full_disk_is_refused_before_the_cameras_are_armed(tmp_path, small, monkeypatch):
    monkeypatch.setattr(writer_module, "free_bytes", lambda folder: 1_000_000)
    with pytest.raises(DiskError, match="found 1000000 bytes free, expected at least"):
        record(small, "mock:fan_and_ball", 10, tmp_path / "rec")
    assert list(tmp_path.iterdir()) == []


def test_the_disk_check_counts_spikes_and_truth(tmp_path, small, monkeypatch):
    monkeypatch.setattr(writer_module, "free_bytes", lambda folder: 0)
    with pytest.raises(DiskError) as caught:
        record(small, "mock:fan_and_ball?truth_every=5", 10, tmp_path / "rec")
    needed = int(str(caught.value).split("at least ")[1].split(";")[0])
    monkeypatch.undo()
    record(small, "mock:fan_and_ball?truth_every=5", 10, tmp_path / "rec")
    written = sum(path.stat().st_size for path in (tmp_path / "rec").rglob("*") if path.is_file())
    assert written <= needed


def test_a_taken_name_is_refused_before_a_camera_is_opened(tmp_path, small):
    (tmp_path / "rec").write_text("kept")
    with pytest.raises(BadRecordingError, match="exists already"):
        record(small, "mock:no_such_scene", 10, tmp_path / "rec")


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("pci:", "expected usb: or mock:SCENE"),
        ("mock:fan_and_ball?gain=3", "found gain, expected seed, sensor, samples, truth_every, fault"),
        ("mock:fan_and_ball?seed=-3", "expected a whole number"),
        ("mock:fan_and_ball?sensor=perfect", "found the sensor 'perfect'"),
        ("mock:fan_and_ball?samples=0", "at least 1"),
        ("mock:fan_and_ball?samples=9999", "at most 8"),
        ("mock:fan_and_ball?light=0", "found the light 0.0, expected a factor above 0"),
        ("mock:fan_and_ball?profile=usb4", "found the profile 'usb4', expected one of direct, ft60x"),
    ],
)
def test_a_device_uri_that_cannot_be_is_refused(uri, message):
    with pytest.raises(CameraSetupError, match=message):
        parse_devices(uri)


def test_a_device_uri_says_what_simulated_cameras_see():
    assert parse_devices("usb:") is None
    assert parse_devices("mock:fan_and_ball") == Simulation("fan_and_ball", 0, "real", 2, None)
    assert parse_devices("mock:x?seed=7&sensor=ideal&samples=1&truth_every=5") == Simulation("x", 7, "ideal", 1, 5)


def test_every_profile_can_be_simulated_and_sends_the_same_planes(tmp_path, small):
    pair, digests = small.only(["cam00", "cam01"]), set()
    for name in profiles():
        uri = f"mock:fan_and_ball?samples=1&truth_every=1000&profile={name}"
        with open_cameras(pair, parse_devices(uri), 5) as opened:
            assert {camera.profile.name for camera in opened.cameras} == {name}
        manifest = record(pair, uri, 100, tmp_path / name)
        digests.add(tuple(camera.sha256 for camera in manifest.cameras))
    assert len(digests) == 1


def test_a_recording_is_replayed_bit_for_bit(tmp_path, small):
    record(small, "mock:fan_and_ball?samples=1&truth_every=1000", 100, tmp_path / "a")
    for planes in (100, 33):
        record(small, f"replay:{tmp_path / 'a'}", planes, tmp_path / f"b{planes}")
        for camera_id in small.ids:
            original = (tmp_path / f"a/{camera_id}.dat").read_bytes()
            replayed = (tmp_path / f"b{planes}/{camera_id}.dat").read_bytes()
            assert replayed == original[: planes * 125], camera_id
        assert verify(tmp_path / f"b{planes}") == []
        assert not (tmp_path / f"b{planes}/truth").exists()
    assert parse_devices("replay:a b?c") == Path("a b?c")


def test_a_recording_that_does_not_fit_the_rig_is_not_replayed(tmp_path, small):
    record(small.only(["cam00", "cam01"]), "mock:fan_and_ball?samples=1&truth_every=1000", 5, tmp_path / "pair")
    with pytest.raises(CameraSetupError, match="found no stream of cam02, cam10"):
        record(small, f"replay:{tmp_path / 'pair'}", 5, tmp_path / "rec")
    with pytest.raises(CameraSetupError, match="found a sensor of 40x25, expected 20x20"):
        record(small.only(["cam00"]).scaled(20, 20), f"replay:{tmp_path / 'pair'}", 5, tmp_path / "rec")
    with pytest.raises(BadRecordingError, match="expected a recording folder"):
        record(small, f"replay:{tmp_path / 'nowhere'}", 5, tmp_path / "rec")
    assert [path.name for path in tmp_path.iterdir()] == ["pair"]


def test_a_pre_trigger_that_does_not_fit_the_memory_is_refused(tmp_path, small):
    with pytest.raises(BadRecordingError, match="found a pre-trigger of 22500000000000000 bytes"):
        record(small, "mock:fan_and_ball", Take(None, 1e12), tmp_path / "rec")
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_scene_is_refused(small):
    with pytest.raises(BadRecordingError, match="fan_and_ball"), open_cameras(small, Simulation("nowhere"), 10):
        pass


@pytest.mark.parametrize("ticks", [1, 100])
def test_a_recording_that_would_end_before_its_trigger_is_refused(tmp_path, small, ticks):
    with pytest.raises(BadRecordingError, match=f"found {ticks} ticks with the 100 before the trigger, expected more"):
        record(small, "mock:fan_and_ball", Take(ticks, 5.0), tmp_path / "rec")
    assert list(tmp_path.iterdir()) == []
