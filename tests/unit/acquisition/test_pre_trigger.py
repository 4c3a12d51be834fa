"""Runs that wait to be saved begin at one instant of the rig clock, whatever a single camera does."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from maintenance.plain_camera import PlainCamera

from acquisition.devices.protocol import Block
from acquisition.errors import DeviceError
from acquisition.session.alignment import align_by_light
from acquisition.session.capture import SILENT_READS, Capture, CaptureRules
from acquisition.session.session import Control, _Run
from acquisition.spikes.layout import PlaneLayout

LAYOUT = PlaneLayout(32, 1)
RATE_HZ, PERIOD_S, BLOCK_PLANES = 1000.0, 0.01, 50


class Ring:
    """Takes every plane, and keeps its number, -1 where it was lost."""

    layout, gaps, failure = LAYOUT, (), None

    def __init__(self):
        self.kept, self.skew_s, self.clock = [], None, None

    @property
    def planes(self) -> int:
        return len(self.kept)

    def offer(self, packed) -> bool:
        self.kept += np.ascontiguousarray(packed).view("<u4")[:, 0].tolist()
        return True

    append = offer

    def append_lost(self, gaps) -> None:
        self.kept += [-1] * sum(gap.planes for gap in gaps)

    def close_keeping(self) -> None:
        pass


class Ticking(PlainCamera):
    """Sends planes with their numbers by a clock that is `ahead_s` at the trigger and fast by `drift_ppm`.

    All its times are `shown_s` later: that is what the clock shows at plane 0.
    """

    layout = LAYOUT

    def __init__(self, camera_id: str, ahead_s: float = 0.0, drift_ppm: float = 0.0, shown_s: float = 0.0):
        super().__init__()
        self.shown_s = shown_s
        self.id, self.ahead_s, self.drift, self.at = camera_id, ahead_s, drift_ppm * 1e-6, 0
        self.until, self.stop = 0, threading.Event()

    def read_block(self, timeout_s):
        own_s, first = self.at / RATE_HZ, self.at
        pulse = max(0, int((own_s - self.ahead_s) / (1 + self.drift) / PERIOD_S))
        stamp_s = self.ahead_s + pulse * PERIOD_S * (1 + self.drift)
        numbers = np.arange(first, first + BLOCK_PLANES, dtype="<u4")
        self.at += BLOCK_PLANES
        if self.at >= self.until:
            self.stop.set()
        times_ns = round((own_s + self.shown_s) * 1e9), round((own_s - stamp_s) * 1e9)
        packed = numbers.view(np.uint8).reshape(-1, 4)
        return Block(first, first, times_ns[0], LAYOUT, packed, pulse + 1, 0, 0, max(0, times_ns[1]))


class Bench:
    """Captures of `cameras` that wait to be saved, `seconds` of the rig clock after the trigger."""

    def __init__(self, cameras, pre_planes: int | None, planes: int | None = None):
        rules = CaptureRules(RATE_HZ, planes=planes, pre_planes=pre_planes, period_s=PERIOD_S, rejoin_s=5.0)
        self.captures = [Capture(camera, Ring(), rules) for camera in cameras]
        rig = SimpleNamespace(tick_rate_hz=RATE_HZ)
        self.recording = SimpleNamespace(full=None, rig=rig, trigger_plane=None, first_plane=0, problems=[])
        self.control = Control()
        self.run = _Run(self.captures, rules, self.recording, self.control)

    def play(self, until_s: float) -> None:
        for capture in self.captures:
            camera = capture.camera
            camera.until, camera.stop = round(until_s * (1 + camera.drift) * RATE_HZ), threading.Event()
            capture.run(camera.stop)

    def save(self) -> None:
        self.control.save.set()
        self.run.steer()


@pytest.mark.parametrize("how", ["looked for", "silent"])
def test_a_camera_that_is_gone_does_not_move_the_beginning_of_the_others(how):
    bench = Bench([Ticking("cam00"), Ticking("cam01"), Ticking("cam02")], 500, 1000)
    for capture, position in zip(bench.captures, (60_000, 59_950, 56_000), strict=True):
        capture.position = position
    bench.captures[2].contact.away = how == "looked for"
    bench.save()
    reached = {"looked for": 59_950, "silent": 60_000 - 125}[how]  # half of what is held beside the pre-trigger
    assert (bench.recording.first_plane, bench.recording.trigger_plane) == (reached - 500, 500)


def test_without_any_other_a_camera_that_is_gone_says_where_to_begin():
    bench = Bench([Ticking("cam00"), Ticking("cam01")], 500)
    for capture, position in zip(bench.captures, (7000, 9000), strict=True):
        capture.position, capture.contact.away = position, True
    bench.captures[1].failure = DeviceError("cam01: gone")
    bench.save()
    assert bench.recording.first_plane == 6500


def test_cameras_whose_clocks_drift_begin_at_one_instant():
    bench = Bench([Ticking("fast", drift_ppm=80), Ticking("true"), Ticking("slow", drift_ppm=-80)], 300, 2000)
    bench.play(60.0)
    bench.save()
    bench.play(65.0)
    first = bench.recording.first_plane
    kept = [capture.writer.kept for capture in bench.captures]
    assert [numbers[0] - first for numbers in kept] == [5, 0, -5]  # 80e-6 * 59.7 s is 4.8 planes
    assert [len(numbers) for numbers in kept] == [2000] * 3
    assert all(-1 not in numbers for numbers in kept)
    for capture, drift in zip(bench.captures, (80e-6, 0, -80e-6), strict=True):
        capture.tell_clock()
        middle_s = (first + 1000) / RATE_HZ
        assert capture.writer.clock["skew_s"] == pytest.approx(drift * middle_s, abs=1e-7)
        late_s = capture.lead / RATE_HZ - drift * middle_s
        assert capture.writer.skew_s == pytest.approx(late_s, abs=1e-7)
        assert abs(capture.writer.skew_s) < 0.5 / RATE_HZ


@pytest.mark.parametrize("pre_planes", [300, None])
def test_what_a_clock_shows_at_plane_0_moves_nothing(pre_planes):
    """Planes and pulses are both told by it, so that it cancels."""
    bench = Bench([Ticking("shows more", drift_ppm=80, shown_s=1e-3), Ticking("usual", drift_ppm=80)], pre_planes, 2000)
    bench.run.steer() if pre_planes is None else bench.play(60.0)
    bench.save()
    bench.play(65.0)
    for capture in bench.captures:
        capture.tell_clock()
    shown, usual = bench.captures
    assert shown.lead == usual.lead
    assert shown.writer.skew_s == pytest.approx(usual.writer.skew_s, abs=1e-9)
    assert shown.writer.clock["skew_s"] - usual.writer.clock["skew_s"] == pytest.approx(1e-3, abs=1e-9)


def test_where_a_camera_that_was_away_lies_is_not_measured():
    bench = Bench([Ticking("cam00", drift_ppm=80)], None, 2000)
    bench.run.steer()
    bench.captures[0].returned.append("cam00 was away")
    bench.captures[0]._stamps.add(0, 0.0, recorded=True)
    bench.play(2.0)
    bench.captures[0].tell_clock()
    assert bench.captures[0].writer.skew_s is None


def test_a_clock_that_cannot_be_right_moves_nothing():
    bench = Bench([Ticking("cam00", ahead_s=0.5)], 300, 2000)
    bench.play(20.0)
    bench.save()
    assert bench.captures[0].lead == 0


def test_late_planes_have_a_positive_skew_from_pulses_and_from_light():
    late_s = 0.004
    bench = Bench([Ticking("cam00", ahead_s=-late_s)], None, 2000)
    bench.run.steer()
    bench.play(2.0)
    bench.captures[0].tell_clock()
    assert bench.captures[0].writer.skew_s == pytest.approx(late_s, abs=1e-7)
    rng = np.random.default_rng(0)
    rates = [0.2 + 0.3 * (np.arange(100) + begins >= 60) + rng.normal(0, 1e-3, 100) for begins in (0, 4)]
    planes, _ = align_by_light(dict(zip("ab", rates, strict=True)))["b"]
    assert planes / RATE_HZ == pytest.approx(late_s, abs=1e-4)


def test_a_camera_that_sends_damage_alone_fails_and_says_so():
    class Damaged(Ticking):
        def read_block(self, timeout_s):
            if self.at < 3 * BLOCK_PLANES:
                return super().read_block(timeout_s)
            self.parser.skipped_bytes += 1000
            return None

    bench = Bench([Damaged("cam00")], None)
    bench.run.steer()
    bench.captures[0].camera.until = 1 << 40
    bench.captures[0].run(threading.Event())
    found = f"found {1000 * SILENT_READS} damaged bytes alone for {SILENT_READS} reads after 150 planes"
    assert found in str(bench.captures[0].failure)
