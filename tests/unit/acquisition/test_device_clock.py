import numpy as np
import pytest
from maintenance.device_clock import DeviceClock

from acquisition.errors import DeviceError

PERIOD_S = 1e-3


def test_a_perfect_clock_latches_each_pulse_when_it_comes():
    clock = DeviceClock()
    assert clock.seen(0.0, PERIOD_S) == (1, 0.0)
    assert clock.seen(0.0015, PERIOD_S) == (2, 0.001)
    assert clock.seen(0.004, PERIOD_S) == (5, pytest.approx(0.004))


@pytest.mark.parametrize("drift_ppm", [-50, 0, 50])
def test_drift_offset_and_jitter_are_what_a_fit_finds_again(drift_ppm):
    clock = DeviceClock(offset_s=0.25, drift_ppm=drift_ppm, jitter_s=200e-9, seed=4)
    seen = [clock.seen(0.25 + k * 0.004 + 0.0005, PERIOD_S) for k in range(2000)]
    pulses, times_s = np.array(seen).T
    slope, offset_s = np.polyfit((pulses - 1) * PERIOD_S, times_s - 0.25, 1)
    assert (slope - 1) * 1e6 == pytest.approx(drift_ppm, abs=0.02)  # measured 0.002
    assert abs(offset_s) < 50e-9  # measured 3e-9
    residual_s = times_s - 0.25 - offset_s - slope * (pulses - 1) * PERIOD_S
    assert residual_s.std() == pytest.approx(200e-9, rel=0.1)
    assert clock.seen(5.0, PERIOD_S) == DeviceClock(0.25, drift_ppm, 200e-9, seed=4).seen(5.0, PERIOD_S)


def test_a_missed_pulse_leaves_the_count_one_behind_and_no_time():
    clock = DeviceClock(missed=frozenset({3, 4}))
    found = [clock.seen(n * PERIOD_S + 1e-4, PERIOD_S) for n in range(6)]
    assert [count for count, _ in found] == [1, 2, 2, 2, 3, 4]
    assert [time_s for _, time_s in found] == pytest.approx([0, 1e-3, 1e-3, 1e-3, 4e-3, 5e-3])


def test_no_pulse_is_seen_before_the_first():
    assert DeviceClock(offset_s=1.0).seen(0.5, PERIOD_S) == (0, None)


@pytest.mark.parametrize("fault", [{"offset_s": -1}, {"jitter_s": -1}, {"missed": frozenset({1})}])
def test_a_clock_that_cannot_be_is_refused(fault):
    with pytest.raises(DeviceError, match="expected offset and jitter from 0"):
        DeviceClock(**fault)
