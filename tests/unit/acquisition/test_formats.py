"""Layouts of other cameras than the plain one: rows with trailing bits, and M1K40 segments."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from references.spikes import counts_reference

from acquisition.errors import BadRecordingError
from acquisition.spikes import m1k40
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import counts, pack, unpack, unpack_reference

SEGMENT, PLANE = m1k40.SEGMENT_BYTES, m1k40.SEGMENTS * m1k40.SEGMENT_BYTES


@st.composite
def stored_rows(draw):
    layout = PlaneLayout(
        draw(st.integers(1, 60)),
        draw(st.integers(1, 12)),
        draw(st.sampled_from(["lsb", "msb"])),
        draw(st.sampled_from(["bottom", "top"])),
        draw(st.integers(0, 20)),
    )
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    return rng.integers(0, 2, (draw(st.integers(0, 4)), layout.height, layout.width), dtype=np.uint8), layout


@given(stored_rows())
def test_trailing_columns_come_and_go(case):
    planes, layout = case
    packed = pack(planes, layout)
    assert packed.shape == (len(planes), layout.plane_bytes)
    np.testing.assert_array_equal(unpack(packed, layout), planes)
    noisy = packed | ~pack(np.ones_like(planes), layout)  # what stands behind the pixels is no light
    for found in (unpack(noisy, layout), unpack_reference(noisy, layout)):
        np.testing.assert_array_equal(found, planes)
    for found in (counts(noisy, layout), counts_reference(noisy, layout)):
        np.testing.assert_array_equal(found, planes.sum(axis=0))


def test_a_416_wide_row_holds_400_pixels_and_then_16_bits():
    layout = PlaneLayout(400, 250, trailing_columns=16)
    assert (layout.stored_width, layout.plane_bytes) == (416, 13_000)
    stored = np.zeros((1, 250, 416), dtype=np.uint8)
    stored[0, 0, 399] = stored[0, 7, 400] = 1
    packed = pack(stored, PlaneLayout(416, 250))
    assert np.argwhere(unpack(packed, layout)).tolist() == [[0, 0, 399]]


def test_trailing_columns_cannot_be_negative():
    with pytest.raises(BadRecordingError, match="-1 trailing columns"):
        PlaneLayout(8, 8, trailing_columns=-1)


def as_written(planes: np.ndarray, order: np.random.Generator | None = None) -> np.ndarray:
    """Planes [T, 1000, 1000] as the camera writes them [T * 2000, 64], inner lines in any order."""
    bits = np.zeros((len(planes), m1k40.SEGMENTS, 8 * SEGMENT), dtype=np.uint8)
    bits[:, :, : m1k40.SEGMENT_PIXELS] = planes.reshape(len(planes), m1k40.SEGMENTS, m1k40.SEGMENT_PIXELS)
    stored = np.packbits(bits, axis=2, bitorder="little")
    names = np.array([(500, 0), *((n, c) for c in range(4) for n in range(1, 501) if (n, c % 3) != (500, 0)), (500, 3)])
    if order:
        order.shuffle(names[1:-1])
    trailer = names[:, 0] << 4 | names[:, 1] << 14
    stored[:, :, 62] |= (trailer & 0xFF).astype(np.uint8)
    stored[:, :, 63] = trailer >> 8
    return stored.reshape(-1, SEGMENT)


@pytest.fixture(scope="module")
def planes() -> np.ndarray:
    return (np.random.default_rng(5).random((5, 1000, 1000)) < 0.3).astype(np.uint8)


@pytest.fixture(scope="module")
def written(planes) -> np.ndarray:
    return as_written(planes, np.random.default_rng(6))


def decoded(stream: m1k40.M1K40Stream) -> np.ndarray:
    return unpack(stream.window(0, len(stream)), m1k40.LAYOUT)


def test_m1k40_planes_are_found_and_decoded(planes, written):
    stream = m1k40.locate(written.reshape(-1))
    assert (len(stream), stream.skipped_bytes, stream.partial_bytes, stream.missing) == (5, 0, 0, {})
    np.testing.assert_array_equal(decoded(stream), planes)
    np.testing.assert_array_equal(unpack(stream.window(2, 4), m1k40.LAYOUT), planes[2:4])


def test_m1k40_files_of_any_length_take_a_share_of_their_bytes(written):
    data = np.tile(written, (8, 1)).reshape(-1)
    m1k40.locate(data)  # what is loaded on first use does not count
    tracemalloc.start()
    try:
        stream = m1k40.locate(data)
        kept, most = (size / len(data) for size in tracemalloc.get_traced_memory())
    finally:
        tracemalloc.stop()
    assert len(stream) == 40
    assert kept < 0.17  # ten bytes for 64
    assert most < 0.5  # measured 0.38


@settings(max_examples=15)
@given(st.integers(1, PLANE - 1), st.integers(0, PLANE - 1))
def test_m1k40_may_begin_and_end_anywhere(planes, written, head, tail):
    data = written.reshape(-1)[head : 5 * PLANE - tail]
    stream = m1k40.locate(data)
    whole = 4 - bool(tail)
    assert len(stream) == whole
    assert (stream.skipped_bytes, stream.partial_bytes) == (PLANE - head, -tail % PLANE)
    np.testing.assert_array_equal(decoded(stream), planes[1 : 1 + whole])


@settings(max_examples=10)
@given(st.sets(st.integers(m1k40.SEGMENTS, 5 * m1k40.SEGMENTS - 3), max_size=50))
def test_m1k40_missing_segments_are_zero_and_counted(planes, written, lost):
    expected = planes.reshape(-1, m1k40.SEGMENT_PIXELS).copy()
    expected[sorted(lost)] = 0
    stream = m1k40.locate(np.delete(written, sorted(lost), axis=0).reshape(-1))
    found = decoded(stream).reshape(-1, m1k40.SEGMENT_PIXELS)
    assert len(found) == len(expected)
    wrong = set(np.flatnonzero((found != expected).any(axis=1)).tolist())
    assert all({n - 1, n + 1} <= lost for n in wrong)  # one alone between two lost ones is not trusted
    assert sum(stream.missing.values()) == len(lost) + len(wrong)


def test_m1k40_a_plane_without_its_ends_keeps_its_time(planes, written):
    S = m1k40.SEGMENTS
    kept = np.delete(written, np.r_[2 * S - 300 : 2 * S + 400], axis=0)  # the end of plane 1, the start of plane 2
    stream = m1k40.locate(kept.reshape(-1))
    assert stream.missing == {1: 300, 2: 400}
    np.testing.assert_array_equal(decoded(stream)[3:], planes[3:])


def test_m1k40_planes_from_one_on_are_a_stream(planes, written):
    lost = [2 * m1k40.SEGMENTS + 7, 3 * m1k40.SEGMENTS + 500, 3 * m1k40.SEGMENTS + 501]
    stream = m1k40.locate(np.delete(written, lost, axis=0).reshape(-1)[5 * SEGMENT :])
    later = stream.since(2)
    assert len(later) == len(stream) - 2
    assert (stream.missing, later.missing) == ({1: 1, 2: 2}, {0: 2})
    assert later.skipped_bytes == 3 * PLANE - 6 * SEGMENT  # of the cut file
    np.testing.assert_array_equal(later.window(0, 2), stream.window(2, 4))
    np.testing.assert_array_equal(decoded(stream.since(0)), decoded(stream))


def test_m1k40_unreadable_stretches_keep_their_time(planes, written):
    spoilt = written.copy()
    spoilt[4100:9000, 62:] = np.random.default_rng(1).integers(0, 256, (4900, 2))
    stream = m1k40.locate(spoilt.reshape(-1))
    assert len(stream) == 5
    assert stream.missing == {2: 1900, 3: 2000, 4: 1000}
    np.testing.assert_array_equal(decoded(stream)[:2], planes[:2])


@pytest.mark.parametrize("data", [b"", b"\0" * 1000, b"\xff" * 300_000])
def test_what_is_no_m1k40_stream_is_refused(data):
    with pytest.raises(BadRecordingError, match="expected an M1K40 stream"):
        m1k40.locate(np.frombuffer(data, dtype=np.uint8))


def test_m1k40_without_one_whole_plane_is_refused(written):
    with pytest.raises(BadRecordingError, match="no plane with all"):
        m1k40.locate(np.delete(written[:4000], [700, 2700], axis=0).reshape(-1))


@settings(max_examples=40)
@given(st.data())
def test_m1k40_damage_of_any_kind_is_read_or_refused(written, data):
    stored = written[:6000].reshape(-1).copy()
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    for _ in range(data.draw(st.integers(0, 4))):
        first = data.draw(st.integers(0, len(stored) - 1))
        count = data.draw(st.integers(1, 200_000))
        kind = data.draw(st.sampled_from(["noise", "cut", "again", "zero"]))
        if kind == "cut":
            stored = np.delete(stored, slice(first, first + count))
        elif kind == "again":
            stored = np.insert(stored, first, stored[first : first + count])
        else:
            part = stored[first : first + count]
            part[:] = rng.integers(0, 256, len(part)) if kind == "noise" else 0
        if not len(stored):
            break
    try:
        stream = m1k40.locate(stored)
    except BadRecordingError:
        return
    assert 1 <= len(stream) <= len(stored) // PLANE + 2 + sum(stream.missing.values()) // m1k40.SEGMENTS
    assert stream.window(0, len(stream)).shape == (len(stream), 125_000)
