import ctypes
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from references.spikes import counts_reference, intervals_reference, weighted_counts_reference

from acquisition import native
from acquisition.errors import BadRecordingError
from acquisition.spikes.intervals import FARTHEST, NEAR, intervals, outermost, weighted_counts
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import (
    counts,
    pack,
    unpack,
    unpack_reference,
    window_counts,
    window_means,
)

ORDERS = [(bit, row) for bit in ("lsb", "msb") for row in ("bottom", "top")]
SIZES = [(1, 1), (3, 1), (13, 7), (64, 8), (511, 3), (65, 17)]


def spikes_of(planes, layout, share, seed=0):
    return pack(np.random.default_rng(seed).random((planes, layout.height, layout.width)) < share, layout)


@st.composite
def cases(draw):
    bit_order, row_order = draw(st.sampled_from(ORDERS))
    layout = PlaneLayout(draw(st.integers(1, 70)), draw(st.integers(1, 20)), bit_order, row_order)
    planes = draw(st.integers(1, 40))
    share = draw(st.sampled_from([0.0, 0.02, 0.3, 1.0]))
    return spikes_of(planes, layout, share, draw(st.integers(0, 2**32))), layout


@given(cases(), st.integers(1, 50), st.integers(0, 39))
def test_intervals_of_any_size_and_order_are_the_references(case, reach, plane):
    packed, layout = case
    instants = [0, plane % len(packed), len(packed) - 1]
    for found, wanted in zip(
        intervals(packed, layout, instants, reach), intervals_reference(packed, layout, instants, reach), strict=True
    ):
        assert found.dtype == wanted.dtype
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize(("bit_order", "row_order"), ORDERS)
@pytest.mark.parametrize("reach", [255, 256, 300, FARTHEST])
def test_long_intervals_are_counted_beyond_a_byte(reach, bit_order, row_order):
    layout = PlaneLayout(37, 31, bit_order, row_order)
    packed = spikes_of(700, layout, 0.003)
    found, wanted = (f(packed, layout, [350, 699], reach) for f in (intervals, intervals_reference))
    for a, b in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(a, b)
    assert found.ticks.max() > 300


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_silence_and_saturation(width, height):
    layout = PlaneLayout(width, height)
    dark, bright = (spikes_of(40, layout, share) for share in (0.0, 1.0))
    silent = intervals(dark, layout, [10], 128)
    assert (silent.ticks == 11 + 29 + 1).all()
    assert not silent.before.any()
    assert not silent.after.any()
    assert (intervals(bright, layout, [10], 128).ticks == 1).all()
    assert not intervals(bright[:1], layout, [0], 128).after.any()


@given(cases())
def test_outermost_intervals_are_the_nearest_to_either_end(case):
    packed, layout = case
    spikes, found = unpack(packed, layout), outermost(packed, layout)
    assert found.shape == (2, layout.height, layout.width)
    for row, column in np.ndindex(layout.height, layout.width):
        for side, train in enumerate((spikes[:, row, column], spikes[::-1, row, column])):
            expected, at = 0, np.flatnonzero(train)
            for away in (distance for distance in NEAR if distance < len(train)):
                # A plane with a spike begins an interval in time, so that backwards it ends one.
                before, after = (at[at <= away], at[at > away]) if side == 0 else (at[at < away], at[at >= away])
                if len(before) and len(after):
                    expected = after[0] - before[-1]
                    break
            assert found[side, row, column] == expected


def test_outermost_intervals_of_silence_and_saturation():
    layout = PlaneLayout(13, 7)
    dark, bright = (spikes_of(300, layout, share) for share in (0.0, 1.0))
    assert (outermost(dark, layout) == 0).all()
    assert (outermost(bright, layout) == 1).all()
    assert (outermost(bright[:1], layout) == 0).all()
    late = bright.copy()
    late[:150] = 0  # its first spikes are beyond the planes that are looked at
    assert (outermost(late, layout)[0] == 0).all()


@pytest.mark.parametrize("threads", [1, 2])
def test_threads_change_nothing(threads):
    layout = PlaneLayout(41, 26)
    packed = spikes_of(90, layout, 0.2)
    wanted = intervals_reference(packed, layout, range(90), 16)
    np.testing.assert_array_equal(intervals(packed, layout, range(90), 16, threads=threads).ticks, wanted.ticks)
    bounds = np.array([(k // 2, k) for k in range(91)])
    found = window_counts(packed, layout, bounds, threads=threads)
    means = window_means(packed, layout, bounds[1:], threads=threads)
    for (first, last), image in zip(bounds, found, strict=True):
        np.testing.assert_array_equal(image, counts_reference(packed[first:last], layout))
    for (first, last), image in zip(bounds[1:], means, strict=True):
        wanted = counts_reference(packed[first:last], layout).astype(np.float32) / np.float32(last - first)
        np.testing.assert_array_equal(image, wanted)


@given(cases(), st.integers(1, 3))
def test_weighted_counts_are_the_references(case, kernels):
    packed, layout = case
    weights = np.random.default_rng(kernels).integers(0, 1000, (kernels, len(packed)))
    weights[:, 0] = 0
    found = weighted_counts(packed, layout, weights, threads=2)
    np.testing.assert_array_equal(found, weighted_counts_reference(packed, layout, weights))
    ones = np.ones((1, len(packed)), dtype=int)
    np.testing.assert_array_equal(weighted_counts(packed, layout, ones)[0], counts(packed, layout))


def test_trailing_columns_are_no_light():
    layout = PlaneLayout(20, 9, trailing_columns=4)
    packed = np.random.default_rng(0).integers(0, 256, (30, layout.plane_bytes), dtype=np.uint8)
    np.testing.assert_array_equal(
        intervals(packed, layout, [3], 8).ticks, intervals_reference(packed, layout, [3], 8).ticks
    )
    weights = np.arange(30)[None]
    np.testing.assert_array_equal(
        weighted_counts(packed, layout, weights), weighted_counts_reference(packed, layout, weights)
    )
    np.testing.assert_array_equal(counts(packed, layout), counts_reference(packed, layout))


def test_what_lies_outside_is_refused():
    layout = PlaneLayout(8, 2)
    packed = spikes_of(10, layout, 0.5)
    for plane in (-1, 10):
        with pytest.raises(BadRecordingError, match=f"plane {plane}, expected one inside 0:10"):
            intervals(packed, layout, [plane], 4)
    for reach in (0, FARTHEST + 1):
        with pytest.raises(BadRecordingError, match=f"reach of {reach}"):
            intervals(packed, layout, [1], reach)
    for window in ((-1, 2), (3, 2), (0, 11)):
        with pytest.raises(BadRecordingError, match="inside 0:10"):
            window_counts(packed, layout, np.array([window]))
    with pytest.raises(BadRecordingError, match="without planes, expected at least one"):
        window_means(packed, layout, np.array([(3, 3)]))
    for weights in (np.ones((1, 9), int), np.ones((1, 10)), -np.ones((1, 10), int), np.full((1, 10), 2**31)):
        with pytest.raises(BadRecordingError, match="found weights"):
            weighted_counts(packed, layout, weights)


BUILDS = sorted(native._builds("acquisition").items())


@pytest.mark.parametrize(("level", "build"), BUILDS, ids=[level for level, _ in BUILDS])
def test_every_build_this_processor_runs_gives_the_same(level, build: Path, monkeypatch):
    best = native.load_library("acquisition").native_x86_level()
    if level != "plain" and int(level[1:]) > best:
        pytest.skip(f"this processor is level {best}, the build needs {level}")
    library = ctypes.CDLL(str(build))
    monkeypatch.setattr(native, "load_library", lambda _: library)
    for bit_order, row_order in ORDERS:
        layout = PlaneLayout(77, 19, bit_order, row_order)
        packed = spikes_of(300, layout, 0.1)
        weights = np.arange(300)[None] % 7
        np.testing.assert_array_equal(unpack(packed, layout), unpack_reference(packed, layout))
        np.testing.assert_array_equal(counts(packed, layout), counts_reference(packed, layout))
        np.testing.assert_array_equal(
            intervals(packed, layout, [150], 64).ticks, intervals_reference(packed, layout, [150], 64).ticks
        )
        np.testing.assert_array_equal(
            weighted_counts(packed, layout, weights), weighted_counts_reference(packed, layout, weights)
        )
