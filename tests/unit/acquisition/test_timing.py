"""Clocks from sync pulses: what was injected is found, what is missing is named, what cannot be told is refused."""

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.session.timing import MOST_STAMPS, StampLog, TimingError, estimate_clock

PERIOD_S = 1e-3


def stamped(pulses: np.ndarray, offset_s: float, drift_ppm: float, jitter_s: float, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, jitter_s, len(pulses))
    return offset_s + (1 + drift_ppm * 1e-6) * pulses * PERIOD_S + noise


@given(
    st.floats(-50, 50),
    st.floats(-2e-4, 0.5),
    st.integers(1000, 20_000),
    st.floats(0, 2e-6),
    st.floats(0, 0.05),
    st.integers(0, 2**32),
)
def test_skew_is_within_a_microsecond(drift_ppm, offset_s, count, jitter_s, missed_share, seed):
    seen = np.flatnonzero(np.r_[True, np.random.default_rng(seed).random(count - 2) >= missed_share, True])
    stamps = stamped(seen, offset_s, drift_ppm, jitter_s, seed)
    duration_s = count * PERIOD_S
    found = estimate_clock(np.arange(len(seen)), stamps, PERIOD_S, duration_s)
    true = offset_s + drift_ppm * 1e-6 * duration_s / 2
    assert abs(found.skew_s - true) < 1e-6
    assert abs(found.skew_s - true) < 6 * found.skew_sd_s + 1e-9
    assert found.missed_pulses == tuple(np.setdiff1d(np.arange(count), seen).tolist())
    assert found.missed_between == ()
    assert found.drift_ppm == pytest.approx(drift_ppm, abs=6 * found.drift_sd_ppm + 1e-6)
    assert found.offset_s == pytest.approx(offset_s, abs=1e-6)


def test_a_stamp_a_block_is_enough_and_may_repeat():
    """Blocks tell the last pulse before them: not all of fast pulses, the same one twice of slow ones."""
    stamps = stamped(np.arange(3000), 1e-5, 40, 3e-7)
    seen = np.setdiff1d(np.arange(3000), [7, 1501])
    counted = np.arange(len(seen))
    taken = np.r_[0, np.arange(3, len(seen), 4).repeat(2)]
    found = estimate_clock(counted[taken], stamps[seen][taken], PERIOD_S, 3.0)
    assert found.skew_s == pytest.approx(1e-5 + 40e-6 * 1.5, abs=1e-6)
    assert (found.missed_pulses, found.pulses) == ((), 1 + 749)
    assert found.missed_between == ((4, 7, 1), (1501, 1504, 1))


def test_uncertainty_is_what_repeated_runs_scatter_by():
    pulses = np.arange(500)
    runs = [estimate_clock(pulses, stamped(pulses, 1e-5, 30, 1e-6, s), PERIOD_S, 0.5) for s in range(300)]
    skews = np.array([run.skew_s for run in runs])
    stated = np.mean([run.skew_sd_s for run in runs])
    assert skews.std() == pytest.approx(stated, rel=0.2)
    assert np.mean([run.drift_sd_ppm for run in runs]) == pytest.approx(np.std([r.drift_ppm for r in runs]), rel=0.2)
    assert np.mean([run.jitter_s for run in runs]) == pytest.approx(1e-6, rel=0.05)


def test_late_stamps_are_named_and_do_not_count():
    pulses = np.arange(2000)
    stamps = stamped(pulses, 2e-5, -50, 2e-7)
    late = np.array([3, 500, 501, 1999])
    stamps[late] += 1e-4
    found = estimate_clock(pulses, stamps, PERIOD_S, 2.0)
    assert found.skew_s == pytest.approx(2e-5 - 50e-6, abs=1e-7)
    assert set(late) <= set(found.outlying_pulses)
    assert len(found.outlying_pulses) < 10
    assert found.missed_pulses == ()


def test_a_glitch_on_the_line_is_no_pulse():
    stamps = np.insert(stamped(np.arange(100), 0, 10, 0), 40, 39.3e-3)
    found = estimate_clock(np.arange(101), stamps, PERIOD_S, 0.1)
    assert found.missed_pulses == ()
    assert found.outlying_pulses == (39,)
    assert found.skew_s == pytest.approx(10e-6 * 0.05, abs=1e-9)


def test_ten_hours_keep_their_precision():
    seconds = np.arange(36_000)
    found = estimate_clock(seconds, 1e-4 + (1 + 50e-6) * seconds, 1.0, 36_000.0)
    assert found.skew_s == pytest.approx(1e-4 + 50e-6 * 18_000, abs=1e-9)


def test_stamps_that_begin_late_keep_the_camera_s_count():
    pulses = np.arange(100_000, 101_000)
    found = estimate_clock(pulses, stamped(pulses, 0, 50, 1e-7), PERIOD_S, 101.0)
    assert found.drift_ppm == pytest.approx(50, abs=0.1)
    assert found.missed_pulses == ()


def test_counts_may_be_unsigned_as_a_device_sends_them():
    with pytest.raises(TimingError, match="backwards"):
        estimate_clock(np.array([0, 5, 2], dtype=np.uint64), np.array([0.0, 5e-3, 6e-3]), PERIOD_S, 1.0)


def test_few_pulses_claim_no_uncertainty():
    one = estimate_clock(np.array([0]), np.array([3e-6]), PERIOD_S, 1.0)
    assert (one.skew_s, one.skew_sd_s, one.drift_ppm, one.jitter_s) == (3e-6, None, None, None)
    two = estimate_clock(np.array([0, 1]), np.array([0.0, 1.00005e-3]), PERIOD_S, 1.0)
    assert two.drift_ppm == pytest.approx(50)
    assert (two.skew_sd_s, two.drift_sd_ppm) == (None, None)
    exact = estimate_clock(np.arange(50), np.arange(50) * PERIOD_S, PERIOD_S, 0.05)
    assert exact.skew_s == pytest.approx(0, abs=1e-12)
    assert 0 < exact.skew_sd_s < 1e-9
    assert json.loads(json.dumps(dataclasses.asdict(exact)))["missed_pulses"] == []


@pytest.mark.parametrize(
    ("counted", "stamps", "period_s", "message"),
    [
        ([], [], 1e-3, "found no sync pulse"),
        ([0, 1], [0.0], 1e-3, "as many of each"),
        ([0, 1, 2], [0.5, 0.5, 0.5], 1e-3, "stands still"),
        ([0, 1], [0.0, np.nan], 1e-3, "finite"),
        ([0, 1, 2], [0.0, 5e-3, 1e-3], 1e-3, "backwards"),
        ([0, 2, 1], [0.0, 1e-3, 2e-3], 1e-3, "backwards"),
        ([0, 1], [0.0, 1e-3], 0.0, "positive"),
        ([0, 1], [0.0, 1e9], 1e-3, "1e\\+12 periods between two stamps"),
    ],
)
def test_what_cannot_be_told_is_refused(counted, stamps, period_s, message):
    with pytest.raises(TimingError, match=message):
        estimate_clock(np.array(counted, dtype=int), np.array(stamps), period_s, 1.0)


@pytest.mark.parametrize(
    ("until_s", "behind"), [(0.0995, ()), (0.10005, ()), (0.1005, (100,)), (0.10112, (100, 101)), (0.05, ())]
)
def test_pulses_missed_behind_the_last_stamp_are_named(until_s, behind):
    """Pulse 99 is the last one stamped; one due less than a tenth of a period before the end may be on its way."""
    estimate = estimate_clock(np.arange(100), np.arange(100) * PERIOD_S, PERIOD_S, 0.1)
    found = estimate.with_missed_until(until_s, 0.099, PERIOD_S)
    assert found.missed_pulses == behind


def test_a_line_that_was_cut_is_a_range_and_a_drifting_clock_counts_right():
    stamps = stamped(np.arange(1000), 0.0, 50, 0.0)
    estimate = estimate_clock(np.arange(1000), stamps, PERIOD_S, 60.0)
    found = estimate.with_missed_until(60 * (1 + 50e-6) + 5e-4, stamps[-1], PERIOD_S)
    assert found.missed_between == ((1000, 60_000, 59_001),)
    assert found.missed_pulses == ()


def logged(pulses: np.ndarray, stamps_s: np.ndarray, *, recorded_from: int) -> StampLog:
    """Give a log the stamps of `pulses`, of which none was missed unless it is not there."""
    log = StampLog(PERIOD_S)
    for counted, (pulse, stamp_s) in enumerate(zip(pulses.tolist(), stamps_s.tolist(), strict=True)):
        log.add(counted, stamp_s, recorded=pulse >= recorded_from)
    return log


def test_the_clock_is_that_of_what_was_recorded_not_of_the_trigger():
    pulses = np.arange(0, 61_000, 4)
    log = StampLog(PERIOD_S)
    for counted, stamp_s in zip(pulses.tolist(), stamped(pulses, 1e-6, 50, 0).tolist(), strict=True):
        log.add(counted, stamp_s, recorded=counted >= 60_000)
    found = log.estimate(60.0, 1.0)
    assert found.skew_s == pytest.approx(1e-6 + 50e-6 * 60.5, abs=1e-9)
    assert found.offset_s == pytest.approx(1e-6 + 50e-6 * 60.0, abs=1e-9)


def test_stamps_of_a_long_wait_are_let_go_but_not_the_numbers_of_the_pulses():
    """An hour's stamps, the clock's rate changing all the time: it is told from the last minute, by whole pulses."""
    count = 10 * MOST_STAMPS
    pulses = np.delete(np.arange(count), [3, 70_001, count - 7])
    drift_ppm = 40 + 20 * np.sin(np.arange(count) / 60_000)
    ahead_s = np.cumsum(drift_ppm * 1e-6 * PERIOD_S)
    log = logged(pulses, (np.arange(count) * PERIOD_S + ahead_s)[pulses], recorded_from=count)
    assert len(log._all().numbers) <= 1.5 * MOST_STAMPS
    assert len(log._new) <= MOST_STAMPS
    found = log.estimate(count * PERIOD_S, 0.0)
    assert found.skew_s == pytest.approx(ahead_s[-1], abs=2e-5)  # measured 7e-6; 5.9e-3 ahead
    assert (found.last_pulse, found.missed_pulses) == (count - 1, (count - 7,))


def test_stamps_of_a_long_recording_are_thinned_and_every_missed_pulse_is_named():
    count, missed = 10 * MOST_STAMPS, (3, 70_001, 99_999)
    pulses = np.delete(np.arange(count), missed)
    log = logged(pulses, stamped(pulses, 2e-6, 30, 1e-7), recorded_from=0)
    assert len(log._all().numbers) <= 1.5 * MOST_STAMPS
    found = log.estimate(0.0, count * PERIOD_S, count * PERIOD_S * (1 + 30e-6))
    assert found.skew_s == pytest.approx(2e-6 + 30e-6 * count * PERIOD_S / 2, abs=1e-8)
    assert (found.last_pulse, found.missed_pulses, found.missed_between) == (count - 1, missed, ())


def test_a_log_is_what_an_estimate_of_all_stamps_is_while_it_keeps_them_all():
    pulses = np.setdiff1d(np.arange(MOST_STAMPS - 1), [7, 1501, 9000])
    stamps = stamped(pulses, 1e-5, 40, 3e-7)
    whole = estimate_clock(np.arange(len(pulses)), stamps, PERIOD_S, 3.0)
    assert logged(pulses, stamps, recorded_from=0).estimate(0.0, 3.0) == whole


def test_a_log_of_a_clock_that_was_set_back_tells_no_time():
    log = StampLog(PERIOD_S)
    for counted in range(2 * MOST_STAMPS):
        log.add(counted, counted % 1000 * PERIOD_S, recorded=False)
    assert not log._new
    with pytest.raises(TimingError, match="go backwards"):
        log.estimate(0.0, 1.0)
    with pytest.raises(TimingError, match="found no sync pulse"):
        StampLog(PERIOD_S).estimate(0.0, 1.0)
