"""Compact planes are the planes, to the bit, and reading some of them decodes the blocks that hold them."""

import gc
import weakref

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from acquisition.errors import BadRecordingError
from acquisition.spikes import compact
from acquisition.spikes.compact import KEPT_BLOCKS, CompactPlanes, block_planes_of, decode, encode
from acquisition.spikes.intervals import intervals
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import counts, window_counts, window_means
from acquisition.spikes.stream import SpikeStream
from acquisition.spikes.transposed import planes_of, trains_of

LAYOUT = PlaneLayout(13, 7)  # 91 pixels: the last byte of a plane has five bits of padding


def planes_like(count: int, plane_bytes: int, seed: int = 0, share: float = 0.3) -> np.ndarray:
    bits = np.random.default_rng(seed).random((count, plane_bytes * 8)) < share
    return np.packbits(bits, axis=1, bitorder="little")


def written(path, planes, block_planes) -> CompactPlanes:
    blocks = [encode(planes[first : first + block_planes]) for first in range(0, len(planes), block_planes)]
    path.write_bytes(b"".join(blocks))
    return CompactPlanes.open(path, planes.shape, block_planes, tuple(map(len, blocks)))


def trains_reference(planes):
    """The definition: unpack every bit, exchange planes and pixels, pack again."""
    bits = np.unpackbits(planes, axis=1, bitorder="little")
    return np.packbits(bits.T, axis=1, bitorder="little")


@pytest.fixture
def decoded(monkeypatch):
    """The numbers of planes of the blocks that were decoded."""
    seen = []

    def counted(block, planes, plane_bytes):
        seen.append(planes)
        return decode(block, planes, plane_bytes)

    monkeypatch.setattr(compact, "decode", counted)
    return seen


@given(st.integers(1, 70), st.integers(1, 40), st.integers(0, 2**32), st.sampled_from([0.0, 0.02, 0.4, 1.0]))
def test_trains_are_transposed_bits_and_become_planes_again(count, plane_bytes, seed, share):
    planes = planes_like(count, plane_bytes, seed, share)
    trains = trains_of(planes)
    np.testing.assert_array_equal(trains, trains_reference(planes))
    np.testing.assert_array_equal(planes_of(trains, count), planes)
    np.testing.assert_array_equal(trains, trains_reference(planes), "the trains are left as they were")


def test_trains_are_those_of_planes_that_lie_apart():
    planes = planes_like(20, 6)
    np.testing.assert_array_equal(trains_of(planes[::2]), trains_reference(planes[::2]))
    np.testing.assert_array_equal(trains_of(planes[:, ::-1]), trains_reference(planes[:, ::-1]))


@given(st.integers(1, 30), st.integers(1, 20), st.integers(0, 2**32))
def test_a_block_holds_its_planes(count, plane_bytes, seed):
    planes = planes_like(count, plane_bytes, seed)
    np.testing.assert_array_equal(decode(encode(planes), count, plane_bytes), planes)


def test_steady_light_is_small():
    planes = np.zeros((400, 1250), dtype=np.uint8)
    planes[::5] = 255
    assert len(encode(planes)) < planes.nbytes / 500


def test_a_flipped_bit_never_yields_other_planes():
    planes = planes_like(9, 3)
    block = encode(planes)
    refused = 0
    for bit in range(8 * len(block)):
        bad = bytearray(block)
        bad[bit // 8] ^= 1 << bit % 8
        try:
            np.testing.assert_array_equal(decode(bytes(bad), 9, 3), planes)
        except BadRecordingError:
            refused += 1
    assert refused > 7.5 * len(block)  # some bits of a frame's head mean nothing


@pytest.mark.parametrize("cut", [0, 1, 5, -1])
def test_a_block_that_is_cut_off_is_refused(cut):
    block = encode(planes_like(9, 3))
    with pytest.raises(BadRecordingError, match="found a block"):
        decode(block[:cut], 9, 3)


def test_a_block_with_something_behind_it_is_refused():
    block = encode(planes_like(9, 3))
    with pytest.raises(BadRecordingError, match="cannot be decoded"):
        decode(block + block, 9, 3)


@pytest.mark.parametrize(("count", "plane_bytes"), [(8, 3), (17, 3), (9, 4), (9, 2)])
def test_a_block_of_other_planes_is_refused_before_it_is_decoded(count, plane_bytes):
    with pytest.raises(BadRecordingError, match=rf"found a block of 48 bytes, expected {count} planes of"):
        decode(encode(planes_like(9, 3)), count, plane_bytes)
    without_length = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(48))
    with pytest.raises(BadRecordingError, match="found a block of -1 bytes"):
        decode(without_length, 9, 3)


@pytest.mark.parametrize(
    ("size", "expected"), [((400, 250), 400), ((1000, 1000), 128), ((1, 1), 400), ((9999, 9999), 8)]
)
def test_blocks_are_400_planes_or_16_mib(size, expected):
    assert block_planes_of(PlaneLayout(*size).plane_bytes) == expected


@pytest.mark.parametrize("count", [1, 8, 15, 16, 17, 40])
@pytest.mark.parametrize("block_planes", [8, 16, 400])
def test_an_index_finds_what_an_array_has(tmp_path, count, block_planes):
    planes = planes_like(count, 5)
    found = written(tmp_path / "a.compact", planes, block_planes)
    assert (found.shape, found.dtype, found.ndim, found.nbytes, len(found)) == (
        planes.shape, planes.dtype, 2, planes.nbytes, count,
    )  # fmt: skip
    edges = {0, 1, 7, 8, 9, 16, count - 1, count, count + 3, -1, -count}
    keys = [slice(a, b) for a in edges for b in edges] + [slice(None, None, -1), slice(None, None, 3), slice(30, 2, -7)]
    keys += [k for k in edges if -count <= k < count] + [(slice(None), 0), (slice(1, 12), slice(2, 4)), (0, 3)]
    for key in keys:
        np.testing.assert_array_equal(found[key], planes[key])
    np.testing.assert_array_equal(np.asarray(found), planes)
    np.testing.assert_array_equal(list(found), planes)
    with pytest.raises(IndexError):
        found[count]


def test_planes_that_nobody_holds_leave_the_memory_at_once(tmp_path):
    found = written(tmp_path / "a.compact", planes_like(8, 5), 8)
    found[0:4]
    gone = weakref.ref(found)
    gc.disable()
    try:
        del found
        assert gone() is None
    finally:
        gc.enable()


def test_what_is_read_cannot_be_written(tmp_path):
    found = written(tmp_path / "a.compact", planes_like(8, 5), 8)
    with pytest.raises(ValueError, match="read-only"):
        found[0:4][0, 0] = 1


def test_a_window_decodes_only_the_blocks_that_it_touches(tmp_path, decoded):
    stream = SpikeStream(written(tmp_path / "a.compact", planes_like(44, LAYOUT.plane_bytes), 8), LAYOUT, 20_000.0)
    assert decoded == []
    stream.window(9, 15)
    assert decoded == [8]
    stream.counts(8, 16)
    assert decoded == [8], "a block that was just decoded is kept"
    stream.planes(15, 17)
    assert decoded == [8, 8]
    stream.window(40, 44)
    assert decoded == [8, 8, 4]
    stream.window(16, 17)
    stream.window(9, 10)
    assert len(decoded) == 3 + (KEPT_BLOCKS == 2), "no more than the last two blocks are kept"
    stream.window(20, 20)
    assert len(decoded) == 4


def test_counts_decode_each_block_once(tmp_path, decoded):
    planes = planes_like(44, LAYOUT.plane_bytes)
    stream = SpikeStream(written(tmp_path / "a.compact", planes, 8), LAYOUT, 20_000.0)
    windows = [(0, 44), (3, 5), (30, 30), (1, 40)]
    found = stream.window_counts(windows)
    np.testing.assert_array_equal(found, window_counts(planes, LAYOUT, np.array(windows)))
    assert decoded == [8, 8, 8, 8, 8, 4]
    np.testing.assert_array_equal(stream.counts(0, 44), found[0])
    assert decoded == 2 * [8, 8, 8, 8, 8, 4], "a long window is never decoded whole"
    del decoded[6:]
    stream.window_counts([(17, 18), (43, 44)])
    assert decoded == [8, 8, 8, 8, 8, 4, 8], "the blocks between two windows are passed over, the last is kept"


@given(st.data())
def test_kernels_find_in_compact_planes_what_they_find_in_planes(tmp_path_factory, data):
    count, block_planes = data.draw(st.integers(1, 40)), data.draw(st.sampled_from([8, 16, 24]))
    layout = PlaneLayout(data.draw(st.integers(1, 30)), 3, data.draw(st.sampled_from(["lsb", "msb"])), "bottom")
    planes = planes_like(
        count, layout.plane_bytes, data.draw(st.integers(0, 99)), data.draw(st.sampled_from([0.05, 0.4]))
    )
    found = written(tmp_path_factory.mktemp("kernels") / "a.compact", planes, block_planes)
    edges = st.lists(st.integers(0, count), min_size=2, max_size=2).map(sorted)
    bounds = np.array(data.draw(st.lists(edges, max_size=4)), dtype=np.int64).reshape(-1, 2)
    np.testing.assert_array_equal(window_counts(found, layout, bounds), window_counts(planes, layout, bounds))
    whole = bounds[bounds[:, 0] < bounds[:, 1]]
    np.testing.assert_array_equal(window_means(found, layout, whole), window_means(planes, layout, whole))
    np.testing.assert_array_equal(counts(found, layout), counts(planes, layout))
    instants = data.draw(st.lists(st.integers(0, count - 1), max_size=5))
    reach, threads = data.draw(st.integers(1, 50)), data.draw(st.integers(1, 2))
    wanted = data.draw(st.sampled_from([None, planes_like(1, layout.plane_bytes, 7)[0]]))
    here = intervals(found, layout, instants, reach, wanted=wanted, threads=threads)
    there = intervals(planes, layout, instants, reach, wanted=wanted, threads=threads)
    for own, expected in zip(here, there, strict=True):
        np.testing.assert_array_equal(own, expected)
        assert (own.dtype, own.shape) == (expected.dtype, expected.shape)


def test_a_window_outside_compact_planes_is_refused(tmp_path):
    found = written(tmp_path / "a.compact", planes_like(10, LAYOUT.plane_bytes), 8)
    with pytest.raises(BadRecordingError, match="planes 5:11"):
        window_counts(found, LAYOUT, np.array([[5, 11]]))
    with pytest.raises(BadRecordingError, match="plane 10"):
        intervals(found, LAYOUT, [10], 3)


def test_damage_is_said_with_file_and_block_when_that_block_is_read(tmp_path):
    path = tmp_path / "cam11.compact"
    found = written(path, planes_like(20, 40), 8)
    sizes = np.diff(found._stored.ends)
    data = bytearray(path.read_bytes())
    data[sizes[0] + sizes[1] // 2] ^= 16
    path.write_bytes(data)
    bad = CompactPlanes.open(path, (20, 40), 8, tuple(map(int, sizes)))
    np.testing.assert_array_equal(bad[0:8], found[0:8])
    with pytest.raises(BadRecordingError, match=r"cam11\.compact: block 1 \(planes 8 to 15\): found a block that"):
        bad[7:9]


@pytest.mark.parametrize("size", [0, 3])
def test_a_file_of_another_length_is_refused(tmp_path, size):
    path = tmp_path / "cam11.compact"
    path.write_bytes(bytes(size))
    with pytest.raises(BadRecordingError, match=rf"cam11\.compact: found {size} bytes, expected 9; verify"):
        CompactPlanes.open(path, (8, 3), 8, (9,))
    with pytest.raises(BadRecordingError, match=r"none\.compact: cannot be read"):
        CompactPlanes.open(tmp_path / "none.compact", (8, 3), 8, (9,))
